"""What to do before there is trust: the course to record, and the first PID, in lines and for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinmatch.controllers import pid_document
from twinmatch.controllers.first_course import FirstCourse
from twinmatch.offline.first_steps import FirstSteps, ProposedPid


def course_words(course: FirstCourse) -> list[str]:
    """The course in one sentence, when to end it, and what it is expected to do."""
    plant = course.plant
    drive = plant.drive
    output = plant.output
    rest, *steps = zip(course.levels, course.holds, strict=True)
    lines = [
        f"rest first: {drive.name} at {_amount(rest[0], drive.unit)} for {rest[1]:.4g} s"
    ]
    lines += [
        f"then {drive.name} at {_amount(level, drive.unit)} for {hold:.4g} s"
        for level, hold in steps
    ]
    low, high = course.ends
    within = f"{_amount(low, output.unit)} to {_amount(high, output.unit)}"
    expected = f"{course.band[0]:.4g} to {_amount(course.band[1], output.unit)}"
    lines.append(f"record all of it, {course.duration:.4g} s without a gap")
    lines.append(f"expected: {output.name} within {expected} in nine cases of ten")
    lines.append(
        f"set {drive.name} back to {_amount(rest[0], drive.unit)} at once if {output.name} leaves {within}, "
        "and keep recording"
    )
    if not course.shows:
        lines.append(
            f"Note: {output.name} is expected to move by {_amount(course.size, output.unit)} only, little "
            f"above its noise of {_amount(output.noise, output.unit)}; widen `safe` if the plant can bear "
            "more"
        )
    return lines


def first_steps_words(steps: FirstSteps) -> list[str]:
    """Why the twin is not trusted, what is open, what to record, and which PID to begin with."""
    lines = [
        f"not trusted yet: {steps.reason}",
        "open, by the structures that explain the recording:",
    ]
    for twin in steps.twins:
        values = []
        deviations = (
            np.zeros(0)
            if twin.covariance is None
            else np.sqrt(np.diag(twin.covariance))
        )
        for name, deviation in zip(twin.free, deviations, strict=True):
            values.append(f"{name} {twin.parameters[name]:.3g} ± {deviation:.2g}")
        lines.append(f"  {twin.name}: {', '.join(values)}")
    lines.append("record next:")
    lines += [f"  {line}" for line in course_words(steps.course)]
    return [*lines, *pid_words(steps.pid, steps.why_no_pid)]


def pid_words(proposed: ProposedPid | None, why_not: str = "") -> list[str]:
    """A first PID in lines, with what it was tried on; without one why."""
    if proposed is None:
        return [f"no first PID: {why_not}"]
    gains = proposed.pid.gains
    plant = proposed.answer.plant
    level = _amount(proposed.level, plant.output.unit)
    return [
        f"first PID: proportional {gains.proportional:g}, integral {gains.integral:g} 1/s, derivative 0, "
        f"back calculation {gains.back_calculation:g} 1/s, every {gains.period:g} s",
        f"  maximum sensitivity at most {proposed.pid.sensitivity:.2f} in {proposed.pid.plants} cases of "
        "what is open",
        f"  around {level}: {proposed.answer.sentence}",
    ]


def course_document(course: FirstCourse) -> dict[str, Any]:
    """The course for JSON."""
    return {
        "drive": course.plant.drive.name,
        "levels": list(course.levels),
        "holds": list(course.holds),
        "ends": list(course.ends),
        "expected": list(course.band),
    }


def first_steps_document(steps: FirstSteps) -> dict[str, Any]:
    """Everything for JSON."""
    return {
        "trusted": False,
        "reason": steps.reason,
        "inseparable": []
        if steps.inseparable is None
        else list(steps.inseparable.names),
        "course": course_document(steps.course),
        "pid": None if steps.pid is None else pid_document(steps.pid.pid.gains),
    }


def _amount(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
