"""The Lepton's telemetry rows: what the camera says of itself with every frame.

Word positions and bits are those of the Lepton Engineering Datasheet (500-0659-00-09, rev. 203). Values
of 32 bits have their low word first; the bring-up check in docs/rig/camera.md shows whether a camera agrees.
"""

from __future__ import annotations

from twinmatch.links.thermal_frame import CountArray, Exposure, FlatField, FrameFlags

_FLAGS = {
    1 << 3: FrameFlags.FLAT_FIELD_DESIRED,
    1 << 12: FrameFlags.GAIN_CONTROL,
    1 << 15: FrameFlags.SHUTTER_LOCKED,
    1 << 20: FrameFlags.OVERHEATING,
}
"""Meanings of bits of the status."""


def exposure(image: CountArray, rows: CountArray, stamp: int) -> Exposure:
    """An image with what its telemetry says.

    Args:
        image: its counts.
        rows: telemetry rows A, B, C, shape (3, 80).
        stamp: when it was complete, on this computer's monotonic clock, ns.
    """
    a = [int(word) for word in rows[0]]
    c = rows[2]
    status, uptime, corrected = (a[k + 1] << 16 | a[k] for k in (3, 1, 30))
    flags = FrameFlags.NONE if c[48] else FrameFlags.NOT_RADIOMETRIC
    for bit, flag in _FLAGS.items():
        if status & bit:
            flags |= flag
    state = FlatField(status >> 4 & 0b11)
    return Exposure(
        image=image,
        stamp=stamp,
        resolution=0.01 if c[49] else 0.1,
        frame_counter=a[21] << 16 | a[20],
        flat_field=state,
        flat_field_age=None
        if state is FlatField.NEVER
        else (uptime - corrected) % 2**32,
        sensor_temperature=a[24],
        flags=flags,
    )
