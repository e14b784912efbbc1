"""Repairing sessions: nothing readable is lost, nothing is changed without need, the result is a bag."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader

from twinmatch.cli import main
from twinmatch.sessions import Qos, SessionError, SessionWriter, Topic, read_session
from twinmatch.sessions import recording as repairing
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.sessions.recording import repair_session
from twinmatch.sessions.records import MAGIC, Walk
from twinmatch.signals import Sample

SECOND = 10**9
INDEXES = (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.FOOTER)
NOTE = Topic("/notes", "std_msgs/msg/String", "string data\n", "RIHS01_ab", Qos())


def record(
    folder: Path, count: int = 60, *, split: int = 0, finish: bool = False
) -> Path:
    """A session that was flushed every ten samples; not finished, as after a kill."""
    writer = SessionWriter(folder, ros_distro="kilted")
    writer.add_record("twinmatch/parameters/matcher", {"seed": "7"})
    writer.add_topic(SAMPLE)
    writer.add_topic(NOTE)
    for k in range(count):
        writer.write(
            SAMPLE.name,
            encode_sample(Sample(k, k * SECOND, 30.0, 25.0, 1.0)),
            k * SECOND,
        )
        if k % 10 == 9:
            writer.flush()
        if split and k % split == split - 1:
            writer.split()
    writer.close() if finish else writer.abandon()
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def indices(folder: Path) -> list[int]:
    return [sample.index for sample in read_session(folder).samples]


def check_whole(folder: Path, count: int) -> None:
    session = read_session(folder)
    assert session.notes == []
    assert [s.index for s in session.samples] == list(range(count))
    with Reader(folder) as reader:
        assert reader.message_count == count
        assert [t for _, t, _ in reader.messages()] == [
            k * SECOND for k in range(count)
        ]
    assert [p.name for p in folder.parent.iterdir()] == [folder.name], (
        "nothing is left beside it"
    )


@pytest.mark.parametrize("split", [0, 25])
def test_a_killed_recording_is_made_whole(tmp_path, split):
    folder = record(tmp_path / "run", split=split)
    repair = repair_session(folder)
    assert (repair.messages, repair.duration, repair.original) == (60, 59.0, None)
    assert any("truncated" in fault for fault in repair.faults)
    check_whole(folder, 60)
    assert read_session(folder).records["twinmatch/parameters/matcher"] == {"seed": "7"}
    assert {t.name for t in read_session(folder).topics} == {"/plant/sample", "/notes"}
    files = [p.name for p in sorted(folder.glob("*.mcap"))]
    assert (
        files == ["run_0.mcap"]
        if not split
        else ["run_0.mcap", "run_1.mcap", "run_2.mcap"]
    )


@pytest.mark.parametrize("finish", [True, False])
def test_a_whole_session_is_left_alone_also_by_a_second_repair(tmp_path, finish):
    folder = record(tmp_path / "run", finish=finish)
    if not finish:
        repair_session(folder)
    before = content(folder)
    repair = repair_session(folder)
    assert (repair.faults, repair.messages, repair.original) == ((), 60, None)
    assert content(folder) == before


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    return (
        record(tmp_path_factory.mktemp("killed") / "run") / "run_0.mcap"
    ).read_bytes()


@settings(max_examples=20)
@given(cut=st.integers(1, 8000))
def test_whatever_can_be_read_of_a_torn_file_is_kept(tmp_path_factory, killed, cut):
    folder = tmp_path_factory.mktemp("cut") / "run"
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(killed[: max(1, len(killed) - cut)])
    try:
        readable = indices(folder)
    except SessionError:
        before = content(folder)
        with pytest.raises(SessionError):
            repair_session(folder)
        assert content(folder) == before
        return
    assert repair_session(folder).messages == len(readable)
    check_whole(folder, len(readable))


@pytest.mark.parametrize(
    ("spoil", "faults"),
    [
        (
            lambda f: (f / "metadata.yaml").unlink(),
            ("metadata.yaml is missing or unreadable",),
        ),
        (
            lambda f: (f / "run_0.mcap").rename(f / "other_0.mcap"),
            ("metadata.yaml does not list the files that exist",),
        ),
        (
            lambda f: (f / "run_1.mcap").touch(),
            ("run_1.mcap is empty", "metadata.yaml does not list the files that exist"),
        ),
    ],
)
def test_whole_files_are_kept_whatever_is_beside_them(tmp_path, spoil, faults):
    folder = record(tmp_path / "run", finish=True)
    spoil(folder)
    assert repair_session(folder).faults == faults
    check_whole(folder, 60)


def test_of_a_damaged_session_the_original_is_kept(tmp_path, capsys):
    folder = record(tmp_path / "run", finish=True)
    file = folder / "run_0.mcap"
    data = bytearray(file.read_bytes())
    place = data.index(encode_sample(Sample(33, 33 * SECOND, 30.0, 25.0, 1.0)))
    data[place : place + 60] = bytes(60)
    file.write_bytes(data)
    before = content(folder)
    shutil.copytree(folder, tmp_path / "same")
    assert main(["repair", str(tmp_path / "same")]) == 0
    assert (
        f"the original was kept: {tmp_path / 'same'}.broken" in capsys.readouterr().out
    )
    repair = repair_session(folder)
    assert repair.original == tmp_path / "run.broken"
    assert content(repair.original) == before
    assert "only 59 of 60 messages are left" in repair.faults[0]
    assert indices(folder) == [k for k in range(60) if k != 33]
    assert any(
        "only 59 of 60 messages are left" in loss
        for loss in read_session(folder).missing
    )
    with Reader(folder) as reader:
        assert reader.message_count == repair.messages
    assert repair_session(folder).faults == ()
    (folder / "metadata.yaml").unlink()
    with pytest.raises(SessionError, match=r"run\.broken of an earlier repair exists"):
        repair_session(folder)


def test_the_distribution_is_kept(tmp_path):
    folder = record(tmp_path / "run", finish=True)
    with (folder / "run_0.mcap").open("r+b") as stream:
        stream.truncate(3000)
    repair_session(folder)
    assert "ros_distro: kilted" in (folder / "metadata.yaml").read_text()


def test_a_repair_that_was_interrupted_is_done_again(tmp_path):
    record(tmp_path / "run").rename(tmp_path / "run.broken")
    assert repair_session(tmp_path / "run").messages == 60
    check_whole(tmp_path / "run", 60)


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda _: None, "does not exist"),
        (lambda path: path.mkdir(), "the folder has no MCAP file"),
        (lambda path: path.touch(), "is a file; give its folder"),
        (
            lambda path: (path.mkdir(), (path / "run_0.mcap").touch()),
            "run_0.mcap is empty.*; no message",
        ),
        (
            lambda path: (path.mkdir(), (path / "a.mcap").write_text("no such thing")),
            "does not begin like an MCAP file",
        ),
    ],
)
def test_what_is_not_a_session_is_said(tmp_path, prepare, message):
    prepare(tmp_path / "run")
    with pytest.raises(SessionError, match=message):
        repair_session(tmp_path / "run")


def less(copy: Path) -> None:
    shutil.rmtree(copy)
    record(copy, 59, finish=True)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (less, "the repaired copy differs from the original; nothing was changed"),
        (
            lambda copy: (copy / "metadata.yaml").unlink(),
            r"repaired copy has faults \(metadata.yaml is missing",
        ),
    ],
)
def test_a_copy_that_is_not_the_same_does_not_take_the_place(
    tmp_path, monkeypatch, spoil, message
):
    folder = record(tmp_path / "run")
    before = content(folder)
    real = repairing.rewrite
    monkeypatch.setattr(
        repairing, "rewrite", lambda copy, *more: (real(copy, *more), spoil(copy))
    )
    with pytest.raises(SessionError, match=message):
        repair_session(folder)
    assert content(folder) == before
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_what_the_disk_refuses_leaves_the_original(tmp_path, monkeypatch):
    folder = record(tmp_path / "run")
    before = content(folder)
    real = Path.rename

    def no_room(*_, **__):
        raise OSError(28, "No space left on device")

    def not_of_a_copy(self, target):
        if ".partial" in str(self):
            raise OSError(13, "Permission denied")
        return real(self, target)

    for owner, name, refuse, why in (
        (repairing.tempfile, "mkdtemp", no_room, "No space left on device"),
        (Path, "rename", not_of_a_copy, "Permission denied"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, refuse)
            with pytest.raises(SessionError, match=rf"cannot be repaired \({why}\)"):
                repair_session(folder)
        assert content(folder) == before


def test_the_command_says_what_was_saved(tmp_path, capsys):
    folder = record(tmp_path / "run")
    assert main(["repair", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "the file is truncated" in printed
    assert "60 messages over 59.0 s were saved" in printed
    assert main(["repair", str(folder)]) == 0
    assert (
        "complete, 60 messages over 59.0 s; nothing to repair"
        in capsys.readouterr().out
    )
    assert main(["repair", str(tmp_path / "nothing")]) == 2
    assert "does not exist" in capsys.readouterr().err


RECORDER = """
import sys
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE, Sample
from twinmatch.sessions.writer import SessionWriter
with SessionWriter(sys.argv[1]) as writer:
    writer.add_topic(SAMPLE)
    for k, split in enumerate(sys.stdin):
        writer.write(SAMPLE.name, encode_sample(Sample(k, k * 10**9, 30.0, 25.0, 1.0)), k * 10**9)
        writer.split() if split == "split\\n" else writer.flush()
        print(k, flush=True)
