"""What sensors should have read over a session while they were not believed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from twinmatch.dynamics import Plant
from twinmatch.health import EstimatedReading
from twinmatch.health.faults import HOUR


@dataclass(eq=False)
class EstimatedCourse:
    """What a sensor should have read while it was not believed; values in its unit."""

    signal: str
    text: str
    unit: str
    first: int
    """First sample."""
    wide: float
    """Largest half width of its band with which the estimate counts as good."""
    good: float
    """For how long it was expected to be good, s; at most an hour is looked ahead."""
    values: list[float] = field(default_factory=list)
    bands: list[float] = field(default_factory=list)
    """Half of the width that holds 90 % of what it would have read."""
    readings: list[float] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Last sample."""
        return self.first + len(self.values) - 1

    def line(self, period: float) -> str:
        """When it was read through, what it should read in the end, and for how long that was good."""
        long = (
            "at least an hour" if self.good >= HOUR else f"{self.good / 60.0:.2g} min"
        )
        return (
            f"the twin reads through {self.text} from {self.first * period:g} to {self.last * period:g} s: "
            f"at the end it should read {self.values[-1]:.1f} ± {self.bands[-1]:.1f} {self.unit}, not "
            f"{self.readings[-1]:.1f}; good to ± {self.wide:.1f} {self.unit} for {long}"
        )


def courses_of(
    estimates: Iterable[EstimatedReading], plant: type[Plant]
) -> tuple[EstimatedCourse, ...]:
    """The estimates in courses, one for each time that a sensor was not believed, in order of beginning."""
    courses: dict[tuple[str, int], EstimatedCourse] = {}
    for estimate in estimates:
        declared = plant.outputs[estimate.signal]
        text = declared.text or estimate.signal
        new_course = EstimatedCourse(
            estimate.signal,
            text,
            declared.unit,
            estimate.since,
            estimate.wide,
            estimate.good,
        )
        course = courses.setdefault((estimate.signal, estimate.since), new_course)
        course.values.append(estimate.value)
        course.bands.append(estimate.band)
        course.readings.append(estimate.reading)
    return tuple(courses.values())
