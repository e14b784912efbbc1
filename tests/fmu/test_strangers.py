"""FMUs that mean no good, or are none: each ends in one clear line, and nothing else suffers."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.fmus import RATE, build_c_fmu, build_python_fmu, write_map
from tests.support.waiting import wait_for
from twinmatch.cli import main
from twinmatch.dynamics import (
    Model,
    PlantError,
    StructureLostError,
    begin,
    simulate_driven,
)
from twinmatch.fmu import adopt_fmus, archive, structure
from twinmatch.fmu.archive import FmuError, Variable, VariableNames
from twinmatch.plants import Peltier


@pytest.fixture
def run_of(
    adopted: Callable[..., Model], tmp_path: Path
) -> Callable[[str], Callable[[], None]]:
    """Something that runs an FMU with a flaw for eight minutes."""

    def runner(culprit: str, **changes: object) -> Callable[[], None]:
        fmu = build_python_fmu(
            tmp_path, f"F{abs(hash(culprit))}", culprit=culprit, steps=2
        )
        parameters = adopted(fmu, culprit, **changes).parameters()
        return lambda: str(
            simulate_driven(
                parameters, np.zeros(480), states=begin(parameters, 30.0)
            ).output
        )

    return runner


@pytest.mark.parametrize("culprit", ["hangs", "spins"])
def test_one_that_takes_too_long_is_ended(run_of, culprit: str, capfd) -> None:
    run = run_of(culprit, patience=1.0)
    with pytest.raises(StructureLostError, match="no answer within 1 s and was killed"):
        run()
    with pytest.raises(StructureLostError):  # at once, and without a second line
        run()
    assert (
        capfd.readouterr().err.count("everything else continues without this structure")
        == 1
    )


@pytest.mark.parametrize(
    ("culprit", "words"),
    [("crashes", "crashed .SIGSEGV."), ("ends", "exited with code 3")],
)
def test_one_that_crashes_is_given_up(run_of, culprit: str, words: str) -> None:
    with pytest.raises(StructureLostError, match=words):
        run_of(culprit)()


@pytest.mark.parametrize("culprit", ["refuses", "eats"])
def test_one_that_says_it_cannot_is_asked_again(run_of, culprit: str) -> None:
    run = run_of(culprit)
    for _ in range(2):
        with pytest.raises(FmuError, match="the FMU reports"):
            run()


def test_one_that_gives_no_numbers_is_not_believed(run_of, adopted, tmp_path) -> None:
    with pytest.raises(FmuError, match="no finite values"):
        run_of("says nothing")()
    worse = build_python_fmu(
        tmp_path, "Worse", rate=RATE.replace("return -drawn", "return float('nan')")
    )
    with pytest.raises(FmuError, match="no finite values"):
        adopted(worse)


def test_one_that_hangs_before_it_is_adopted_is_one_line(tmp_path: Path, capfd) -> None:
    rate = RATE.replace(
        "bridge = ", "import time; time.sleep(3600 * (self.pwm != 0.0)); bridge = ", 1
    )
    fmu = build_python_fmu(tmp_path, "Sleeper", rate=rate, steps=2)
    with pytest.raises(StructureLostError, match="no answer within 1 s and was killed"):
        adopt_fmus(write_map(tmp_path, fmu, patience=1.0))
    assert not capfd.readouterr().err


def test_what_one_prints_is_not_an_answer(run_of) -> None:
    assert "nan" not in run_of("prints")()


def test_one_that_remembers_more_than_its_map_says_is_refused(
    adopted, tmp_path: Path
) -> None:
    after = "self.inner += 0.2 * (self.plate - 273.15 - self.inner)"
    fmu = build_python_fmu(
        tmp_path, "Lagging", output="self.inner", after=after, steps=4
    )
    with pytest.raises(
        FmuError, match="it has internal states that its map does not name"
    ):
        adopted(fmu)


SWITCHED = RATE.replace("self.pwm / 255.0", "self.pwm * (1 - self.inner) / 255.0")
WALLED = RATE.replace("(plate - self.ambient)", "(plate - self.ambient - self.inner)")


@pytest.mark.parametrize(
    ("rate", "after"),
    [
        (
            SWITCHED,
            "self.inner = float(self.plate > 335 or (self.inner and self.plate > 325))",
        ),
        (
            WALLED,
            "self.inner += size / 2000 * (self.plate - self.ambient - self.inner)",
        ),
    ],
    ids=["a cut-out with hysteresis", "a wall of 2000 s"],
)
def test_a_memory_that_shows_late_is_found(
    adopted, tmp_path: Path, rate: str, after: str
) -> None:
    fmu = build_python_fmu(tmp_path, "Mindful", rate=rate, after=after, steps=4)
    with pytest.raises(
        FmuError, match="it has internal states that its map does not name"
    ):
        adopted(fmu)


def test_a_restart_forgets_what_ran_before(
    adopted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cut-out that no state shows is refused; unrefused, equal states and drives give equal courses."""
    fmu = build_c_fmu(tmp_path, cut_out=True)
    with pytest.raises(
        FmuError, match="it has internal states that its map does not name"
    ):
        adopted(fmu)
    monkeypatch.setattr(structure, "check_restart", lambda _: None)
    parameters = adopted(fmu).parameters()
    drive = np.full(20, 120.0)
    # below where it switches off, above where it switches on again
    states = begin(parameters, 57.0)
    first = simulate_driven(parameters, drive, states=states).output
    hot = simulate_driven(parameters, drive, states=begin(parameters, 70.0)).output
    assert hot[1] < hot[0]
    np.testing.assert_array_equal(
        simulate_driven(parameters, drive, states=states).output, first
    )


