"""`twinmatch import`: turn a recording into a session."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from twinmatch.errors import TwinmatchError

if TYPE_CHECKING:
    from twinmatch.sessions.column_map import ColumnMap, Source


class ImportOptionError(TwinmatchError):
    """Options of an import are missing or contradict each other."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "recording",
        type=Path,
        help=".csv with named columns, .mat, or a ROS bag, as a folder or a file (.mcap, .db3, .bag); "
        "without --plant it is read as a recording of the Peltier rig",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="SESSION", help="folder to write")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing session")
    other = parser.add_argument_group("your own plant, with any column names")
    other.add_argument(
        "--list", action="store_true", help="show the columns and propose a map; writes nothing"
    )
    other.add_argument("--plant", metavar="NAME|FILE.py", help="plant that was recorded")
    other.add_argument(
        "--map",
        nargs="+",
        default=[],
        metavar="SIGNAL=COLUMN",
        help="time=elapsed output='t2, t3' (their mean) 'input=duty; scale=100' 'room=T1; unit=K'; for a "
        "bag: output=/camera/temperature:temperature",
    )
    other.add_argument(
        "--map-file", type=Path, metavar="FILE", help="the same as YAML; --map takes precedence"
    )
    other.add_argument("--period", type=float, metavar="S", help="sampling period, if not that of the rows")
    other.add_argument(
        "--bridge", type=float, metavar="S", help="longest gap to interpolate across (default: three rows)"
    )
    other.add_argument(
        "--gaps",
        choices=("refuse", "split"),
        default="refuse",
        help="what to do with longer gaps: refuse them (default), or split the session there, so that no "
        "window reaches across",
    )


def run(options: argparse.Namespace) -> int:
    """Write the session; returns the exit code.

    Raises:
        TwinmatchError: the recording cannot be used, or the session cannot be written.
    """
    if options.list:
        return _list(options.recording)
    if options.output is None:
        raise ImportOptionError(
            "import: name the session to write with -o SESSION (or show the columns with --list)"
        )
    from twinmatch.sessions.bags import is_bag  # noqa: PLC0415 — keeps --help fast

    mapped = (options.map, options.map_file, options.plant, options.period, options.bridge)
    if any(mapped) or options.gaps != "refuse" or is_bag(options.recording):
        return _import_mapped(options)
    from twinmatch.offline.command_line import Progress  # noqa: PLC0415
    from twinmatch.sessions import read_recording, samples_of, write_session  # noqa: PLC0415 — keeps --help fast

    with Progress("reading") as progress:
        window = read_recording(options.recording, progress.advance)
    with Progress("writing") as progress:
        write_session(
            options.output, samples_of(window), overwrite=options.overwrite, progress=progress.advance
        )
    print(
        f"{options.output}: {len(window)} samples, {len(window) * window.period:.0f} s, "
        f"from {options.recording.name}"
    )
    return 0


def _import_mapped(options: argparse.Namespace) -> int:
    from twinmatch.offline.command_line import Progress  # noqa: PLC0415 — as above
    from twinmatch.plants import find_plant  # noqa: PLC0415
    from twinmatch.sessions import plant_topics, write_session  # noqa: PLC0415
    from twinmatch.sessions.bags import is_bag, map_bag  # noqa: PLC0415
    from twinmatch.sessions.mapped import map_samples, with_plant_names  # noqa: PLC0415
    from twinmatch.sessions.metadata import NO_REFERENCE, PLANT  # noqa: PLC0415
    from twinmatch.sessions.tables import read_table  # noqa: PLC0415

    given = _given(options)
    if not given.plant:
        msg = "import: the plant is missing; give --plant NAME, --plant FILE.py, or plant: in the map file"
        raise ImportOptionError(msg)
    plant = find_plant(given.plant)
    if is_bag(options.recording):
        with Progress("reading") as progress:
            found = map_bag(
                options.recording,
                given,
                plant,
                longest=options.bridge,
                gaps=options.gaps,
                progress=progress.advance,
            )
    else:
        table = read_table(options.recording)
        given = with_plant_names(table, plant, given)
        found = map_samples(table, given, plant, longest=options.bridge, gaps=options.gaps)
    columns = "; ".join(f"{signal} = {source.text}" for signal, source in found.sources.items())
    record = {
        "plant": plant.name,
        "source": options.recording.name,
        "map": columns,
        "reference": "recorded" if found.has_reference else NO_REFERENCE,
    }
    with Progress("writing") as progress:
        write_session(
            options.output,
            found.samples,
            overwrite=options.overwrite,
            records={PLANT: record},
            gaps=options.gaps == "split",
            topics=plant_topics(plant.output.unit, has_reference=found.has_reference),
            progress=progress.advance,
        )
    seconds = len(found.samples) * found.period
    print(
        f"{options.output}: {len(found.samples)} samples, one every {found.period:g} s, {seconds:.0f} s of "
        f"{plant.title}, from {options.recording.name} ({columns})"
    )
    for note in found.notes:
        print(f"Note: {note}")
    return 0


def _given(options: argparse.Namespace) -> ColumnMap:
    from twinmatch.sessions.column_map import ColumnMap, parse_map, read_map  # noqa: PLC0415 — as above

    if options.period is not None and not options.period > 0:
        raise ImportOptionError(f"import: --period is {options.period:g}; give a positive number of seconds")
    written = read_map(options.map_file) if options.map_file else ColumnMap()
    said = parse_map(options.map)
    return written.joined(ColumnMap(said.sources, options.plant or "", options.period))


def _list(path: Path) -> int:
    from twinmatch.sessions.bags import is_bag  # noqa: PLC0415 — as above

    return _list_bag(path) if is_bag(path) else _list_table(path)


def _list_table(path: Path) -> int:
    from rich.console import Console  # noqa: PLC0415 — as above
    from rich.table import Table  # noqa: PLC0415

    from twinmatch.sessions.column_map import columns_of, proposed  # noqa: PLC0415
    from twinmatch.sessions.tables import read_table  # noqa: PLC0415

    columns = columns_of(read_table(path))
    shown = Table("column", "unit", "from", "to", "values", "empty", "looks like")
    for column in columns:
        ends = ("", "") if column.kind == "text" else (f"{column.low:.10g}", f"{column.high:.10g}")
        shown.add_row(column.title, column.unit, *ends, str(column.different), str(column.empty), column.kind)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    console.print(shown)
    _propose(proposed(columns))
    return 0


def _list_bag(path: Path) -> int:
    from rich.console import Console  # noqa: PLC0415 — as above
    from rich.table import Table  # noqa: PLC0415

    from twinmatch.sessions.bags import open_bag  # noqa: PLC0415
    from twinmatch.sessions.column_map import proposed  # noqa: PLC0415

    with open_bag(path) as bag:
        topics, seconds, columns = bag.topics, bag.seconds, bag.columns
    shown = Table("topic", "type", "messages", "per s", "numbers")
    for topic in topics:
        rate = f"{topic.messages / seconds:.3g}" if seconds else ""
        numbers = ", ".join(topic.numbers[:8]) + (" …" if len(topic.numbers) > 8 else "")
        shown.add_row(topic.name, topic.kind, str(topic.messages), rate, numbers)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    console.print(shown)
    _propose({name: source for name, source in proposed(columns).items() if name != "time"})
    return 0


def _propose(found: Mapping[str, Source]) -> None:
    """Print a first map."""
    if found:
        entries = [f"{signal}={source.text}" for signal, source in found.items()]
        print(f"A guess, please check: --map {shlex.join(entries)}")
    if "room" in found:
        print("room stands for a measured disturbance of your plant; use the names in your plant's file.")
