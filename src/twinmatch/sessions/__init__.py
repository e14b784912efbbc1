"""Sessions: recorded runs as files, and imports from other programs' files.

A session is a rosbag2 folder with MCAP files, so every tool of ROS 2 reads it; this room writes and
reads it without ROS. `SessionWriter` writes serialised messages of any topics, and a live `Recording`
stops it before the disk is full; `write_session` writes samples, complete or not at all. `read_session`
reads both, a truncated file as far as it goes. `read_recording` imports MATLAB and CSV files of the rig,
and `open_any` opens either. `resample` puts rows with irregular times on one clock.
"""

from twinmatch.sessions.files import RecordingError, SessionError
from twinmatch.sessions.messages import Message, Qos, Topic, plant_messages, plant_topics
from twinmatch.sessions.reader import Session, read_session
from twinmatch.sessions.recording import (
    EPOCH,
    DiskFullError,
    Recording,
    RecordingLimits,
    samples_of,
    write_session,
)
from twinmatch.sessions.resampling import Resampled, resample
from twinmatch.sessions.sources import open_any, read_recording
from twinmatch.sessions.writer import SessionWriter

__all__ = [
    "EPOCH",
    "DiskFullError",
    "Message",
    "Qos",
    "Recording",
    "RecordingError",
    "RecordingLimits",
    "Resampled",
    "Session",
    "SessionError",
    "SessionWriter",
    "Topic",
    "open_any",
    "plant_messages",
    "plant_topics",
    "read_recording",
    "read_session",
    "resample",
    "samples_of",
    "write_session",
]
