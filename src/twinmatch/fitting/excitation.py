"""Whether the inputs of a plant whose loop is not known move its outputs: by its file, and by the samples.

The plant file expects a movement by its defaults. Where they are far from the plant, what it expects says
nothing, but the samples do: a linear model of each output is fitted to them with and without the inputs,

    y[k+1] − y[k] = c + Σ (a y[k−i] + b u[k−i] + d d[k−i]) + e[k+1]         i = 0, 1

and where the inputs explain what cannot be chance, the output's response to them in that model is the
movement that the samples show. The model is fitted twice: to the samples, for inputs that switch at each of
them, and to means of `_TOGETHER` samples, for a plant so slow that noise hides the step to the next sample.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.dynamics.movement import InputEffect, effect_of, movement_under
from twinmatch.signals import BoolArray, FloatArray, Window

_ORDER: Final = 2
"""Samples that each signal has in an equation of the model."""
_TOGETHER: Final = 10
"""Samples in a mean."""
_FAR: Final = 3.0
"""Factor between the movement that the samples show and the expected one, from which the defaults are far
off."""
_CHANCE: Final = 1e-6
"""Probability that inputs without an effect would count as having one."""
_ENDLESS: Final = 1e12
"""Deviation beyond which a fitted model runs away."""
_ROUNDING: Final = 1e-9
"""Share of an input's limits up to which a movement is what resampling a level leaves."""
_ROWS_FOR_EACH: Final = 3
"""Equations needed for each coefficient."""


def expected_movement(window: Window, effect: InputEffect) -> FloatArray:
    """Movement of the outputs since the window began, in their units, shape (N, o), as the plant's equations
    with their defaults expect it of the inputs."""
    return movement_under(effect, window.inputs)


def movement_by_inputs(window: Window, effect: InputEffect) -> FloatArray:
    """Movement of the outputs that the inputs cause, in their units, shape (N, o): of each output as the
    defaults expect it, unless the samples show that it is far larger."""
    shown = shown_movement(window)
    expected = expected_movement(window, effect)
    return np.where(_is_far(shown, expected), shown, expected)


def unexpected_movement(window: Window, effect: InputEffect) -> FloatArray:
    """Movement that the samples show of outputs of which the defaults expect far less, in their units, shape
    (N, o); zero of the others."""
    shown = shown_movement(window)
    if not shown.any():
        return shown
    return np.where(_is_far(shown, expected_movement(window, effect)), shown, 0.0)


def _is_far(shown: FloatArray, expected: FloatArray) -> BoolArray:
    """Of which outputs the samples show far more than the defaults expect, shape (o,)."""
    return np.asarray(np.ptp(shown, axis=0) > _FAR * np.ptp(expected, axis=0))


def shown_movement(window: Window) -> FloatArray:
    """Movement of the outputs about their means, in their units, shape (N, o), that the inputs cause as far
    as the samples show; zero where they do not show that an input acts."""
    shown = np.zeros_like(window.outputs)
    if not np.ptp(window.inputs, axis=0).any():
        return shown
    for place, output in enumerate(window.outputs.T):
        responses = [_response(window, output, width) for width in (1, _TOGETHER)]
        largest = max(responses, key=np.ptp)
        if largest.any():  # a model may exaggerate, the output does not
            shown[:, place] = largest * min(
                1.0, float(np.ptp(output) / np.ptp(largest))
            )
    return shown


def _response(window: Window, output: FloatArray, width: int) -> FloatArray:
    """Response of an output to the inputs, shape (N,), in a model of means of `width` samples."""
    nothing = np.zeros(len(window))
    blocks = len(window) // width
    if blocks <= _ORDER:
        return nothing
    seen = (
        np.ones((len(window), 1))
        if window.seen is None
        else window.seen[:, None].astype(np.float64)
    )
    y = _means(output[:, None], width)
    u = _means(window.inputs, width)
    d = _means(window.disturbances, width)
    usable = _equations_of(_means(seen, width)[:, 0] == 1.0)
    steps = np.diff(y[:, 0])[_ORDER - 1 :][usable]
    constant = np.ones((blocks - _ORDER, 1))
    without_inputs = np.hstack([constant, _lagged(y), _lagged(d)])[usable]
    with_inputs = np.hstack([without_inputs, _lagged(u)[usable]])
    if len(steps) < _ROWS_FOR_EACH * with_inputs.shape[1]:
        return nothing
    coefficients, squares = _fitted(with_inputs, steps)
    _, squares_without = _fitted(without_inputs, steps)
    n_added = u.shape[1] * _ORDER
    if not _exceeds_chance(squares_without, squares, len(steps), n_added):
        return nothing
    simulated = _simulated(
        coefficients[1 : 1 + _ORDER], coefficients[-n_added:], u - np.mean(u, axis=0)
    )
    course = np.repeat(simulated, width)
    return np.pad(course, (0, len(window) - len(course)), mode="edge")


