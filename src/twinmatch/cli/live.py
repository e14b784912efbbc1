"""`twinmatch live`: the twin beside a plant: bridges, controller, twin and recorder."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import add_options, session_to_record
from twinmatch.cli.starting import remember_recorded
from twinmatch.launching.forking import fork_server
from twinmatch.launching.launcher import continue_as_launcher
from twinmatch.launching.processes import add_page_options, page_of
from twinmatch.shipped import shipped

CONFIGS = {
    "peltier": ("rig.yaml", None),
    "tclab": ("tclab.yaml", "tclab_twin.yaml"),
    "tclab-both": ("tclab_both.yaml", "tclab_both_twin.yaml"),
}
"""Files in config/ for the nodes of a plant and for those of its twin; None: defaults."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant",
        default="peltier",
        choices=sorted(CONFIGS),
        help="plant to run (default: peltier)",
    )
    parser.add_argument(
        "--port",
        default="",
        help="serial port of the plant (default: that of --config)",
    )
    add_options(
        parser,
        "--config",
        help="parameters of the rig's nodes (default: the plant's in config/)",
    )
    add_options(
        parser,
        "--twin-config",
        "--candidates",
        "--memory",
        "--rig",
        "--session",
        "--no-record",
    )
    parser.add_argument(
        "--keep-driving",
        action="store_true",
        help="continue without a session when it cannot be written (default: output to zero, exit code 1)",
    )
    parser.add_argument(
        "--virtual", action="store_true", help="a virtual rig instead of the real one"
    )
    add_options(parser, "--speed", "--fault", "--board", "--seed")
    add_page_options(parser, control=True)


def run(options: argparse.Namespace) -> int:
    """Run until Ctrl-C or the profile's end; returns the exit code: 3 if the rig's process was lost, 1 if the
    session could not be written."""
    usage = options.parser
    if options.virtual and options.port:
        usage.error("--port is for a real plant; leave it out with --virtual")
    if not options.virtual and (
        options.speed != 1.0 or options.fault or options.board != "auto"
    ):
        usage.error("--speed, --fault and --board need --virtual")
    if options.is_program:
        continue_as_launcher()
    fork_server()  # imports while this process does
    from twinmatch.launching.live import Live, run_live  # noqa: PLC0415
    from twinmatch.launching.plan import LivePlan, VirtualPlan  # noqa: PLC0415

    rig, twin = CONFIGS[options.plant]
    if options.twin_config is None and twin is not None:
        options.twin_config = shipped(f"config/{twin}")
    session = session_to_record(options)
    virtual = VirtualPlan(
        options.speed, tuple(options.fault), options.board, options.seed, options.plant
    )
    passed_options = ("twin_config", "candidates", "plant", "port", "keep_driving")
    asked = {name: getattr(options, name) for name in passed_options}
    config = options.config or shipped(f"config/{rig}")
    plan = LivePlan(
        config=config,
        session=session,
        virtual=virtual if options.virtual else None,
        **asked,
    )
    live = Live(plan)
    with page_of(options, usage, options.twin_config):
        code = run_live(live)
    if code == 0:
        remember_recorded(options, live.sessions)
    return code
