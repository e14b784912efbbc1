"""`twinmatch replay`: one session or many, judged offline."""

from __future__ import annotations

import argparse
import gc
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.offline.command_line import Progress, add_terms, check_writable, held_interrupts

if TYPE_CHECKING:
    from rich.table import Table

    from twinmatch.offline.archive import Archive, Failure
    from twinmatch.sessions import Session
    from twinmatch.showing.lines import Lines
    from twinmatch.showing.quantities import ParameterFormat
    from twinmatch.showing.terminal import Screen
    from twinmatch.twin import Outcome

EXIT_PARTLY = 3
"""Some sessions were judged and some skipped."""

WIDTH = 180
"""Width of the table when the output is not a terminal."""

BEFORE = ("session", "at", "candidate")
BEHIND = ("order", "gain", "Σ ν-gap", "ν-gap now", "fit y", "fit u")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "sessions",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="session folder, .mcap file, recording (.mat, .csv), folder of any of these, or pattern",
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every verdict to this file")
    parser.add_argument("--figure", type=Path, metavar="OUT", help="draw the verdict (.png, .svg or .pdf)")
    add_terms(parser)
    group = parser.add_argument_group(
        "many sessions",
        "Several sessions, a folder of them or a pattern are judged in parallel, and one table shows all "
        "candidates. Exit code 0: all judged; 3: some skipped; 2: none judged.",
    )
    group.add_argument("--jobs", type=_count, metavar="N", help="processes (default: one per core)")
    group.add_argument(
        "--out", type=Path, metavar="DIR", help="write a JSON file per session; judge only new sessions"
    )
    group.add_argument(
        "--scheduler", metavar="ADDRESS", help="judge on this Dask cluster; it needs the same paths"
    )


def run(options: argparse.Namespace) -> int:
    """Judge and show; returns the exit code."""
    from twinmatch.offline.archive import is_single  # noqa: PLC0415 — keeps --help fast

    check_writable(options.json, options.figure)
    asked = (options.jobs, options.out, options.scheduler)
    if not is_single(options.sessions) or any(option is not None for option in asked):
        return _replay_many(options)
    gc.set_threshold(50_000)  # start-up creates many objects and hardly any garbage
    with held_interrupts():
        _replay_one(options.sessions[0], options)
    return 0


