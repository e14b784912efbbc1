"""`twinmatch attach`: the twin beside a rig that is already running."""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from twinmatch.launching.page import add_page_options, page_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="parameters of sampler and recorder")
    parser.add_argument("--plant", default="", metavar="NAME|FILE.py", help="plant of the rig")
    parser.add_argument(
        "--map",
        nargs="+",
        default=[],
        metavar="SIGNAL=TOPIC:FIELD",
        help="output=/camera/temperature:temperature 'input=/cmd:data; scale=100'",
    )
    parser.add_argument(
        "--map-file", type=Path, metavar="FILE", help="the same as YAML; --map takes precedence"
    )
    parser.add_argument("--period", type=float, metavar="S", help="sampling period of the rig's loop")
    parser.add_argument("--twin-config", type=Path, metavar="FILE", help="parameters of the twin's nodes")
    parser.add_argument(
        "--candidates", type=Path, metavar="FILE", help="initial family of candidates (.yaml)"
    )
    parser.add_argument("--session", type=Path, metavar="FOLDER", help="record here (sessions/<time>)")
    parser.add_argument("--no-record", action="store_true", help="record nothing")
    add_page_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run until Ctrl-C; returns the exit code: 3 if a process could not be kept running."""
    if not (options.config or options.map or options.map_file):
        options.parser.error("map topics to signals with --config FILE, --map-file FILE or --map …")
    from twinmatch.launching.attach import attach_plan  # noqa: PLC0415 — needs ROS
    from twinmatch.launching.live import Live, refuse_existing, run_live  # noqa: PLC0415
    from twinmatch.sessions.column_map import ColumnMap, parse_map, read_map  # noqa: PLC0415

    session = options.session or Path("sessions") / time.strftime("%Y-%m-%d_%H-%M-%S")
    session = None if options.no_record else session
    refuse_existing(session)
    written = read_map(options.map_file) if options.map_file else ColumnMap()
    said = replace(parse_map(options.map), plant=options.plant, period=options.period)
    with tempfile.TemporaryDirectory(prefix="twinmatch-attach-") as folder:
        plan = attach_plan(
            Path(folder),
            written.joined(said),
            config=options.config,
            twin_config=options.twin_config,
            candidates=options.candidates,
            session=session,
        )
        with page_of(options, options.parser, plan.twin_config):
            return run_live(Live(plan))
