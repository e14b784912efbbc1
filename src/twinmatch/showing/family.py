"""The family of a verdict: its candidates with windows, matches and models, and the table of their criteria.

A verdict carries figures, not models. Those that the discriminator had at the end are handed over; others are
identified again, in the same way and with the same seed, so they are the same to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Final, NamedTuple

from twinmatch.comparing import (
    CandidateScore,
    OrderScore,
    SimoModel,
    Verdict,
    identify,
    twin_response,
)
from twinmatch.comparing.models import ahead, deviations, operating_level
from twinmatch.dynamics import Response
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import ORDERS, Match
from twinmatch.showing.quantities import (
    ParameterFormat,
    number,
    outputs_unit,
    parameter_format,
    span_text,
    with_unit,
)
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import FamilyModels, MatchReport, TwinSettings, response_on
from twinmatch.twin.matcher import one_thread


@dataclass(frozen=True, eq=False)
class Member:
    """One candidate of the family at the end of a session."""

    score: CandidateScore
    nominal: bool
    match: Match | None
    """The match it came from; None for a candidate from a file."""
    window: Window
    """Measured samples it was judged on: those it was matched on, otherwise the first excited window."""
    settings: TwinSettings
    known_models: tuple[SimoModel, ...] = ()
    """Box–Jenkins models as the discriminator has identified them; empty: they have to be identified again."""

    @cached_property
    def response(self) -> Window:
        """Response of its twin to that window's set-point, or input in open loop, with sensor noise."""
        settings = self.settings
        seed = settings.seed + self.window.first
        return twin_response(
            self.score.parameters, self.window, settings.law, settings.sensor, seed
        )

    @cached_property
    def models(self) -> tuple[SimoModel, ...]:
        """Box–Jenkins models of that response, one per order."""
        return self.known_models or self._identified(ORDERS)

    def _identified(self, orders: Sequence[str]) -> tuple[SimoModel, ...]:
        with one_thread():
            return identify(
                self.response,
                orders,
                scale=self.settings.model_scale,
                lead=self.settings.schedule.lead,
            )

    @property
    def fitted(self) -> bool:
        """Whether it was fitted to samples, and not given."""
        return (
            self.match is not None
            or self.score.parameters.model.structure_name == self.score.name
        )

    @property
    def modelled(self) -> bool:
        """Whether it has Box–Jenkins models: candidates of plants with several loops have none."""
        return bool(self.score.orders)

    @property
    def measured(self) -> Window:
        """The measured samples on which the models were scored."""
        return self.window.part(self.response.first, self.response.last)

    @property
    def quiet_twin(self) -> Response:
        """The same response without sensor noise, from the window's third sample."""
        return response_on(self.score.parameters, self.window, self.settings.law)

    def simulated(self, order: str) -> Window:
        """The measured window as simulated by the model of this order: B/F alone, as for the gain.

        The model is reached through the lower orders, as in the discriminator; higher ones take longest.
        """
        up_to_order = ORDERS.index(order) + 1
        lower_models = self.known_models or self._identified(ORDERS[:up_to_order])
        model = lower_models[up_to_order - 1]
        of_y = model.y
        of_u = model.u
        measured = self.measured
        level = operating_level(measured, driven=of_u is None, lead=model.lead)
        r, y, u = deviations(measured, level)
        output = (
            of_y.simulate(u if of_u is None else r, outputs=y[: len(of_y.F)])
            + level.output
        )
        simulated_input = measured.input
        if of_u is not None:
            simulated_input = (
                of_u.simulate(ahead(r), outputs=u[: len(of_u.F)]) + level.input
            )
        return replace(measured, outputs=output, inputs=simulated_input)


def family(
    samples: Sequence[Sample],
    matches: Sequence[MatchReport],
    verdict: Verdict | None,
    settings: TwinSettings,
    models: FamilyModels = MappingProxyType({}),
) -> tuple[Member, ...]:
    """The members of a verdict's family, in its order; empty without a verdict.

    `models` are those of the discriminator. Candidates whose window is not among the samples are left out, as
    the recording started after it.
    """
    if verdict is None:
        return ()
    members = []
    # A candidate from a file has an empty window and no match.
    accepted = {m.match.samples: m.match for m in reversed(matches) if m.match.accepted}
    for score in verdict.family:
        window = _window_of(score, matches, samples, settings.period)
        if window is not None:
            match = accepted.get((score.first, score.last))
            is_nominal = score.name == verdict.nominal
            known_models = models.get((score.name, score.first, score.last), ())
            members.append(
                Member(score, is_nominal, match, window, settings, known_models)
            )
    return tuple(members)


