"""The Lepton's telemetry rows: what the camera says of itself with every frame.

Word positions and bits are those of the Lepton Engineering Datasheet (500-0659-00-09, rev. 203). Values
of 32 bits have their low word first; the bring-up check in docs/rig/camera.md shows whether a camera agrees.
"""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.links.thermal_frame import CountArray, Exposure, FlatField, FrameFlags

__all__ = ["Telemetry", "exposure", "parse_telemetry"]

_ROW_A, _ROW_C = 0, 2
_DESIRED = 1 << 3
_STATE_SHIFT = 4
_GAIN_CONTROL = 1 << 12
_LOCKOUT = 1 << 15
_OVERHEATING = 1 << 20


@dataclass(frozen=True, slots=True)
class Telemetry:
    """The part of the telemetry that is used."""

    uptime: int
    """Milliseconds since the camera started."""
    status: int
    """Status bits."""
    frame_counter: int
    """Moves with new images only."""
    sensor_temperature: int
    """Hundredths of a kelvin."""
    last_flat_field: int
    """Uptime at the last flat-field correction, ms."""
    linear: bool
    """TLinear: counts are temperatures."""
    resolution: float
    """Kelvin per count."""

    @property
    def flat_field(self) -> FlatField:
        """State of the flat-field correction."""
        return FlatField(self.status >> _STATE_SHIFT & 0b11)

    @property
    def flat_field_age(self) -> int | None:
        """Milliseconds since the last correction; None if there was none."""
        if self.flat_field is FlatField.NEVER:
            return None
        return (self.uptime - self.last_flat_field) % 2**32

    @property
    def flags(self) -> FrameFlags:
        """What a reader of the frame must know."""
        meanings = {
            _DESIRED: FrameFlags.FLAT_FIELD_DESIRED,
            _GAIN_CONTROL: FrameFlags.GAIN_CONTROL,
            _LOCKOUT: FrameFlags.SHUTTER_LOCKED,
            _OVERHEATING: FrameFlags.OVERHEATING,
        }
        flags = FrameFlags.NONE if self.linear else FrameFlags.NOT_RADIOMETRIC
        for bit, flag in meanings.items():
            if self.status & bit:
                flags |= flag
        return flags


def parse_telemetry(rows: CountArray) -> Telemetry:
    """Read telemetry rows A, B, C, shape (3, 80)."""
    a, c = [int(word) for word in rows[_ROW_A]], rows[_ROW_C]
    return Telemetry(
        uptime=a[2] << 16 | a[1],
        status=a[4] << 16 | a[3],
        frame_counter=a[21] << 16 | a[20],
        sensor_temperature=a[24],
        last_flat_field=a[31] << 16 | a[30],
        linear=bool(c[48]),
        resolution=0.01 if c[49] else 0.1,
    )


def exposure(image: CountArray, telemetry: Telemetry, stamp: int) -> Exposure:
    """An image with its telemetry, complete at `stamp` on this computer's monotonic clock, ns."""
    return Exposure(
        image=image,
        stamp=stamp,
        resolution=telemetry.resolution,
        frame_counter=telemetry.frame_counter,
        flat_field=telemetry.flat_field,
        flat_field_age=telemetry.flat_field_age,
        sensor_temperature=telemetry.sensor_temperature,
        flags=telemetry.flags,
    )