def _replay_one(path: Path, options: argparse.Namespace) -> None:
    """Judge a session and show every match and verdict when it comes: a view that is redrawn on a terminal,
    plain lines elsewhere."""
    from twinmatch.offline.judging import judge, terms_from_files  # noqa: PLC0415 — keeps --help fast
    from twinmatch.sessions import open_any  # noqa: PLC0415
    from twinmatch.showing.summary import closing_lines, document  # noqa: PLC0415

    with Progress("reading") as progress:
        session = open_any(path, plant=options.plant, progress=progress.advance)
    terms = terms_from_files(session, options.config, options.candidates)
    with _Display(session) as shown:
        judgement = judge(session, terms, on_outcome=shown.advance)
    verdicts = judgement.verdicts
    for line in closing_lines(judgement.summary, verdicts[-1] if verdicts else None):
        shown.say(line)
    if options.json is not None:
        entry = document(judgement.name, verdicts, judgement.summary, judgement.matches)
        options.json.write_text(json.dumps(entry, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    if options.figure is not None:
        from twinmatch.showing.figures.session import draw_verdict  # noqa: PLC0415 — matplotlib is slow

        draw_verdict(judgement.samples, verdicts, judgement.settings, options.figure)


class _Display:
    """A screen on a terminal; elsewhere lines, with a progress bar on standard error."""

    def __init__(self, session: Session) -> None:
        from twinmatch.showing.lines import Lines, redraws  # noqa: PLC0415 — as above

        self._total = len(session.samples)
        self._screen = redraws(sys.stdout)
        self._view: Screen | Lines = _screen(session) if self._screen else Lines(session.period)
        self._bar = Progress()

    def __enter__(self) -> _Display:
        if not self._screen:
            self._bar.__enter__()
        self._view.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._view.close(wipe=kind is not None and issubclass(kind, TwinmatchError))
        self._bar.__exit__()

    def say(self, line: str) -> None:
        self._view.say(line)

    def advance(self, done: int, outcome: Outcome) -> None:
        if outcome.match is not None:
            self._view.take_match(outcome.match)
        for verdict in outcome.verdicts:
            self._view.take_verdict(verdict)
        self._view.advance(done)
        if done % 50 == 0:
            self._bar.advance(done, self._total)


def _screen(session: Session) -> Screen:
    from rich.console import Console  # noqa: PLC0415 — only a terminal needs it

    from twinmatch.showing.terminal import Screen  # noqa: PLC0415

    return Screen(Console(highlight=False), session.name, session.period, len(session.samples))


def _replay_many(options: argparse.Namespace) -> int:
    """Judge many sessions, print the table of all candidates and write the JSON; returns the exit code."""
    from twinmatch.offline.archive import ArchiveError, judge_archive  # noqa: PLC0415 — as above
    from twinmatch.showing.summary import document  # noqa: PLC0415

    if options.allow_fmu is not None:
        msg = "--allow-fmu works with one session; for several, set allow_fmu in the file of --config"
        raise TwinmatchError(msg)
    if options.figure is not None:
        raise ArchiveError("--figure: draws one session, but several were given; give one")
    with Progress() as progress:
        archive = judge_archive(
            options.sessions,
            document=document,
            config=options.config,
            plant=options.plant,
            candidates=options.candidates,
            out=options.out,
            jobs=options.jobs,
            scheduler=options.scheduler,
            watch=progress.advance,
            on_skip=_report_skipped,
        )
    _print(archive)
    if options.json is not None:
        text = json.dumps(archive.document(), indent=1, allow_nan=False, ensure_ascii=False)
        options.json.write_text(text + "\n", encoding="utf-8")
    if not archive.failed:
        return 0
    return EXIT_PARTLY if archive.sessions else EXIT_USER_ERROR


def _report_skipped(failure: Failure) -> None:
    """Report a skipped session at once."""
    print(f"twinmatch: skipped {failure.reason}", file=sys.stderr)


def _print(archive: Archive) -> None:
    from rich.console import Console  # noqa: PLC0415 — needed only to print

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDTH
    if archive.candidates:
        console.print(_table(archive))
    without = [s["session"] for s in archive.sessions if s["summary"]["nominal"] is None]
    if without:
        print(f"No nominal twin: {', '.join(without)}")
    reused = f", {archive.reused} of them earlier" if archive.reused else ""
    skipped = f"; {len(archive.failed)} skipped" if archive.failed else ""
    print(f"{len(archive.sessions)} sessions judged{reused}, {len(archive.candidates)} candidates{skipped}")


def _table(archive: Archive) -> Table:
    """All candidates, session by session; the nominal ones are bold."""
    from rich.table import Table  # noqa: PLC0415 — needed only to print

    shown = Table(title="Candidates over all sessions (* nominal)", box=None, pad_edge=False)
    matched = _matched(archive)
    for number, column in enumerate(_columns(matched)):
        text = column in ("session", "candidate")
        shown.add_column(column, justify="left" if text else "right", no_wrap=number > 0, overflow="fold")
    before = ""
    for row in archive.candidates:
        first, *others = _cells(row, matched)
        shown.add_row("" if first == before else first, *others, style="bold" if row["nominal"] else "")
        before = first
    return shown


def _columns(matched: Sequence[ParameterFormat]) -> tuple[str, ...]:
    """Names of the columns, with the free parameters of the first candidate's structure."""
    return (*BEFORE, *(q.label for q in matched), *BEHIND)


def _cells(row: dict[str, Any], matched: Sequence[ParameterFormat]) -> tuple[str, ...]:
    """One row as text, a cell per column."""
    fit = row["fit"]
    return (
        row["session"],
        f"{row['operating_point']:g}",
        f"{row['name']}{' *' if row['nominal'] else ''}",
        *(q.text(row["parameters"].get(q.name, math.nan)) for q in matched),
        row["chosen_order"],
        _number(row["criteria"]["gain"], ".0f"),
        _number(row["nu_gap_sum"], ".3f"),
        _number(row["nu_gap_to_plant"], ".3f"),
        _number(fit["y"], ".1%"),
        _number(fit["u"], ".1%"),
    )


def _matched(archive: Archive) -> list[ParameterFormat]:
    if not archive.candidates:
        return []
    from twinmatch.plants import plant_named  # noqa: PLC0415 — as `rich`
    from twinmatch.showing.quantities import parameter_format  # noqa: PLC0415

    first = archive.candidates[0]
    plant = plant_named(first["plant"])
    return [parameter_format(plant, name) for name in plant.structures[first["structure"]].free]


def _number(value: float | None, form: str) -> str:
    return "–" if value is None or not math.isfinite(value) else format(value, form)


def _count(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if count < 1:
        msg = f"{text!r} is not a number of processes; give 1 or more"
        raise argparse.ArgumentTypeError(msg)
    return count
