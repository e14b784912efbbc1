"""The command line of `twinmatch`."""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from twinmatch import __version__
from twinmatch.archive import program as archive_program
from twinmatch.dashboard import command as dashboard_command
from twinmatch.emulation import virtual_rig_program
from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.foxglove import command as foxglove_command
from twinmatch.judging.progress import Progress
from twinmatch.reporting import command as report_command

__all__ = ["main"]

EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 2 a mistake the user can mend, 130 interrupted."""
    parser = _parser()
    options = parser.parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        return command(options)
    except TwinmatchError as error:
        print(f"twinmatch: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        print("twinmatch: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone; Python would complain about the flush at exit
        return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="twinmatch", description="Which digital twin to trust, and how far, while the plant runs."
    )
    parser.add_argument("--version", action="version", version=f"twinmatch {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    importing = commands.add_parser("import", help="turn a rig recording (.mat or .csv) into an MCAP session")
    importing.add_argument(
        "recording", type=Path, help=".mat with a matrix 'simout', or .csv with named columns"
    )
    importing.add_argument(
        "-o", "--output", type=Path, required=True, metavar="SESSION", help="folder to write"
    )
    importing.add_argument("--overwrite", action="store_true", help="replace a session that is already there")
    importing.set_defaults(command=_import)

    replaying = commands.add_parser("replay", help="judge recorded sessions offline, as fast as it goes")
    replaying.add_argument(
        "sessions",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="session folder, .mcap file, recording (.mat, .csv), folder of any of these, or pattern",
    )
    replaying.add_argument("--json", type=Path, metavar="OUT", help="write every verdict to this file")
    replaying.add_argument("--figure", type=Path, metavar="OUT", help="draw the verdict (.png, .svg or .pdf)")
    replaying.add_argument("--candidates", type=Path, metavar="FILE", help="candidates to begin with (.yaml)")
    replaying.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml), as the nodes take them"
    )
    archive_program.add_options(replaying)
    replaying.set_defaults(command=_replay)

    verifying = commands.add_parser(
        "verify", help="judge a recorded session again and compare the verdicts, bit for bit"
    )
    verifying.add_argument("session", type=Path, help="session folder or .mcap file")
    verifying.add_argument("--topic", metavar="TOPIC", help="the samples, if the session has several rigs")
    verifying.add_argument(
        "--config", type=Path, metavar="FILE", help="parameters (.yaml) instead of the recorded ones"
    )
    verifying.add_argument(
        "--candidates", type=Path, metavar="FILE", help="candidates (.yaml) instead of the recorded ones"
    )
    verifying.set_defaults(command=_verify)

    repairing = commands.add_parser("repair", help="make a session whole whose recorder was killed")
    repairing.add_argument("session", type=Path, help="session folder")
    repairing.set_defaults(command=_repair)

    reporting = commands.add_parser(
        "report", help="write a session up as one HTML file, with its figures and tables"
    )
    report_command.add_arguments(reporting)
    reporting.set_defaults(command=report_command.run)

    page = commands.add_parser("dashboard", help="the live page: what the graph says, in a browser")
    dashboard_command.add_arguments(page)
    page.set_defaults(command=dashboard_command.run)

    viewing = commands.add_parser("foxglove", help="serve the graph to Foxglove and Lichtblick")
    foxglove_command.add_arguments(viewing)
    viewing.set_defaults(command=foxglove_command.run)

    rig = commands.add_parser("virtual-rig", help="the rig without the rig: board, camera and plate emulated")
    virtual_rig_program.add_options(rig)
    rig.set_defaults(command=virtual_rig_program.run)

    preparing = commands.add_parser(
        "prepare", help="derive and compile the plants' equations now, so that no first run waits"
    )
    preparing.set_defaults(command=_prepare)
    return parser


def _import(options: argparse.Namespace) -> int:
    from twinmatch.sessions import read_recording, samples_of, write_session  # noqa: PLC0415 — keeps --help fast

    window = read_recording(options.recording)
    write_session(options.output, samples_of(window), overwrite=options.overwrite)
    print(
        f"{options.output}: {len(window)} samples, {len(window) * window.period:.0f} s, "
        f"from {options.recording.name}"
    )
    return 0


def _replay(options: argparse.Namespace) -> int:
    _check_writable(options.json, options.figure)
    if archive_program.is_archive(options):
        with Progress() as progress:
            archive = archive_program.judge(options, progress.advance)
        return archive_program.show(options, archive)
    gc.set_threshold(50_000)  # start-up makes many objects and hardly any garbage among them
    from twinmatch.cli_replay import replay  # noqa: PLC0415 — keeps --help fast

    replay(options.sessions[0], options)
    return 0


def _verify(options: argparse.Namespace) -> int:
    """0 identical, 1 different; what cannot be verified is an error (2)."""
    from twinmatch.judging.verification import verify_session  # noqa: PLC0415

    with Progress() as progress:
        found = verify_session(
            options.session,
            topic=options.topic,
            config=options.config,
            candidates=options.candidates,
            watch=progress.advance,
        )
    for note in found.notes:
        print(f"Note: {note}")
    compared = f"{found.verdicts} verdicts and {found.matches} matches on {found.samples} samples"
    if found.identical:
        print(f"{found.name}: {compared} are identical, bit for bit")
        return 0
    print(f"{found.name}: {compared} are not identical. First difference: {found.difference}")
    return 1


def _repair(options: argparse.Namespace) -> int:
    from twinmatch.sessions.repair import repair_session  # noqa: PLC0415

    found = repair_session(options.session)
    held = f"{found.messages} messages over {found.duration:.1f} s"
    if not found.faults:
        print(f"{options.session}: is whole, {held}; nothing to repair")
        return 0
    print(f"{options.session}: repaired ({'; '.join(found.faults)}); {held} were saved")
    if found.original is not None:
        print(f"There was damage before the end, so the original was kept: {found.original}")
    return 0


def _prepare(_: argparse.Namespace) -> int:
    from twinmatch.dynamics.prepare import prepare  # noqa: PLC0415
    from twinmatch.dynamics.store import cache_folder  # noqa: PLC0415
    from twinmatch.plants import PLANTS  # noqa: PLC0415

    for plant in PLANTS.values():
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")
    return 0


def _check_writable(*outputs: Path | None) -> None:
    for output in outputs:
        if output is not None and not output.absolute().parent.is_dir():
            msg = f"{output}: there is no folder {output.parent} to write into; create it first"
            raise TwinmatchError(msg)


if __name__ == "__main__":
    sys.exit(main())