def _window_of(
    score: CandidateScore,
    matches: Sequence[MatchReport],
    samples: Sequence[Sample],
    period: float,
) -> Window | None:
    first = score.first
    last = score.last
    if last < first:  # from a file, so judged on the first window that excited the loop
        last = next(
            (m.match.samples[1] for m in matches if m.match.samples[0] == first), last
        )
    window_samples = [s for s in samples if first <= s.index <= last]
    if len(window_samples) == last - first + 1 and len(unbroken(window_samples)) == 1:
        with suppress(TwinmatchError):
            return Window.from_samples(window_samples, period)
    return None


_NORMAL = 1.959964
"""Standard errors to either side that hold 95 % of a normal distribution."""


class Interval(NamedTuple):
    """A 95 % interval, in the parameter's own unit."""

    low: float
    """Lower end: minus infinity where it is unbounded, NaN where it is not known."""
    high: float
    error: float
    """Standard error."""
    profile: bool
    """Whether the ends come from the profile likelihood; otherwise they are ±1.96 standard errors."""

    @property
    def known(self) -> bool:
        """Whether there is an interval at all."""
        return not (math.isnan(self.low) or math.isnan(self.high))


def interval(match: Match, name: str) -> Interval:
    """The interval of a free parameter; NaN for one that was not fitted."""
    if name not in match.free:
        return Interval(math.nan, math.nan, math.nan, profile=False)
    place = match.free.index(name)
    value = value_of(match, name)
    error = float(match.standard_errors[place])
    if len(match.intervals) > place:
        low, high = map(float, match.intervals[place])
        if not (math.isnan(low) or math.isnan(high)):
            return Interval(low, high, error, profile=True)
    return Interval(
        value - _NORMAL * error, value + _NORMAL * error, error, profile=False
    )


def value_of(match: Match, name: str) -> float:
    """The value of a fitted parameter, or of a fitted initial state, in its own unit."""
    return float(match.starts[name] if name in match.starts else match.parameters[name])


class FigureColumn(NamedTuple):
    """One figure of a candidate or an order, as every display heads, writes and explains it."""

    attribute: str
    """Name of the attribute of `CandidateScore` or `Criteria` that holds the figure."""
    name: str
    unit: str
    """Empty: a plain number."""
    decimals: int
    meaning: str
    best: Callable[[Iterable[float]], float] | None = None
    """Chooses the best of several values; None: the column is not a criterion."""
    high: str = ""
    """Attribute of the upper end of an interval."""

    @property
    def label(self) -> str:
        """Name and unit."""
        return with_unit(self.name, self.unit)

    def text(self, holder: object) -> str:
        """The figure of an object, or of a document, that has these fields."""
        fields = (
            holder
            if isinstance(holder, Mapping)
            else {n: getattr(holder, n) for n in (self.attribute, self.high) if n}
        )
        low = fields[self.attribute]
        return (
            span_text(low, fields[self.high], self.decimals)
            if self.high
            else number(low, self.decimals)
        )


GAIN: Final = FigureColumn(
    "gain", "gain", "characters", 0, "l(t) − l(p): characters that the model saves", max
)
CRITERIA: Final = (
    FigureColumn(
        "trivial_length",
        "l(t)",
        "characters",
        0,
        "characters of the measured values as a plain table",
    ),
    FigureColumn(
        "model_length",
        "l(p)",
        "characters",
        0,
        "characters of the model and a table of its residuals",
    ),
    GAIN,
    FigureColumn("explanation", "explained", "", 3, "gain / l(t), at best 1", max),
    FigureColumn("naic", "nAIC", "", 3, "smaller is better", min),
    FigureColumn("bic", "BIC", "", 1, "smaller is better", min),
    FigureColumn("mdl", "MDL", "", 4, "smaller is better", min),
    FigureColumn(
        "two_part_length",
        "two-part",
        "characters",
        0,
        "l(p) and the model's parameters",
        min,
    ),
)
"""Columns of an order, in the order of the paper's table; MDL has the squared unit of output or input."""
GAP_SUM: Final = FigureColumn(
    "nu_gap_sum", "Σ ν-gap", "", 3, "sum of the ν-gaps to the others; smallest: nominal"
)
GAP_NOW: Final = FigureColumn(
    "nu_gap_to_plant", "ν-gap now", "", 3, "ν-gap to the plant of the newest samples"
)
_SUM_LOW: Final = FigureColumn(
    "nu_gap_sum_low",
    "90 % of Σ",
    "",
    3,
    "interval that contains this sum",
    high="nu_gap_sum_high",
)
_MARGIN: Final = (
    "b(P, C): up to this ν-gap the controller in use stabilises every plant"
)
FIGURES: Final = (
    GAP_SUM,
    _SUM_LOW,
    FigureColumn(
        "nominal_probability",
        "P(nominal)",
        "",
        2,
        "probability of having the smallest sum",
    ),
    GAP_NOW,
    FigureColumn("margin", "margin", "", 3, _MARGIN),
)
"""Columns of a candidate beside those of its orders."""