"""


def test_a_running_recorder_keeps_its_files_and_a_killed_one_lets_go(tmp_path):
    folder = tmp_path / "run"
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as recorder:
        for step in ("flush", "split", "flush"):
            # within a file, between two, and in the second
            print(step, file=recorder.stdin, flush=True)
            assert recorder.stdout.readline()
            before = content(folder)
            with pytest.raises(
                SessionError,
                match=r"run_\d.mcap is still being written; end its recorder",
            ):
                repair_session(folder)
            assert content(folder) == before
        recorder.send_signal(signal.SIGKILL)
    assert repair_session(folder).messages == 3
    check_whole(folder, 3)


def test_a_finished_or_abandoned_recorder_holds_nothing(tmp_path):
    assert repair_session(record(tmp_path / "whole", finish=True)).faults == ()
    writer = SessionWriter(tmp_path / "empty")
    writer.close()
    writer.close()
    assert repair_session(tmp_path / "empty").faults == ()


def test_messages_that_are_missing_are_counted_and_the_original_is_kept(tmp_path):
    folder = record(tmp_path / "run", split=25, finish=True)
    (folder / "run_1.mcap").unlink()
    before = content(folder)
    repair = repair_session(folder)
    assert repair.faults == (
        "metadata.yaml does not list the files that exist",
        "metadata.yaml lists other numbers of messages than the files hold: 60 of /plant/sample (35 found)",
    )
    assert (repair.messages, content(repair.original)) == (35, before)
    listed = yaml.safe_load((folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert (listed["message_count"], repair_session(folder).faults) == (35, ())


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("library", ["somebody", ""])
def test_what_others_have_written_is_refused_and_left_as_it_is(
    tmp_path, capsys, library, cut
):
    """JSON, IDL, compressed chunks, attachments: our copy would hold none of them."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    with (folder / "theirs_0.mcap").open("wb") as file:
        out = Writer(file, chunk_size=500, compression=CompressionType.ZSTD)
        out.start(profile="ros2", library=library)
        idl = b"module std_msgs { module msg { struct Float64 { double data; }; }; };"
        heater = out.register_channel(
            "/h", "cdr", out.register_schema("std_msgs/msg/Float64", "ros2idl", idl)
        )
        notes = out.register_channel(
            "/notes", "json", out.register_schema("Note", "jsonschema", b"{}")
        )
        out.add_attachment(0, 0, "calibration.yaml", "text/yaml", b"gain: 1.5")
        for k in range(100):
            out.add_message(heater, k, b"\0\1\0\0" + bytes(8), k)
            out.add_message(notes, k, b'{"note": "x"}', k)
        out.finish()
        file.truncate(file.tell() // 2 if cut else file.tell())
    before = content(folder)
    assert main(["repair", str(folder)]) == 2
    printed = capsys.readouterr().err
    assert (
        f"was written by {repr(library) if library else 'another program'}; nothing was changed"
        in printed
    )
    assert printed.count("\n") == 1
    assert content(folder) == before
    assert [p.name for p in tmp_path.iterdir()] == ["theirs"]


def test_what_two_repairs_have_lost_is_said_of_their_result(tmp_path):
    folder = record(tmp_path / "run", finish=True)
    for index in (33, 12):
        file = folder / "run_0.mcap"
        data = bytearray(file.read_bytes())
        place = data.index(
            encode_sample(Sample(index, index * SECOND, 30.0, 25.0, 1.0))
        )
        data[place : place + 60] = bytes(60)
        file.write_bytes(data)
        shutil.rmtree(repair_session(folder).original)
    (missing,) = read_session(folder).missing
    assert missing.startswith("it was repaired: ")
    assert "only 59 of 60 messages are left" in missing
    assert "only 58 of 59 messages are left" in missing


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_a_session_whose_index_is_wrong_is_not_called_complete(tmp_path, place):
    """Its messages can all be read, but a reader that uses the index would not find them."""
    folder = record(tmp_path / "run", finish=True)
    file = folder / "run_0.mcap"
    data = bytearray(file.read_bytes())
    records = [
        r for r in Walk(BytesIO(data), len(MAGIC), len(data)) if r.opcode in INDEXES
    ]
    of_messages = next(r for r in records if r.opcode == Opcode.MESSAGE_INDEX)
    of_chunks = next(r for r in records if r.opcode == Opcode.CHUNK_INDEX)
    footer = next(r for r in records if r.opcode == Opcode.FOOTER)
    wrong = (
        of_messages.begin + 6,
        of_messages.begin + 14,
        of_chunks.begin + 16,
        footer.begin,
    )[place]
    data[wrong] ^= 8
    file.write_bytes(data)
    assert len(indices(folder)) == 60
    (fault,) = repair_session(folder).faults
    assert "index" in fault or "strict reader" in fault
    assert repair_session(folder).faults == ()
    assert len(indices(folder)) == 60


def test_a_file_whose_author_cannot_be_read_is_repaired_and_kept(tmp_path):
    folder = record(tmp_path / "run", finish=True)
    file = folder / "run_0.mcap"
    file.write_bytes(file.read_bytes().replace(b"twinmatch", b"tw\xffnmatch", 1))
    repair = repair_session(folder)
    assert repair.original is not None
    assert repair.messages == 60
