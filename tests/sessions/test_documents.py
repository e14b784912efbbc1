"""YAML and JSON from outside: what ours may hold is read as PyYAML reads it, all else is refused soon."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.limits import within
from tests.support.places import PROJECT
from tests.support.rig import rig
from tests.support.schemas import bare
from twinmatch.cli import main
from twinmatch.comparing import Candidate
from twinmatch.errors import TwinmatchError
from twinmatch.parameters.candidates import (
    CandidateFileError,
    candidates_text,
    parse_candidates,
    read_candidates,
)
from twinmatch.parameters.twin import read_settings
from twinmatch.plants import Peltier
from twinmatch.plants.records import parameters_from
from twinmatch.sessions import SessionError, messages
from twinmatch.sessions.documents import (
    MAX_BYTES,
    DocumentError,
    parse_json,
    parse_yaml,
    read_yaml,
)
from twinmatch.sessions.messages import (
    PLANT_TOPICS,
    SAMPLE,
    Qos,
    Topic,
    fields_of,
    schema_of,
)
from twinmatch.sessions.metadata import files_listed, parse_qos

texts = st.text(
    st.characters(
        exclude_categories=("Cs", "Cc"), exclude_characters="\ufeff\ufffe\uffff"
    ),
    max_size=12,
)
scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63) + 1, 2**63 - 1)
    | st.floats(allow_nan=False)
    | texts
)
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4)
    ),
)


@given(trees, st.booleans())
def test_what_pyyaml_writes_is_read_as_it_was(tree: Any, flow: bool) -> None:
    text = yaml.safe_dump(tree, default_flow_style=flow, allow_unicode=True)
    assert parse_yaml(text, "x") == tree


@given(trees)
def test_what_json_writes_is_read_as_it_was(tree: Any) -> None:
    assert parse_json(json.dumps(tree), "x") == tree


@pytest.mark.parametrize("path", sorted((PROJECT / "config").glob("*.yaml")))
def test_the_files_of_this_project_are_read_as_pyyaml_reads_them(path: Path) -> None:
    assert read_yaml(path) == yaml.safe_load(path.read_text("utf-8"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: &x {b: 1}\nc: *x", {"a": {"b": 1}, "c": {"b": 1}}),
        (
            "a: &x {b: 1, d: 2}\nc: {<<: *x, b: 3}",
            {"a": {"b": 1, "d": 2}, "c": {"b": 3, "d": 2}},
        ),
        (
            "a: &x {b: 1}\ne: &y {b: 2}\nc: {<<: [*x, *y]}",
            {"a": {"b": 1}, "e": {"b": 2}, "c": {"b": 1}},
        ),
        ("name: 2022-02-27", {"name": "2022-02-27"}),
        ("name: 2022-13-45", {"name": "2022-13-45"}),
        ("1: a\nyes: b", {"1": "a", "yes": "b"}),
        ("'no'", "no"),
        ("a: !!str 5", {"a": "5"}),
        ("[0x10, 1_000, +5, .5, 1e3]", [16, 1000, 5, 0.5, "1e3"]),
        ("x: -.inf", {"x": -math.inf}),
        ("", None),
        ("# nothing", None),
    ],
)
def test_what_stands_in_a_file_means_this(text: str, value: Any) -> None:
    assert parse_yaml(text, "x") == value


def laughs(levels: int) -> str:
    lines = ["l0: &l0 [ha, ha, ha, ha, ha, ha, ha, ha, ha, ha]"]
    lines += [
        f"l{k}: &l{k} [{', '.join([f'*l{k - 1}'] * 10)}]" for k in range(1, levels)
    ]
    return "\n".join(lines)


def merges(levels: int) -> str:
    lines = ["l0: &l0 {a: 1, b: 2, c: 3}"]
    lines += [
        f"l{k}: &l{k} {{<<: [{', '.join([f'*l{k - 1}'] * 10)}]}}"
        for k in range(1, levels)
    ]
    return "\n".join(lines)


HOSTILE = {
    "laughs": (laughs(10), "has more than 20000 values"),
    "merges": (merges(10), "has more than 20000 values"),
    "most": ("[" + "1," * (MAX_BYTES // 2 - 1) + "]", "has more than 20000 values"),
    "many": ("[" + "1," * 40_000 + "]", "has more than 20000 values"),
    "deep lists": ("[" * 1000 + "]" * 1000, "is nested deeper than 32 levels"),
    "deeper lists": ("[" * 50_000, "is nested deeper|nesting depth"),
    "deep mappings": (
        "{a: " * 1000 + "1" + "}" * 1000,
        "is nested deeper than 32 levels",
    ),
    "deep blocks": (
        "\n".join(" " * k + "a:" for k in range(1000)),
        "is nested deeper|nesting depth",
    ),
    "itself": ("a: &a [*a]", "line 1: is nested deeper than 32 levels"),
    "its parent": ("a: &a {b: {c: *a}}", "line 1: is nested deeper than 32 levels"),
    "nobody": ("a: *b", "is not valid YAML in line 1: found undefined alias"),
    "large": (
        "a: 1" + "0" * 399,
        "is too large for a whole number|is too long for a number",
    ),
    "64 bits": (
        f"a: {2**63}",
        "is too large for a whole number; write it with an exponent",
    ),
    "digits": ("a: " + "7" * 5000, "is too long for a number"),
    "hexadecimal": ("a: 0x" + "f" * 5000, "is too long for a number"),
    "beyond": ("a: 1.0e+999", "is too large for a number"),
    "below": ("a: -1.0e+999", "is too large for a number"),
    "no number": ("a: .nan", "line 1: .nan is not a number"),
    "object": ("a: !!python/object/apply:os.system [echo]", "which is not supported"),
    "bytes": ("a: !!binary aGFsbG8=", "which is not supported"),
    "date": ("a: !!timestamp 2022-13-45", "which is not supported"),
    "wrong kind": ("a: !!float seven", "is not a valid float"),
    "set": ("a: !!set {b}", "which is not supported"),
    "list as name": ("? [a, b]\n: 1", "line 1: has a key that is not text"),
    "twice": ("a: 1\nb: 2\na: 3", "line 3: gives 'a' twice"),
    "two": ("a: 1\n---\na: 2", "line 2: expected a single document"),
    "merged": ("a: {<<: 5}", "merges a value that is not a mapping"),
    "long": ("a: " + "x" * 20_000, "has a text of more than 10000 characters"),
    "longer": ("#" * (MAX_BYTES + 1), f"has more than {MAX_BYTES} characters"),
    "torn": ("a: [1, 2", r"is not valid YAML in line \d"),
    "tab": ("a:\n\t- b", "is not valid YAML in line 2"),
    "zero byte": ("a: \0", "is not valid YAML"),
    "odd colons": ("a: 1:99999999999999:0", ""),
}


NUMBERS = {"2e-05": 2e-5, "2e5": 2e5, ".5e+3": 500.0, "-1E-3": -1e-3, "1.5e3": 1500.0}


@pytest.mark.parametrize("text", NUMBERS)
def test_numbers_with_an_exponent_are_numbers_in_files_that_people_write(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(f"period: {text}\n")
    assert read_yaml(path) == {"period": NUMBERS[text]}


@pytest.mark.parametrize("text", ["'2e-05'", "2e", "e5", "12e4x", "0x1e5z"])
def test_what_only_resembles_a_number_with_an_exponent_is_text(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(f"plant: {text}\n")
    assert read_yaml(path) == {"plant": text.strip("'")}


def test_texts_of_programs_that_look_like_such_numbers_stay_texts() -> None:
    """PyYAML writes them without quotes."""
    assert parse_yaml(yaml.safe_dump({"name": "2e-05"}), "file") == {"name": "2e-05"}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_would_do_harm_is_refused_in_one_line(name: str) -> None:
    text, message = HOSTILE[name]
    with within(10, 100):
        try:
            parse_yaml(text, "file")
        except DocumentError as error:
            words = str(error)
        else:
            assert not message
            return
    assert words.startswith("file: ")
    assert "\n" not in words
    assert len(words) < 300
    assert re.search(message, words)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "is nested too deeply"),
        ("1" * 5000, "is too large for a whole number"),
        (str(2**63), "is too large for a whole number"),
        ("{", "is not valid JSON"),
    ],
)
def test_json_that_would_do_harm_is_refused(text: str, message: str) -> None:
    with within(10, 100), pytest.raises(DocumentError, match=f"^file: .*{message}"):
        parse_json(text, "file")


@given(st.text(max_size=60) | st.text("[]{}:,-&*a !<>|?'\"#%\n 01.", max_size=80))
def test_any_text_is_a_document_or_refused(text: str) -> None:
    for parse in (parse_yaml, parse_json):
        try:
            parse(text, "file")
        except DocumentError as error:
            assert str(error).startswith("file: ")  # noqa: PT017


# The same through those who read them.


SOME = (
    "laughs",
    "deep lists",
    "itself",
    "large",
    "object",
    "twice",
    "torn",
    "zero byte",
)
"""One of each kind."""


@pytest.mark.parametrize("read", [read_candidates, read_settings])
def test_no_reader_of_files_lets_it_through_or_waits_for_one_that_never_ends(
    tmp_path: Path, read: Any
) -> None:
    for name in SOME:
        (tmp_path / "file.yaml").write_text(HOSTILE[name][0])
        with within(10, 100), pytest.raises(TwinmatchError, match=r"file\.yaml"):
            read(tmp_path / "file.yaml")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "long").write_bytes(b" " * (MAX_BYTES + 1))
    for path, message in (
        (tmp_path / "pipe", "is a pipe, a device or a socket"),
        (Path("/dev/zero"), "is a pipe, a device or a socket"),
        (tmp_path / "long", f"has more than {MAX_BYTES} bytes"),
        (tmp_path / ("x" * 300), "File name too long"),
        (tmp_path, "is a folder"),
        (tmp_path / "none", "No such file"),
    ):
        with within(10, 50), pytest.raises(TwinmatchError, match=message):
            read(path)


def test_metadata_and_qualities_of_service_that_would_do_harm_are_none(
    tmp_path: Path,
) -> None:
    for name in SOME:
        (tmp_path / "metadata.yaml").write_text(text := HOSTILE[name][0])
        with within(10, 100):
            assert files_listed(tmp_path) == []
            assert parse_qos(text) == Qos()


def entry(**changes: object) -> str:
    fields = {"name": "a", "operating_point": 50.0, "seebeck": 0.08} | changes
    return (
        "candidates:\n  - {"
        + ", ".join(f"{key}: {value}" for key, value in fields.items())
        + "}\n"
    )


@pytest.mark.parametrize(
    "field", ["operating_point", "seebeck", "conductance", "name", "plant", "structure"]
)
@pytest.mark.parametrize(
    "value",
    [
        "1" + "0" * 400,
        "9" * 5000,
        "1.0e+999",
        ".nan",
        "[1]",
        "{a: 1}",
        "2022-13-45",
        "true",
        "null",
        '"\\e[2J"',
    ],
)
def test_no_field_of_a_candidate_takes_what_it_cannot_be(
    field: str, value: str
) -> None:
    with within(10, 50):
        try:
            (candidate,) = parse_candidates(entry(**{field: value}), "file")
        except TwinmatchError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert str(error).isprintable()  # noqa: PT017
            assert len(str(error)) < 800  # noqa: PT017
        else:
            if value == "[1]":
                assert (field, candidate.operating_point) == ("operating_point", 1.0)
                return
            assert field in {"name"}
            assert candidate.name in {"2022-13-45", "True", "None"}


def test_an_operating_point_is_a_reading_that_the_sensor_can_give() -> None:
    for value in (".inf", "-.inf", "-300.0", "1.0e+6", "1.0e+300"):
        with pytest.raises(
            CandidateFileError, match=r"1: operating_point is .* give a value within"
        ):
            parse_candidates(entry(operating_point=value), "file")


@pytest.mark.parametrize("option", ["--candidates", "--config"])
@pytest.mark.parametrize("name", ["laughs", "large", "deep lists"])
def test_commands_end_with_one_line(
    tmp_path: Path, capsys: Any, option: str, name: str
) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(HOSTILE[name][0])
    assert (
        main(["replay", str(PROJECT / "bags" / "four_setpoints"), option, str(path)])
        == 2
    )
    assert capsys.readouterr().err.count("\n") == 1


# Files of candidates: plants, structures, names, and files from before there were structures.


def entry_candidates(text: str) -> str:
    return f"candidates:\n  - {{name: a, operating_point: 50.0, {text}}}\n"


def test_the_papers_family_has_the_papers_structure() -> None:
    family = read_candidates(PROJECT / "config" / "paper_candidates.yaml")
    assert [c.operating_point for c in family] == [30.0, 50.0, 70.0, 90.0]
    assert family[0].parameters == rig(
        seebeck=0.0963, conductance=0.3, heat_capacity=34.9
    )
    assert {c.parameters.model for c in family} == {Peltier.model()}


def test_remembered_candidates_come_back_from_their_text_bit_for_bit() -> None:
    free = Peltier.model().structure.free
    spread = np.diag(np.square([0.1 / 3.0, 1.0 / 7.0, 2.0 / 3.0]))
    remembered = Candidate(
        "remembered", 50.0, rig(seebeck=0.1 / 3.0), None, free, spread
    )
    exact = Candidate("paper", 30.0, rig("sink with mass"), None)
    read = parse_candidates(candidates_text([remembered, exact]), "file")
    assert [(c.name, c.operating_point, c.parameters, c.free) for c in read] == [
        (c.name, c.operating_point, c.parameters, c.free) for c in (remembered, exact)
    ]
    np.testing.assert_allclose(np.diag(read[0].covariance), np.diag(spread), rtol=1e-15)
    assert [c.remembered for c in read] == [True, False]
    assert candidates_text(read) == candidates_text(
        parse_candidates(candidates_text(read), "file")
    )


def test_a_structure_is_taken_by_its_name() -> None:
    text = entry_candidates(
        "plant: peltier, structure: 'sink with mass, sensor lag', sensor_lag: 0.4"
    )
    (candidate,) = parse_candidates(text, "family")
    assert candidate.parameters == rig("sink with mass, sensor lag", sensor_lag=0.4)


def test_without_a_structure_the_values_say_which_parts_there_are() -> None:
    (candidate,) = parse_candidates(
        entry_candidates("sink_heat_capacity: 250.0, sink_convection: 6.0"), "family"
    )
    assert candidate.parameters == rig(
        "sink with mass", sink_heat_capacity=250.0, sink_convection=6.0
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "seebek: 0.1",
            "no parameter 'seebek' in this structure; it has seebeck, resistance",
        ),
        ("seebeck: high", "seebeck: is 'high'; give a number"),
        ("seebeck: -1.0", "seebeck is -1 V/K; it must be finite and at least 0"),
        ("plant: kettle", "plant 'kettle': not known; choose from peltier"),
        ("structure: two sinks", "no structure 'two sinks'; it has held sink"),
        (
            "structure: held sink, sensor_lag: 1.0",
            "no parameter 'sensor_lag' in this structure",
        ),
        ("deviations: 3", "deviations: is 3; give names with values"),
        (
            "deviations: {seebeck: 0.01}",
            "'held sink' needs those of seebeck, conductance, heat",
        ),
        (
            "deviations: {seebeck: high}",
            "deviation of seebeck: is 'high'; give a number",
        ),
        (
            "deviations: {seebeck: 0.01, conductance: 0.0, heat_capacity: 1}",
            "deviation of conductance is 0; give a positive finite number",
        ),
    ],
)
def test_what_no_candidate_can_be_is_refused_in_words(text: str, message: str) -> None:
    with pytest.raises(CandidateFileError) as caught:
        parse_candidates(entry_candidates(text), "family")
    assert str(caught.value).startswith("family: candidate 1: ")
    assert message in str(caught.value)


OLD = {
    "seebeck": 0.06, "resistance": 3.3, "conductance": 0.5, "heat_capacity": 27.0, "ambient": 295.0,
    "sink_heat_capacity": math.inf, "sink_convection": 0.0, "sensor_lag": 0.0, "seebeck_slope": 0.0,
    "drive_ripple": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "structure"),
    [
        ({}, "held sink"),
        ({"sink_heat_capacity": 250.0}, "sink with mass"),
        (
            {"sink_heat_capacity": 250.0, "sensor_lag": 0.5},
            "sink with mass, sensor lag",
        ),
        (
            {"sink_heat_capacity": 250.0, "seebeck_slope": 1e-4},
            "sink with mass, free ambient, switched drive, α(T)",
        ),
        (
            {"sink_heat_capacity": 250.0, "sensor_lag": 0.5, "seebeck_slope": 1e-4},
            "sink with mass, free ambient, switched drive, sensor lag, α(T)",
        ),
    ],
)
def test_what_was_written_down_before_plants_had_structures(
    changes: dict[str, float], structure: str
) -> None:
    """Every number that meant something then is there, and has the value it had."""
    values = OLD | changes
    parameters = parameters_from("", "", values)
    assert parameters.model is Peltier.model(structure)
    assert all(
        parameters[name] == value
        for name, value in values.items()
        if name in parameters
    )
    assert {
        name for name, value in values.items() if value and math.isfinite(value)
    } <= set(parameters)


def test_a_sink_that_was_held_beside_a_lag_is_a_sink_that_hardly_moves() -> None:
    parameters = parameters_from("peltier", "", OLD | {"sensor_lag": 0.5})
    assert parameters["sensor_lag"] == 0.5
    assert parameters["sink_heat_capacity"] > 1e9


# Our definitions are those of the installed messages, the hashes those of ROS 2; schemas of any types.

SOURCE = Path(messages.__file__).parents[2] / "twinmatch_msgs" / "msg"


def test_loop_sample_is_the_text_of_our_message_package() -> None:
    if not SOURCE.is_dir():
        pytest.skip("the sources of twinmatch_msgs are not beside this package")
    assert SAMPLE.schema.startswith((SOURCE / "LoopSample.msg").read_text("utf-8"))


@pytest.mark.parametrize("topic", PLANT_TOPICS, ids=lambda t: t.type)
def test_schemas_and_hashes_are_the_installed_ones(topic: Topic) -> None:
    if not (Path(sys.prefix) / "share" / "twinmatch_msgs").is_dir():
        pytest.skip("twinmatch_msgs is not built; run make setup")
    assert bare(schema_of(topic.type)) == bare(topic.schema)
    package, _, short = topic.type.split("/")
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    paths = (
        Path(prefix) / "share" / package / "msg" / f"{short}.json"
        for prefix in prefixes
        if prefix
    )
    if (path := next(filter(Path.is_file, paths), None)) is None:
        pytest.skip(f"no hashes of {package} are installed to compare with")
    published = json.loads(path.read_text("utf-8"))["type_hashes"]
    assert {h["type_name"]: h["hash_string"] for h in published}[
        topic.type
    ] == topic.type_hash


@pytest.mark.parametrize("topic", PLANT_TOPICS, ids=lambda t: t.type)
def test_hashes_are_those_of_an_independent_implementation(topic: Topic) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(topic.schema, topic.type))
    assert store.hash_rihs01(topic.type) == topic.type_hash


def test_schema_names_each_part_once() -> None:
    headings = [line for line in SAMPLE.schema.splitlines() if line.startswith("MSG: ")]
    assert headings == ["MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]


def test_fields_ignore_comments_and_blanks():
    text = "# a\nfloat64   x  # metres\n\n" + "=" * 80 + "\nMSG: a/B\nint8 y\n"
    assert fields_of(text) == ["float64 x"]


def install(folder: Path, **texts: str) -> dict[str, str]:
    for name, text in texts.items():
        path = folder / "share" / "rig_msgs" / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return {"AMENT_PREFIX_PATH": f"/nowhere:{folder}"}


def test_parts_come_once_and_in_their_order(tmp_path):
    environment = install(
        tmp_path,
        Frame="# a Nothing here\nuint8 KIND=3\nPixel[<=4] pixels\nrig_msgs/msg/Lens lens\nstring<=9 name\n",
        Pixel="float64[2] at\nbool DEAD = true # Ghost x\n",
        Lens="Pixel centre\n",
    )
    blocks = schema_of("rig_msgs/msg/Frame", environment).split("=" * 80 + "\n")
    assert [block.split("\n")[0] for block in blocks[1:]] == [
        "MSG: rig_msgs/Pixel",
        "MSG: rig_msgs/Lens",
    ]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (
            "rig_msgs/msg/Ghost",
            "the definition of rig_msgs/msg/Ghost is not installed; looked in /nowhere",
        ),
        ("rig_msgs/msg/Frame", "the definition of rig_msgs/msg/Pixel is not installed"),
        ("../../etc/passwd", "is not a message type"),
        ("rig_msgs/srv/Ask", "is not a message type"),
    ],
)
def test_what_is_not_installed_is_named(tmp_path, kind, message):
    with pytest.raises(SessionError, match=message):
        schema_of(kind, install(tmp_path, Frame="Pixel pixel\n"))