def test_what_is_discrete_is_refused_and_what_is_not_a_real_scalar_is_listed(
    exchange_fmu: Path, third_fmu: Path, tmp_path: Path, adopted, capsys
) -> None:
    declarations = (
        '<ScalarVariable name="off" valueReference="50" causality="local"><Boolean/></ScalarVariable>'
        '<ScalarVariable name="stages" valueReference="51" causality="parameter" variability="fixed">'
        '<Integer start="3"/></ScalarVariable>'
        '<ScalarVariable name="maker" valueReference="52" causality="output"><String/></ScalarVariable>'
    )
    fmu = _described(
        exchange_fmu,
        tmp_path,
        ("</ModelVariables>", f"{declarations}</ModelVariables>"),
    )
    with pytest.raises(
        FmuError, match=r"its discrete variables \(off\) may remember earlier events"
    ):
        adopted(fmu)
    assert main(["fmu", str(fmu)]) == 0
    printed = capsys.readouterr().out.replace("# ", "")
    assert (
        "not real and scalar, so not for a map:\n  off: Boolean, local, discrete\n"
        in printed
    )
    assert "  stages: Integer, parameter, fixed\n" in printed
    assert "  maker: String, output, discrete\n" in printed
    assert "It cannot be used: its discrete variables (off) " in printed
    declarations = (
        '<Float64 name="profile" valueReference="50" causality="parameter" variability="fixed" start="1 2 3">'
        '<Dimension start="3"/></Float64>'
    )
    (tmp_path / "third").mkdir()
    fmu = _described(
        third_fmu,
        tmp_path / "third",
        ("</ModelVariables>", f"{declarations}</ModelVariables>"),
    )
    assert main(["fmu", str(fmu)]) == 0
    assert "  profile: Float64[3], parameter, fixed\n" in capsys.readouterr().out


