"""`twinmatch attach`: the twin beside a rig that is already running."""

from __future__ import annotations

import argparse
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from twinmatch.cli.shared import (
    add_goal_options,
    add_options,
    column_map,
    goal_of,
    session_to_record,
)
from twinmatch.cli.starting import remember_recorded
from twinmatch.launching.launcher import continue_as_launcher
from twinmatch.launching.processes import (
    EXIT_NOT_RECORDED,
    add_page_options,
    check_page_options,
    page_of,
)
from twinmatch.links.preview import previewed
from twinmatch.links.sources import protocol_of
from twinmatch.nodes import require_ros
from twinmatch.parameters.declared import Values, given_to, parameters_of, sections_of
from twinmatch.parameters.sampler import SAMPLER, sampler_values, twin_beside
from twinmatch.sampling.sources import SignalMap
from twinmatch.sessions import RecordingLimits
from twinmatch.sessions.documents import read_text
from twinmatch.sessions.files import DiskError

_INSTEAD: Final = "for a plant without ROS, give --source URL"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "--config", help="parameters of sampler and recorder")
    add_options(parser, "--plant", default="", help="plant of the rig")
    add_options(
        parser,
        "--map",
        metavar="SIGNAL=TOPIC:FIELD",
        help="output=/camera/temperature:temperature 'input=/cmd:data; scale=100'",
    )
    parser.add_argument(
        "--source",
        default="",
        metavar="URL",
        help="where the signals come from, if not from topics of ROS: "
        "mqtt://HOST, mqtts://USER@HOST?password_file=FILE, modbus://HOST/UNIT",
    )
    parser.add_argument(
        "--list",
        nargs="?",
        const="",
        metavar="WHERE",
        dest="listed",
        help="show what the source has (a part: room, holding/0-50), and what --map gives, and end",
    )
    parser.add_argument(
        "--alone",
        action="store_true",
        help="in one process without ROS; so it is where ROS is not installed",
    )
    add_options(parser, "--map-file")
    add_options(parser, "--period", help="sampling period of the rig's loop")
    add_options(
        parser,
        "--twin-config",
        "--candidates",
        "--memory",
        "--rig",
        "--session",
        "--no-record",
    )
    add_page_options(parser)
    add_goal_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run until Ctrl-C; returns the exit code: 3 if a process could not be kept running."""
    if options.listed is not None:
        if not options.source:
            options.parser.error(
                "--list shows a source: give --source URL; ros2 topic list shows topics"
            )
        lines = protocol_of(options.source).listing(options.source, options.listed)
        print("\n".join(lines) or "nothing there")
        if options.map or options.map_file:
            print("\n".join(previewed(options.source, column_map(options))))
        return 0
    if not (options.source or options.config or options.alone):
        require_ros("attach", _INSTEAD)
    if not (options.config or options.map or options.map_file):
        options.parser.error(
            "map topics to signals with --config FILE, --map-file FILE or --map …"
        )
    given_map = column_map(options).joined(
        SignalMap(plant=options.plant, period=options.period)
    )
    session = session_to_record(options)
    values, _ = sampler_values(options.config, given_map, options.source)
    if options.alone or (
        values["source"] and not all(map(find_spec, ("rclpy", "twinmatch_msgs")))
    ):
        sessions = [session] if session else []
        code = _run_alone(options, values, session)
    else:
        if options.reach is not None:
            options.parser.error(
                "--reach needs --alone; beside a graph: twinmatch dashboard --reach LEVEL"
            )
        sessions, code = _run_graph(options, given_map, session)
    if code == 0:
        remember_recorded(options, sessions)
    return code


def _run_alone(
    options: argparse.Namespace, values: Values, session: Path | None
) -> int:
    from twinmatch.launching.alone import AlonePlan, run_alone  # noqa: PLC0415

    check_page_options(options, options.parser)
    settings = twin_beside(values, options.twin_config)
    candidates = read_text(options.candidates) if options.candidates else ""
    usual = RecordingLimits()
    section = sections_of(options.config, SAMPLER, "recorder") if options.config else {}
    accepted = {}
    for parameter in parameters_of(usual):
        value = section.get(parameter.name, parameter.default)
        accepted[parameter.name] = parameter.accept(value, "recorder")
    limits = given_to(usual, accepted)
    try:
        goal = None if options.reach is None else goal_of(options)
        plan = AlonePlan(
            values,
            settings,
            candidates,
            session,
            limits,
            options.dashboard,
            options.tell,
            goal,
        )
        run_alone(plan)
    except DiskError as error:
        print(f"twinmatch: {error}", file=sys.stderr)
        return EXIT_NOT_RECORDED
    return 0


def _run_graph(
    options: argparse.Namespace, given_map: SignalMap, session: Path | None
) -> tuple[list[Path], int]:
    require_ros("attach", _INSTEAD)
    if options.is_program:
        continue_as_launcher()
    from twinmatch.launching.live import Live, run_live  # noqa: PLC0415
    from twinmatch.launching.plan import attach_plan  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="twinmatch-attach-") as folder:
        asked = {
            name: getattr(options, name)
            for name in ("config", "twin_config", "candidates")
        }
        plan = attach_plan(
            Path(folder), given_map, session=session, source=options.source, **asked
        )
        live = Live(plan)
        with page_of(options, options.parser, plan.twin_config):
            return live.sessions, run_live(live)