OUTPUTS: tuple[tuple[str, str], ...] = (
    ("y", "output y/r"),
    ("u", "control u/r"),
    ("total", "both"),
)
"""Attribute of `OrderScore` and its name in tables."""

_DRIVEN: tuple[tuple[str, str], ...] = (("y", "output y/u"),)
"""Attribute and name of the only output where the loop is not known."""


def outputs_of(orders: Sequence[OrderScore]) -> tuple[tuple[str, str], ...]:
    """The outputs that a candidate's orders were scored on: attributes of `OrderScore` and their names."""
    return _DRIVEN if any(order.u is None for order in orders) else OUTPUTS


class CriterionFigure(NamedTuple):
    """One figure of the table, and whether the order is its candidate's best by it, on this output."""

    text: str
    best: bool


class CriterionRow(NamedTuple):
    """One order of one candidate on one output."""

    output: str
    order: str
    chosen: bool
    """Whether the order is the one chosen for the candidate."""
    cells: tuple[CriterionFigure, ...]
    """One for each of the criteria passed to `criterion_rows`."""


def criterion_rows(
    candidate: CandidateScore, criteria: Sequence[FigureColumn] = CRITERIA
) -> tuple[CriterionRow, ...]:
    """The table of one candidate: a row per order, for y, for u and for both; for y alone in open loop."""
    orders = candidate.orders
    chosen = candidate.chosen_order
    rows = []
    for output, _ in outputs_of(orders):
        for o in orders:
            figures = tuple(_figure(orders, o, output, c) for c in criteria)
            rows.append(CriterionRow(output, o.order, o.order == chosen, figures))
    return tuple(rows)


def chosen_score(candidate: CandidateScore) -> OrderScore | None:
    """The scores of the order chosen for a candidate; None for a structure, which has no such models."""
    return next(
        (o for o in candidate.orders if o.order == candidate.chosen_order), None
    )


def computed(candidates: Sequence[CandidateScore]) -> tuple[FigureColumn, ...]:
    """The criteria that have a value for at least one candidate."""
    orders = [order for candidate in candidates for order in candidate.orders]
    return tuple(c for c in CRITERIA if _is_computed(c, orders))


def _is_computed(criterion: FigureColumn, orders: Sequence[OrderScore]) -> bool:
    return any(not math.isnan(_value(order, "total", criterion)) for order in orders)


def for_both(
    candidate: CandidateScore, criteria: Sequence[FigureColumn]
) -> list[FigureColumn]:
    """These criteria for output and input together: MDL then has the sum of their squared units."""
    plant = candidate.parameters.model.plant
    y, u = (declared.unit or declared.name for declared in (plant.output, plant.drive))
    unit = f"{y}²+{u}²" if len(outputs_of(candidate.orders)) > 1 else f"{y}²"
    return [c._replace(unit=unit) if c.attribute == "mdl" else c for c in criteria]


class FamilyTable(NamedTuple):
    """What displays show of a verdict's candidates; each arranges these columns in its own way."""

    candidates: tuple[CandidateScore, ...]
    point: str
    """Unit of the operating points."""
    parameters: tuple[ParameterFormat, ...]
    """The free parameters of the family's structure."""
    criteria: tuple[FigureColumn, ...]
    """Those with a value, for output and input together; empty where the candidates have no models."""
    figures: tuple[FigureColumn, ...]

    def parameter(self, candidate: CandidateScore, shown: ParameterFormat) -> str:
        """A parameter of a candidate; a dash where its structure does not have it."""
        return shown.text(candidate.parameters.get(shown.name, math.nan))


def family_table_of(verdict: Verdict) -> FamilyTable:
    """The table of a verdict with at least one candidate in its family."""
    model = verdict.family[0].parameters.model
    modelled = verdict.modelled
    return FamilyTable(
        candidates=verdict.family,
        point=outputs_unit(model.plant),
        parameters=tuple(
            parameter_format(model.plant, name) for name in model.structure.free
        ),
        criteria=tuple(for_both(modelled[0], computed(modelled))) if modelled else (),
        figures=FIGURES,
    )


def _figure(
    orders: Sequence[OrderScore], order: OrderScore, output: str, column: FigureColumn
) -> CriterionFigure:
    value = _value(order, output, column)
    text = column.text(getattr(order, output))
    if column.best is None or math.isnan(value):
        return CriterionFigure(text, best=False)
    return CriterionFigure(
        text, best=value == column.best(_value(o, output, column) for o in orders)
    )


def _value(order: OrderScore, output: str, column: FigureColumn) -> float:
    return float(getattr(getattr(order, output), column.attribute))
