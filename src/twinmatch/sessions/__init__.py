"""Sessions: recorded runs as files.

A session is a rosbag2 folder with MCAP files, so every tool of ROS 2 reads it; this room writes and
reads it without ROS. `SessionWriter` writes serialised messages of any topics, and a live `Recording`
stops it before the disk is full; `write_session` writes samples, complete or not at all. `read_session`
reads both, a truncated file as far as it goes. `twinmatch.importing` makes sessions of other programs' files.
"""

from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import Message, Qos, Topic, plant_topics
from twinmatch.sessions.reader import Session, read_session
from twinmatch.sessions.recording import (
    Recording,
    RecordingLimits,
    samples_of,
    write_session,
)
from twinmatch.sessions.writer import SessionWriter

__all__ = [
    "Message",
    "Qos",
    "Recording",
    "RecordingLimits",
    "Session",
    "SessionError",
    "SessionWriter",
    "Topic",
    "plant_topics",
    "read_session",
    "samples_of",
    "write_session",
]
