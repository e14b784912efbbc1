"""Importing: files of other programs as sessions.

`read_recording` imports MATLAB and CSV files of the rig, `open_any` opens such a file or a session. Tables
and bags of other loops are imported with a map of their columns or topics. `resample` puts rows with
irregular times on one clock.
"""

from twinmatch.importing.recordings import open_any, read_recording
from twinmatch.importing.resampling import resample

__all__ = ["open_any", "read_recording", "resample"]
