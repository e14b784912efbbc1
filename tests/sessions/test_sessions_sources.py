"""One way to open a session or a recording."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

from twinmatch.sessions import EPOCH, RecordingError, SessionError, open_any, write_session
from twinmatch.signals import Sample

CSV = "time,reference,temperature,pwm\n" + "".join(f"{k},{30 + k // 4},25.5,{k}\n" for k in range(9))


def test_a_recording_opens_as_the_session_it_is_imported_as(tmp_path):
    (tmp_path / "run.csv").write_text(CSV)
    recording = open_any(tmp_path / "run.csv")
    session = open_any(write_session(tmp_path / "run", recording.samples))
    assert recording.samples == session.samples
    assert list(recording.messages()) == list(session.messages())
    assert recording.topics == session.topics
    for name in ("name", "topic", "counts", "start", "end", "notes", "period", "duration"):
        assert getattr(recording, name) == getattr(session, name)
    assert recording.samples[8] == Sample(8, EPOCH + 8 * 10**9, 32.0, 25.5, 8.0)


def test_a_mat_file_opens(tmp_path):
    scipy.io.savemat(
        tmp_path / "r.mat", {"simout": np.column_stack([np.zeros(5), np.ones(5), np.arange(5), np.ones(5)])}
    )
    assert len(open_any(str(tmp_path / "r.mat")).samples) == 5


def test_a_session_file_opens_whatever_its_name(tmp_path):
    samples = [Sample(k, k * 10**9, 1.0, 2.0, 3.0) for k in range(4)]
    folder = write_session(tmp_path / "run", samples)
    assert open_any(folder / "run_0.mcap").samples == samples
    (folder / "run_0.mcap").rename(tmp_path / "attachment.bin")
    assert open_any(tmp_path / "attachment.bin").samples == samples
    assert open_any(tmp_path / "attachment.bin", topic="/plant/sample").topic == "/plant/sample"
    with pytest.raises(SessionError, match="/b/plant/sample of type"):
        open_any(tmp_path / "attachment.bin", topic="/b/plant/sample")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mcap", b"", "the file is empty"),
        ("a.mcap", b"garbage", "is not a session"),
        ("a.mat", b"garbage", "is not a MATLAB file"),
        ("a.csv", b"garbage", "give column names and at least two rows"),
        ("a.txt", b"garbage", r"is neither a session \(folder or \.mcap\) nor a recording \(\.mat, \.csv\)$"),
        ("a", b"MATLAB 5.0 MAT-file, x", r"a MATLAB file needs the suffix \.mat"),
    ],
)
def test_what_is_neither_is_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SessionError, match=message):
        open_any(tmp_path / name)


def test_missing_paths_are_named(tmp_path):
    with pytest.raises(SessionError, match=r"nothing\.mat: does not exist"):
        open_any(tmp_path / "nothing.mat")
    (tmp_path / "file.csv").write_text(CSV)
    with pytest.raises(SessionError, match="cannot be read"):
        open_any(tmp_path / "file.csv" / "deeper")
    with pytest.raises(SessionError, match="the folder has no MCAP file"):
        open_any(tmp_path)


def test_a_recording_error_is_a_session_error():
    assert issubclass(RecordingError, SessionError)