def _means(values: FloatArray, width: int) -> FloatArray:
    """Means of successive `width` samples, shape (blocks, columns); what is left at the end is left out."""
    blocks = len(values) // width
    means: FloatArray = (
        values[: blocks * width].reshape(blocks, width, values.shape[1]).mean(axis=1)
    )
    return means


def _lagged(values: FloatArray) -> FloatArray:
    """The newest `_ORDER` values of each column before every value, newest first, lag by lag."""
    last = len(values) - 1
    return np.hstack([values[_ORDER - 1 - lag : last - lag] for lag in range(_ORDER)])


def _equations_of(is_seen: BoolArray) -> BoolArray:
    """Which equations hold only values that were measured."""
    n_equations = len(is_seen) - _ORDER
    usable: BoolArray = np.all(
        [is_seen[lag : lag + n_equations] for lag in range(_ORDER + 1)], axis=0
    )
    return usable


def _fitted(equations: FloatArray, steps: FloatArray) -> tuple[FloatArray, float]:
    """Coefficients by least squares, and the sum of the squares that they leave."""
    sizes = np.maximum(np.max(np.abs(equations), axis=0), np.finfo(np.float64).tiny)
    scaled = np.linalg.lstsq(equations / sizes, steps, rcond=None)[0]
    left = steps - equations / sizes @ scaled
    return scaled / sizes, float(left @ left)


def _exceeds_chance(
    squares_without: float, squares: float, rows: int, n_added: int
) -> bool:
    """Whether added columns explain more than chance would: the logarithm of the ratio of the likelihoods has
    a χ² distribution, whose tail is bounded as Chernoff's bound has it."""
    if not squares_without > squares:
        return False
    if squares == 0.0:
        return True
    gain = rows * math.log(squares_without / squares) / n_added
    log_chance = 0.5 * n_added * (1.0 - gain + math.log(gain)) if gain > 1.0 else 0.0
    return log_chance < math.log(_CHANCE)


def _simulated(
    of_output: FloatArray, of_inputs: FloatArray, inputs: FloatArray
) -> FloatArray:
    """The output's deviation from its mean, shape (N,), as the inputs deviate from theirs."""
    n_inputs = inputs.shape[1]
    by_newest, by_before = (inputs @ of_inputs.reshape(_ORDER, n_inputs).T).T.tolist()
    # numbers of Python: a recursion over elements of arrays takes ten times as long
    of_newest, of_before = of_output.tolist()
    deviation = [0.0] * len(inputs)
    for k in range(_ORDER - 1, len(inputs) - 1):
        newest = deviation[k]
        rate = of_newest * newest + by_newest[k]
        rate += of_before * deviation[k - 1] + by_before[k - 1]
        deviation[k + 1] = newest + rate
        if not abs(deviation[k + 1]) < _ENDLESS:
            return np.zeros(len(inputs))
    return np.array(deviation)


def why_not_moved(window: Window, plant: type[Plant], least: FloatArray) -> str:
    """Why a window without a movement is one, in words; `least` are the movements of the outputs, in their
    units, that would count, shape (o,)."""
    swings = np.ptp(window.inputs, axis=0)
    drives = [*plant.drives.items()]
    ranges = np.array([drive.limits[1] - drive.limits[0] for _, drive in drives])
    furthest = int(np.argmax(swings / ranges))
    if swings[furthest] <= _ROUNDING * ranges[furthest]:
        return "the input did not move"
    name, drive = drives[furthest]
    input_name = "the input" if len(drives) == 1 else f"the input {name}"
    expected = np.max(
        np.abs(expected_movement(window, effect_of(plant, window.period))), axis=0
    )
    nearest = int(np.argmax(expected / least))
    unit = [*plant.outputs.values()][nearest].unit
    by_input = f"{input_name} moved by {amount(swings[furthest], drive.unit)}"
    by_defaults = f"which by the defaults of the plant file moves the output by {amount(expected[nearest], unit)}"
    sentence = f"{by_input}, {by_defaults}, less than the {amount(least[nearest], unit)} that count"
    range_of_output = float(np.ptp(window.outputs[:, nearest]))
    if range_of_output < least[nearest]:
        return sentence
    moved = amount(range_of_output, unit)
    return f"{sentence}; the output moved by {moved}, but the samples do not show that the input caused it"


def amount(value: float, unit: str) -> str:
    """A number with its unit, if it has one."""
    return f"{value:.3g}" if unit in {"", "1"} else f"{value:.3g} {unit}"
