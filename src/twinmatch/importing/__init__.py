"""Importing: files of other programs as sessions.

`read_recording` imports MATLAB and CSV files of the rig, `open_any` opens such a file or a session. Tables
and bags of other loops are imported with a map of their columns or topics. `resample` puts rows with
irregular times on one clock.
"""

from typing import TYPE_CHECKING, Any

from twinmatch.importing.opening import open_any

if TYPE_CHECKING:
    from twinmatch.importing.recordings import read_recording
    from twinmatch.importing.resampling import resample

__all__ = ["open_any", "read_recording", "resample"]


def __getattr__(name: str) -> Any:
    """What reads tables, imported when it is asked for: opening a session does without, and is half as long."""
    if name == "read_recording":
        from twinmatch.importing.recordings import read_recording  # noqa: PLC0415

        return read_recording
    if name == "resample":
        from twinmatch.importing.resampling import resample  # noqa: PLC0415

        return resample
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
