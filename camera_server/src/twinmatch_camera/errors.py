"""Errors of the camera program, each with the exit code that tells a supervisor what it was.

    CameraError
    ├── UsageError     2   what was asked for cannot be
    ├── ListenError    3   the address cannot be listened on
    └── SourceError    4   the camera cannot be opened, or has failed

0 is a stop that was asked for, or the end of a recording; 1 is a defect of this program, with a traceback.
"""


class CameraError(Exception):
    """The program cannot continue; its message is one line that says what to do."""

    exit_code = 1


class UsageError(CameraError):
    """An option that cannot be followed."""

    exit_code = 2


class ListenError(CameraError):
    """The address cannot be listened on."""

    exit_code = 3


class SourceError(CameraError):
    """The camera cannot be opened, or has failed."""

    exit_code = 4
