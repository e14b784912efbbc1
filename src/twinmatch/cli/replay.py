"""`twinmatch replay`: one session or many, judged offline."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from twinmatch.cli.prepare import compare_models, second_compiler
from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    console_for,
    exit_code,
    open_shown,
    positive,
    write_json,
)
from twinmatch.errors import TwinmatchError
from twinmatch.offline.archive import Archive, ArchiveError, is_single, judge_archive
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.processes import held_interrupts
from twinmatch.plants import plant_named
from twinmatch.sessions import Session
from twinmatch.showing.family import GAIN, GAP_NOW, GAP_SUM
from twinmatch.showing.lines import Lines
from twinmatch.showing.quantities import (
    ParameterFormat,
    ShownSignal,
    number,
    parameter_format,
    percent,
    shown_inputs,
    shown_outputs,
)
from twinmatch.showing.summary import closing_lines, document
from twinmatch.showing.view import view_of
from twinmatch.signals import Sample, point_text
from twinmatch.twin import Outcome, Twin

_Column = tuple[str, Callable[[dict[str, Any]], str]]
"""Name of a column, and its text from the row of a candidate."""

if TYPE_CHECKING:
    from rich.table import Table

    from twinmatch.showing.terminal import Screen


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "sessions", "--json", "--figure", *TERMS)
    group = parser.add_argument_group(
        "many sessions",
        "Several sessions, a folder of them or a pattern are judged in parallel, and one table shows all "
        "candidates. Exit code 0: all judged; 3: some skipped; 2: none judged.",
    )
    count = positive(int, "a number of processes; give 1 or more")
    group.add_argument(
        "--jobs", type=count, metavar="N", help="processes (default: one per core)"
    )
    group.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write a JSON file per session; judge only new sessions",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="judge on this Dask cluster; it needs the same paths",
    )


def run(options: argparse.Namespace) -> int:
    """Judge and show; returns the exit code."""
    check_writable(options.json, options.figure)
    many = (options.jobs, options.out, options.scheduler) != (None, None, None)
    if many or not is_single(options.sessions):
        return _replay_many(options)
    with held_interrupts():
        _replay_one(options.sessions[0], options)
    return 0


def _replay_one(path: Path, options: argparse.Namespace) -> None:
    """Judge a session and show every match and verdict when it comes: a view that is redrawn on a terminal,
    plain lines elsewhere."""

    session = open_shown(path, options.plant)
    with second_compiler(compare_models):
        _judge_and_show(session, options)


def _judge_and_show(session: Session, options: argparse.Namespace) -> None:
    terms = terms_from_files(session, options.config, options.candidates)
    with _display(session) as (view, advance):
        judgement = judge(session, terms, beside=advance)
    verdicts = judgement.verdicts
    for line in closing_lines(judgement.summary, verdicts[-1] if verdicts else None):
        view.say(line)
    write_json(
        options.json,
        lambda: document(
            judgement.name, verdicts, judgement.summary, judgement.matches
        ),
    )
    if options.figure is not None:
        from twinmatch.showing.figures.session import draw_verdict  # noqa: PLC0415

        settled = judgement.stretches
        draw_verdict(
            judgement.samples, verdicts, judgement.settings, settled, options.figure
        )


@contextmanager
def _display(
    session: Session,
) -> Iterator[tuple[Screen | Lines, Callable[[Twin, Sample, Outcome], None]]]:
    """A screen on a terminal; elsewhere lines, with a progress bar on standard error."""
    samples_judged = 0
    total = len(session.samples)
    view = view_of(session.name, session.period, total)

    def advance(_twin: Twin, _sample: Sample, outcome: Outcome) -> None:
        nonlocal samples_judged
        samples_judged += 1
        if outcome.match is not None:
            view.take_match(outcome.match)
        for verdict in outcome.verdicts:
            view.take_verdict(verdict)
        view.advance(samples_judged)
        if bar is not None and samples_judged % 50 == 0:
            bar.advance(samples_judged, total)

    bar = Progress() if isinstance(view, Lines) else None
    with bar or nullcontext():
        view.open()
        try:
            yield view, advance
        except TwinmatchError:
            view.close(wipe=True)
            raise
        finally:
            view.close()


def _replay_many(options: argparse.Namespace) -> int:
    """Judge many sessions, print the table of all candidates and write the JSON; returns the exit code."""
    if options.allow_fmu is not None:
        msg = "--allow-fmu works with one session; for several, set allow_fmu in the file of --config"
        raise TwinmatchError(msg)
    if options.figure is not None:
        raise ArchiveError(
            "--figure: draws one session, but several were given; give one"
        )
    with Progress() as progress:
        names = ("config", "plant", "candidates", "out", "jobs", "scheduler")
        archive = judge_archive(
            options.sessions,
            document=document,
            watch=progress.advance,
            on_skip=lambda failure: print(
                f"twinmatch: skipped {failure.reason}", file=sys.stderr
            ),
            **{name: getattr(options, name) for name in names},
        )
    _print(archive)
    write_json(options.json, archive.document)
    return exit_code(len(archive.sessions), len(archive.failed))


def _print(archive: Archive) -> None:
    for judged in archive.sessions:
        for note in judged["summary"]["notes"]:
            print(f"Note: {judged['session']}: {note}")
    if archive.candidates:
        console_for(180).print(_table(archive))
    without = [
        s["session"] for s in archive.sessions if s["summary"]["nominal"] is None
    ]
    if without:
        print(f"No nominal twin: {', '.join(without)}")
    reused = f", {archive.reused} of them earlier" if archive.reused else ""
    skipped = f"; {len(archive.failed)} skipped" if archive.failed else ""
    sessions = f"{len(archive.sessions)} session{'s' * (len(archive.sessions) != 1)}"
    print(f"{sessions} judged{reused}, {len(archive.candidates)} candidates{skipped}")


def _table(archive: Archive) -> Table:
    """All candidates, session by session; the nominal ones are bold.

    The columns include the free parameters of the first candidate's structure.
    """
    from rich.table import Table  # noqa: PLC0415

    first = archive.candidates[0]
    plant = plant_named(first["plant"])
    columns: list[_Column] = [
        ("session", lambda row: row["session"]),
        ("at", lambda row: point_text(row["operating_point"])),
        ("candidate", lambda row: f"{row['name']}{' *' if row['nominal'] else ''}"),
    ]
    for name in plant.structures[first["structure"]].free:
        columns.append(_parameter_column(parameter_format(plant, name)))
    if plant.single:
        columns += _OF_MODELS
    columns += [(GAP_SUM.name, GAP_SUM.text), (GAP_NOW.name, GAP_NOW.text)]
    for kind, signals in (("y", shown_outputs(plant)), ("u", shown_inputs(plant))):
        for k, signal in enumerate(signals):
            name, fit_text = _fit_column(kind, k, kind if plant.single else signal)
            if plant.single or any(
                fit_text(row) != number(None) for row in archive.candidates
            ):
                columns.append((name, fit_text))
    shown = Table(
        title="Candidates over all sessions (* nominal)", box=None, pad_edge=False
    )
    for name, _ in columns:
        side: Any = "left" if name in {"session", "candidate"} else "right"
        shown.add_column(name, justify=side, no_wrap=name != "session", overflow="fold")
    before = ""
    for row in archive.candidates:
        session, *texts = (text(row) for _, text in columns)
        shown.add_row(
            "" if session == before else session,
            *texts,
            style="bold" if row["nominal"] else "",
        )
        before = session
    return shown


def _parameter_column(parameter: ParameterFormat) -> _Column:
    """The value of a parameter."""
    return parameter.label, lambda row: parameter.text(
        row["parameters"].get(parameter.name, math.nan)
    )


def _fit_column(kind: str, k: int, signal: str | ShownSignal) -> _Column:
    """The fit of output `k` (kind y) or input `k` (kind u)."""
    return f"fit {signal}", lambda row: _fit(row["fit"][kind], k)


_OF_MODELS: Final[tuple[_Column, ...]] = (
    ("order", lambda row: row["chosen_order"]),
    (GAIN.name, lambda row: GAIN.text(row["criteria"])),
)
"""Columns of Box–Jenkins models."""


def _fit(shares: float | Sequence[float | None] | None, k: int) -> str:
    share = shares[k] if isinstance(shares, Sequence) else shares
    return number(None) if share is None else f"{percent(share)}%"
