"""`twinmatch demo`: see twinmatch work, on a virtual rig or a recorded session."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from twinmatch.launching.page import add_page_options, page_of
from twinmatch.shipped import shipped

__all__ = ["add_arguments", "run"]

SPEED = 10.0
"""Of the virtual rig; it falls behind by itself on a slower machine."""
LONGEST = 60.0
"""Seconds the playing of a recorded session may take."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("session", type=Path, nargs="?", help="a session or recording to play instead")
    parser.add_argument("--speed", type=float, default=SPEED, help="of the virtual rig, times real time")
    add_page_options(parser)


def run(options: argparse.Namespace) -> int:
    """Show what was asked for; returns the exit code.

    Raises:
        TwinmatchError: something given cannot be used.
    """
    with page_of(options, options.parser) as page:
        code = _live(options.speed) if options.session is None else _recorded(options.session)
        if code == 0:
            page.stay()
        return code


def _live(speed: float) -> int:
    """Run the virtual rig through its set-points; returns the exit code."""
    from twinmatch.launching.live import Live, run_live  # noqa: PLC0415 — needs ROS
    from twinmatch.launching.plan import LivePlan, VirtualPlan  # noqa: PLC0415

    session = Path("out") / time.strftime("demo_%Y-%m-%d_%H-%M-%S")
    plan = LivePlan(config=shipped("config/demo.yaml"), session=session, virtual=VirtualPlan(speed=speed))
    run = Live(plan)
    code = run_live(run)
    return code or _look_back(session)


def _look_back(session: Path) -> int:
    """Judge the recording again, draw the verdict and write it up; the last line names the report."""
    from twinmatch.reporting import build_report, judge  # noqa: PLC0415
    from twinmatch.views.figures import draw_verdict  # noqa: PLC0415

    judged = judge(session)
    print(judged.recorded)
    picture, report = session.with_suffix(".png"), session.with_suffix(".html")
    found = judged.judgement
    draw_verdict(found.samples, found.verdicts, found.settings, picture)
    build_report(judged, session, command="twinmatch demo").write(report)
    print(f"picture: {_near(picture)}")
    print(f"report: {_near(report)}")
    return 0 if judged.identical else 1


def _recorded(session: Path) -> int:
    """Play a session fast enough to watch it to its end, then write it up; returns the exit code."""
    from twinmatch.launching.replay import Replay, play  # noqa: PLC0415 — needs ROS
    from twinmatch.reporting import make_report  # noqa: PLC0415
    from twinmatch.sessions import open_any  # noqa: PLC0415

    found = open_any(session)
    code = play(Replay(session, min(1000.0, max(50.0, found.duration / LONGEST))))
    if code:
        return code
    report = Path("out") / f"{found.name}.html"
    report.parent.mkdir(exist_ok=True)
    make_report(session, command=f"twinmatch demo {session}").write(report)
    print(f"report: {_near(report)}")
    return 0


def _near(path: Path) -> Path:
    """As seen from here, where that is shorter."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
