"""`twinmatch demo`: see twinmatch work, on a virtual rig or a recorded session."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

from twinmatch.cli.shared import Progress, add_options
from twinmatch.cli.starting import remember_recorded, started
from twinmatch.launching.launcher import continue_as_launcher
from twinmatch.launching.processes import add_page_options, page_of
from twinmatch.shipped import shipped

MEMORY = Path("out") / "demo_memory.sqlite"
"""A second demonstration starts from what the first has taught."""
LONGEST = 60.0
"""Longest time that playing a recorded session takes, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser, "session", nargs="?", help="session or recording to play instead"
    )
    fastest = "highest speed of the virtual rig, times real time (default: as fast as the machine allows)"
    add_options(parser, "--speed", default=math.inf, help=fastest)
    add_options(
        parser,
        "--config",
        help="parameters of the virtual rig's nodes (default: config/demo.yaml)",
    )
    add_options(
        parser,
        "--memory",
        default=MEMORY,
        help=f"what earlier ones have taught (default: {MEMORY})",
    )
    add_page_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run the demonstration; returns the exit code."""
    if options.is_program:
        continue_as_launcher()
    with page_of(options, options.parser) as page:
        if options.session is not None:
            code = _play_session(options.session)
        else:
            vars(options).update(candidates=None, rig="", plant="", twin_config=None)
            with started(options):
                code = _live(options)
        if code == 0:
            page.stay()
        return code


def _live(options: argparse.Namespace) -> int:
    """Run the virtual rig through its set-points; returns the exit code."""
    from twinmatch.launching.live import Live, run_live  # noqa: PLC0415
    from twinmatch.launching.plan import LivePlan, VirtualPlan  # noqa: PLC0415
    from twinmatch.offline.judging import rehearse  # noqa: PLC0415
    from twinmatch.plants import Peltier  # noqa: PLC0415
    from twinmatch.twin import TwinSettings  # noqa: PLC0415

    with Progress("compiling, the first time only") as progress:
        rehearse(Peltier, TwinSettings(), progress.advance)
    session = Path("out") / time.strftime("demo_%Y-%m-%d_%H-%M-%S")
    virtual = VirtualPlan(speed=options.speed, board="python")
    config = options.config
    plan = LivePlan(
        config=config or shipped("config/demo.yaml"),
        session=session,
        virtual=virtual,
        candidates=options.candidates,
    )
    code = run_live(Live(plan)) or _look_back(session)
    if code == 0:
        remember_recorded(options, [session])
    return code


def _look_back(session: Path) -> int:
    """Judge the recording again, draw the verdict and write the report; the last line names it."""
    from twinmatch.showing.figures.session import draw_verdict  # noqa: PLC0415
    from twinmatch.showing.report.report import build_report, judge_for_report  # noqa: PLC0415

    judged = judge_for_report(session)
    print(judged.recorded)
    picture = session.with_suffix(".png")
    report = session.with_suffix(".html")
    judgement = judged.judgement
    settled = judgement.stretches
    draw_verdict(
        judgement.samples, judgement.verdicts, judgement.settings, settled, picture
    )
    build_report(judged, session, command="twinmatch demo").write(report)
    print(f"picture: {_shorter(picture)}")
    print(f"report: {_shorter(report)}")
    return 0 if judged.identical else 1


def _play_session(session: Path) -> int:
    """Play a session within `LONGEST`, then write the report; returns the exit code."""
    from twinmatch.cli.shared import open_shown  # noqa: PLC0415
    from twinmatch.launching.replay import Replay, play  # noqa: PLC0415
    from twinmatch.showing.report.report import make_report  # noqa: PLC0415

    played = open_shown(session)
    code = play(Replay(played, min(1000.0, max(50.0, played.duration / LONGEST))))
    if code:
        return code
    report = Path("out") / f"{played.name}.html"
    report.parent.mkdir(exist_ok=True)
    make_report(session, command=f"twinmatch demo {session}").write(report)
    print(f"report: {_shorter(report)}")
    return 0


def _shorter(path: Path) -> Path:
    """The path relative to the working folder, if it lies in it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