@pytest.mark.usefixtures("own_programs")
def test_its_process_sees_no_socket_and_no_secret_and_ends_with_the_structure(
    run_of, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TWINMATCH_SECRET", "open sesame")
    run_of("")()
    source = _source()
    process = Path(f"/proc/{source.start().pid}")
    folder = source.start().folder
    fds = [str(link.readlink()) for link in (process / "fd").iterdir()]
    assert not [name for name in fds if name.startswith("socket:")]
    assert b"open sesame" not in (process / "environ").read_bytes()
    source.close()
    assert not process.exists()
    assert not folder.exists()


def _source() -> Any:
    """Of the only FMU that is taken in."""
    return next(
        s.external for s in Peltier.structures.values() if s.external is not None
    )


def _sleeping() -> bool:
    """Whether the program that an FMU left is running."""
    wanted = b"sleep\x00600.125\x00"
    lines = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            lines.append(file.read_bytes())
    return wanted in lines


@pytest.mark.usefixtures("own_programs")
def test_what_it_started_ends_with_it_in_whatever_session(run_of) -> None:
    run_of("leaves a program")()
    assert _sleeping()
    _source().close()
    assert not _sleeping()


ORPHAN = """
import os, signal, sys
from twinmatch.fmu.process import FmuProcess
process = FmuProcess()
print(process.pid, process.folder, flush=True)
sys.stdin.readline()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_its_process_and_folder_go_when_its_parent_is_killed() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ORPHAN],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as parent:
        pid, folder = parent.stdout.readline().split()  # type: ignore[union-attr]
        parent.communicate("go\n")
    wait_for(
        lambda: not (Path(f"/proc/{pid}").exists() or Path(folder).exists()),
        "their end",
    )


def test_one_for_another_machine_is_refused(exchange_fmu: Path, tmp_path: Path) -> None:
    def rename(name: str) -> str:
        return name.replace("linux64", "win64").replace(".so", ".dll")

    fmu = _changed(exchange_fmu, tmp_path, rename=rename)
    with pytest.raises(
        FmuError, match="has binaries for win64; this machine is linux64"
    ):
        adopt_fmus(write_map(tmp_path, fmu))


@pytest.mark.parametrize(
    "name", ["../../escaped", "/tmp/escaped", "..\\escaped", "c:escaped"]
)
def test_what_leads_out_of_the_archive_is_not_unpacked(
    exchange_fmu: Path, tmp_path: Path, name: str
) -> None:
    fmu = _changed(exchange_fmu, tmp_path, replaced={name: b"x"})
    with pytest.raises(FmuError, match="a path outside its folder; it is not unpacked"):
        adopt_fmus(write_map(tmp_path, fmu))
    assert not list(tmp_path.parent.glob("escaped"))


def test_a_link_is_not_unpacked(exchange_fmu: Path, tmp_path: Path) -> None:
    fmu = _changed(exchange_fmu, tmp_path)
    link = zipfile.ZipInfo("resources/passwd")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(fmu, "a") as opened:
        opened.writestr(link, "/etc/passwd")
    with pytest.raises(FmuError, match="has the link 'resources/passwd'"):
        adopt_fmus(write_map(tmp_path, fmu))


def test_a_bomb_is_not_unpacked(exchange_fmu: Path, tmp_path: Path) -> None:
    fmu = _changed(exchange_fmu, tmp_path)
    with zipfile.ZipFile(fmu, "a") as opened:
        opened.writestr("resources/zeros", b"0")
        opened.filelist[-1].file_size = 1 + archive.MAX_BYTES  # as its directory says
    with pytest.raises(FmuError, match="the limit is 512 MiB"):
        adopt_fmus(write_map(tmp_path, fmu))


def test_no_more_is_unpacked_than_the_archive_states(tmp_path: Path) -> None:
    """Its directory says ten bytes, of a mebibyte or of the first ten."""
    for named, length, refused in (("long", 1 << 20, True), ("cut", 10, False)):
        fmu = tmp_path / f"{named}.fmu"
        content = bytes(1 << 20)
        with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as opened:
            opened.writestr("zeros", content)
            opened.filelist[0].file_size = 10
            opened.filelist[0].CRC = zlib.crc32(content[:length])
        words = "is not an FMU, or is damaged: Bad CRC-32 for file 'zeros'"
        with (
            pytest.raises(FmuError, match=words)
            if refused
            else contextlib.nullcontext()
        ):
            archive.unpack(fmu, tmp_path / named)
        assert (tmp_path / named / "zeros").stat().st_size <= 10


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (
            b"<fmiModelDescription",
            "modelDescription|XML|Couldn't find end|not well-formed",
        ),
        (b"", "modelDescription|XML|Document is empty"),
        (b'<fmiModelDescription fmiVersion="1.0" modelName="x" guid="y"/>', "."),
        (b"\x00\xff\x00", "."),
    ],
)
def test_a_broken_description_is_one_line(
    exchange_fmu: Path, tmp_path: Path, xml: bytes, words: str, capsys
) -> None:
    fmu = _changed(exchange_fmu, tmp_path, replaced={"modelDescription.xml": xml})
    assert main(["fmu", str(fmu)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert str(fmu) in lines[0]
    assert re.search(words, lines[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "co-simulation"}, "it supports model exchange, not co-simulation"),
        ({"kind": "magic"}, "kind is 'magic'"),
        ({"free": ["colour"]}, "free names 'colour'"),
        ({"starts": {}}, "starts has no entry for plate"),
        ({"starts": {"plate": "__import__('os')"}}, "is not a formula"),
        ({"starts": {"plate": "sink + 1"}}, "names 'sink'"),
        ({"patience": 0}, "patience is 0 s; give a positive number"),
        ({"patience": "long"}, "patience: is 'long'; give a number"),
        ({"surprise": 1}, "surprise: is not a known key"),
        ({"variables": {"temperature": "celsius"}}, "variables has no entry for pwm"),
        (
            {"parameters": {"k": {"default": 1, "bounds": [2, 1]}}},
            "two finite numbers, the smaller first",
        ),
    ],
)
def test_a_wrong_map_is_reported(
    exchange_fmu: Path, tmp_path: Path, changes, words: str
) -> None:
    with pytest.raises(FmuError, match=words):
        adopt_fmus(write_map(tmp_path, exchange_fmu, **changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"plate": "plates"},
            "has no real variable 'plates'; `twinmatch fmu` lists those it has",
        ),
        (
            {"plate": "celsius"},
            "its continuous states are plate; the map does not name 'plate'",
        ),
        ({"pwm": "celsius"}, r"'celsius' is not an input .*; its inputs are pwm"),
    ],
)
def test_a_variable_that_does_not_fit_is_reported(
    adopted, exchange_fmu: Path, changes: dict[str, str], words: str
) -> None:
    links = {"temperature": "celsius", "pwm": "pwm", "plate": "plate", **changes}
    with pytest.raises(FmuError, match=words):
        adopted(exchange_fmu, variables=links, free=[])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ('Identifier="plate"', 'Identifier="../../../../tmp/plate"'),
            "FMI demands a name of C",
        ),
        (
            ('<Unknown index="4"', '<Unknown index="99"'),
            "its modelDescription.xml does not follow FMI 2.0",
        ),
        (
            ('fmiVersion="2.0"', 'fmiVersion="1.0"'),
            "it is of FMI 1.0; FMI 2 and 3 are supported",
        ),
        (
            ('fmiVersion="2.0"', ""),
            "it is of FMI without version; FMI 2 and 3 are supported",
        ),
        (("held-sink", "another"), "it cannot be instantiated"),
    ],
)
def test_a_description_that_is_wrong_is_reported(
    exchange_fmu: Path, tmp_path: Path, adopted, change: tuple[str, str], words: str
) -> None:
    with pytest.raises(FmuError, match=words):
        adopted(_described(exchange_fmu, tmp_path, change))


def test_an_invalid_or_missing_library_is_reported(
    exchange_fmu: Path, tmp_path: Path, adopted
) -> None:
    path = "binaries/linux64/plate.so"
    with pytest.raises(
        FmuError, match=f"its {path} is not a library for this machine: file too short"
    ):
        adopted(_changed(exchange_fmu, tmp_path, replaced={path: b"MZ"}))
    with pytest.raises(
        FmuError, match=f"it has no {path}, the program for this machine"
    ):
        adopted(
            _changed(
                exchange_fmu,
                tmp_path,
                rename=lambda name: name.replace("plate.so", "pl.so"),
            )
        )


def test_a_damaged_archive_and_a_pipe_are_refused(
    exchange_fmu: Path, tmp_path: Path
) -> None:
    content = bytearray(exchange_fmu.read_bytes())
    content[100:200] = bytes(range(100))
    (tmp_path / "damaged.fmu").write_bytes(content)
    with pytest.raises(FmuError, match="is not an FMU, or is damaged"):
        adopt_fmus(write_map(tmp_path, tmp_path / "damaged.fmu"))
    os.mkfifo(tmp_path / "pipe.fmu")
    with pytest.raises(FmuError, match="does not exist or is not a file"):
        adopt_fmus(write_map(tmp_path, tmp_path / "pipe.fmu"))


def test_a_file_that_changed_is_not_run(
    exchange_fmu: Path, tmp_path: Path, adopted
) -> None:
    fmu = _changed(exchange_fmu, tmp_path)
    model = adopted(fmu)
    source = model.structure.external
    source.close()
    with zipfile.ZipFile(fmu, "a") as opened:
        opened.writestr("resources/more", b"x")
    with pytest.raises(PlantError, match="has changed since it was added to the plant"):
        begin(model.parameters(), 30.0) is not None and source.start()


def _described(fmu: Path, folder: Path, change: tuple[str, str]) -> Path:
    """The FMU with something else in its description."""
    with zipfile.ZipFile(fmu) as opened:
        xml = opened.read("modelDescription.xml").decode()
    assert change[0] in xml
    return _changed(
        fmu, folder, replaced={"modelDescription.xml": xml.replace(*change).encode()}
    )


def _changed(
    fmu: Path,
    folder: Path,
    rename=lambda name: name,
    replaced: dict[str, bytes] | None = None,
) -> Path:
    """The FMU with other names or other files in it."""
    changed = folder / f"changed_{fmu.name}"
    with (
        zipfile.ZipFile(fmu) as old,
        zipfile.ZipFile(changed, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            if name not in (replaced or {}):
                new.writestr(rename(name), old.read(name))
        for name, data in (replaced or {}).items():
            new.writestr(name, data)
    return changed


def test_a_large_description_is_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With more than 16 MiB of names and remarks, as tools write them for large models."""
    remark = "x" * 4000
    scalars = "".join(
        f'<ScalarVariable name="part.{k}" valueReference="{k}" causality="parameter" variability="fixed" '
        f'initial="exact" description="{remark}"><Real start="1.0"/></ScalarVariable>'
        for k in range(5000)
    )
    xml = (
        '<fmiModelDescription fmiVersion="2.0" modelName="Large" guid="g"><CoSimulation modelIdentifier="L"/>'
        f"<ModelVariables>{scalars}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    file = tmp_path / "large.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", xml)
    assert main(["fmu", str(file)]) == 0
    listed = capsys.readouterr().out
    assert "and 4940 more" in listed
    assert "declared under parameters: part.4999:" in listed


def test_of_variables_with_like_names_the_first_is_proposed() -> None:
    def variable(name: str) -> Variable:
        return Variable(name, 0, "parameter", "fixed", "exact", "", 1.0, "", -1)

    names = VariableNames(
        [variable("other"), variable("cooler.See_beck"), variable("seebeck")]
    )
    liked = names.like(Peltier.parameters["seebeck"])
    assert liked is not None
    assert liked.name == "cooler.See_beck"
    assert names.like(Peltier.parameters["heat_capacity"]) is None
