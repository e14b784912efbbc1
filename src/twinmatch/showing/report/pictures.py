"""The figures of a report, each with its title and a description for readers who cannot see it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.comparing import REFUSED
from twinmatch.errors import TwinmatchError
from twinmatch.offline.backtest import Backtest, draw_backtest, sentences
from twinmatch.offline.judgement import Judgement
from twinmatch.showing.events import admitted, level_stretches
from twinmatch.showing.family import Member
from twinmatch.showing.fan import Fan
from twinmatch.showing.figures import (
    draw_criteria,
    draw_forecasts,
    draw_health,
    draw_matrix,
    draw_parameters,
    draw_responses,
    draw_session,
    draw_uncertainty,
    save,
    svg,
)
from twinmatch.showing.report.leader_forecasts import fans_of
from twinmatch.showing.standing import last_verdict, shown_twin
from twinmatch.showing.words import words_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "Picture", "pictures", "write_pictures"]

FORMATS = ("png", "pdf")
"""File formats of `write_pictures`."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One figure."""

    name: str
    """Name of its file, without suffix."""
    title: str
    alt: str
    """Description in words."""
    figure: Figure
    svg: str

    @property
    def uri(self) -> str:
        """The figure as a data URI, so that the HTML file loads nothing else."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.svg.encode()).decode("ascii")


def pictures(
    judgement: Judgement, members: Sequence[Member], tested: Backtest | None = None
) -> dict[str, Picture]:
    """All figures of a session, by name and in the order of the report."""
    j, last = judgement, last_verdict(judgement.verdicts)
    found = [
        _picture(
            "session",
            "Plant and leading twin over the whole session",
            _session_alt(j),
            draw_session(j.samples, j.verdicts, j.settings),
        ),
        _picture(
            "health",
            "Health over time",
            _health_alt(j),
            draw_health(j.samples, j.matches, j.verdicts, j.settings),
        ),
    ]
    if tested is not None and tested.marked:
        found.append(
            _picture(
                "forecasts",
                "Forecasts compared with measurements",
                _forecasts_alt(tested),
                draw_backtest(tested),
            )
        )
        fans = fans_of(tested, j)
        if fans:
            figure = draw_forecasts(fans, j.settings.plant)
            found.append(_picture("leader_forecasts", "Forecasts of the leader", _fans_alt(fans), figure))
    if j.matches:
        nominal = next((m.match for m in members if m.nominal), None)
        figure = draw_parameters(j.matches, admitted(j.verdicts), nominal, j.settings.period)
        found.append(_picture("parameters", "Parameters of every match", _parameters_alt(j), figure))
    if members:
        names, words = ", ".join(m.score.name for m in members), words_of(j.settings.plant)
        found += [
            _picture(
                "responses",
                "The family on the measured data",
                f"One panel for each candidate ({names}): set-point, measured {words.output} and control, "
                "the response of the twin and that of its Box–Jenkins model.",
                draw_responses(members),
            ),
            _picture(
                "uncertainty",
                "Uncertainty of the twin",
                f"The twins of all candidates ({names}) on the window of the nominal one, and the "
                f"differences from the nominal twin in {words.output} and control.",
                draw_uncertainty(members),
            ),
        ]
    if last is not None:
        gains = ", ".join(
            f"{c.name}: order {c.chosen_order}, gain "
            f"{next(o.total.gain for o in c.orders if o.order == c.chosen_order)} characters"
            for c in last.modelled
        )
        sums = ", ".join(f"{c.name} {c.nu_gap_sum:.2f}" for c in last.candidates)
        found += [
            _picture(
                "criteria",
                "Criteria of the orders",
                f"Bars for every candidate and order. {gains}.",
                draw_criteria(last),
            ),
            _picture(
                "nu_gap",
                "ν-gap between the plants of the family",
                f"Shaded matrix of the ν-gaps between the plants. Sums: {sums}. Nominal: {last.nominal}.",
                draw_matrix(last),
            ),
        ]
    return {picture.name: picture for picture in found}


def write_pictures(found: dict[str, Picture], folder: Path, ending: str) -> list[Path]:
    """Write every figure into a folder, which is created if it does not exist.

    Raises:
        TwinmatchError: the folder cannot be created or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{folder}: the folder for the figures cannot be created: {error.strerror}"
        raise TwinmatchError(msg) from error
    paths = []
    for name, picture in found.items():
        path = folder / f"{name}.{ending}"
        save(picture.figure, path)
        paths.append(path)
    return paths


def _picture(name: str, title: str, alt: str, figure: Figure) -> Picture:
    return Picture(name, title, alt, figure, svg(figure))


def _session_alt(j: Judgement) -> str:
    low, high = min(s.output for s in j.samples), max(s.output for s in j.samples)
    words = words_of(j.settings.plant)
    span = f"{low:.{words.output_decimals}f} to {high:.{words.output_decimals}f} {words.output_unit}"
    closed = j.settings.gains is not None
    set_point = "set-point, " if closed else ""
    base = f"Time series of {set_point}measured {words.output} ({span}) and {words.input}"
    shown = shown_twin(j.verdicts[-1] if j.verdicts else None)
    if shown is None:
        return f"{base}; there is no twin to compare them with."
    twins, fitted = "the driven twin", "driven"
    if closed:
        twins, fitted = "the closed-loop and the driven twin", "closed-loop"
    return (
        f"{base}, with {twins} of {shown.name}; below, the residuals between plant and twin. "
        f"The {fitted} twin fits the {words.output} to {100 * j.summary.fit_y:.1f} %."
    )


def _health_alt(j: Judgement) -> str:
    period = j.settings.period
    levels = ", ".join(
        f"{s.level.value} from {s.first * period:.0f} to {s.last * period:.0f} s"
        for s in level_stretches(j.verdicts, j.samples[0].index)
    )
    joined = len(admitted(j.verdicts))
    return (
        f"Trust over time: {levels or 'no verdict'}. {joined} matches admitted, "
        f"{sum(v.match == REFUSED for v in j.verdicts)} refused."
    )


def _forecasts_alt(tested: Backtest) -> str:
    return (
        "Errors and coverage of every forecaster by horizon, and the leader's forecasts with their bands, "
        f"compared with the measurements. {' '.join(sentences(tested))}"
    )


def _fans_alt(fans: Sequence[Fan]) -> str:
    origins = ", ".join(f"{one.forecast.sample} by {one.forecast.candidate}" for one in fans)
    return (
        "Forecasts with their bands, the measurements before and after, and measured minus forecast within "
        f"the band. Made at samples {origins}."
    )


def _parameters_alt(j: Judgement) -> str:
    return (
        f"Value and 95 % interval of every fitted parameter at each of {len(j.matches)} matches; "
        "refused ones hollow, the nominal one as a diamond."
    )
