"""`twinmatch attach`: the twin beside a rig that is already running."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from twinmatch.cli.shared import add_options, column_map, session_to_record
from twinmatch.cli.starting import remember_recorded
from twinmatch.launching.processes import add_page_options, page_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "--config", help="parameters of sampler and recorder")
    add_options(parser, "--plant", default="", help="plant of the rig")
    add_options(
        parser,
        "--map",
        metavar="SIGNAL=TOPIC:FIELD",
        help="output=/camera/temperature:temperature 'input=/cmd:data; scale=100'",
    )
    add_options(parser, "--map-file")
    add_options(parser, "--period", help="sampling period of the rig's loop")
    add_options(parser, "--twin-config", "--candidates", "--memory", "--rig", "--session", "--no-record")
    add_page_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run until Ctrl-C; returns the exit code: 3 if a process could not be kept running."""
    if not (options.config or options.map or options.map_file):
        options.parser.error("map topics to signals with --config FILE, --map-file FILE or --map …")
    from twinmatch.launching.live import Live, run_live  # noqa: PLC0415 — needs ROS
    from twinmatch.launching.plan import attach_plan  # noqa: PLC0415
    from twinmatch.sampling.sources import SignalMap  # noqa: PLC0415

    session = session_to_record(options)
    said = SignalMap(plant=options.plant, period=options.period)
    with tempfile.TemporaryDirectory(prefix="twinmatch-attach-") as folder:
        asked = {name: getattr(options, name) for name in ("config", "twin_config", "candidates")}
        plan = attach_plan(Path(folder), column_map(options).joined(said), session=session, **asked)
        live = Live(plan)
        with page_of(options, options.parser, plan.twin_config):
            code = run_live(live)
        if code == 0:
            remember_recorded(options, live.sessions)
        return code
