"""`twinmatch import`: turn a recording into a session."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twinmatch.cli.shared import (
    Progress,
    add_options,
    column_map,
    console_for,
    positive_period,
)
from twinmatch.errors import TwinmatchError
from twinmatch.importing import read_recording
from twinmatch.importing.bags import is_bag, open_bag
from twinmatch.importing.column_map import (
    SEEN,
    columns_of,
    in_words_of_all_loops,
    notes_on_angles,
    proposed,
    seen_by_controller,
)
from twinmatch.importing.derived import with_derived
from twinmatch.importing.mapped import map_samples, with_plant_names
from twinmatch.importing.mapped_bags import map_bag
from twinmatch.importing.table_files import open_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import SignalMap
from twinmatch.sessions import plant_topics, samples_of, write_session
from twinmatch.sessions.metadata import NO_REFERENCE, PLANT
from twinmatch.signals import Sample, time_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        type=Path,
        help=".csv with named columns, .mat, or a ROS bag, as a folder or a file (.mcap, .db3, .bag); "
        "without --plant it is read as a recording of the Peltier rig",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="SESSION", help="folder to write"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace an existing session"
    )
    mapping = parser.add_argument_group("your own plant, with any column names")
    listed = "show the columns and propose a map; writes nothing"
    mapping.add_argument("--list", action="store_true", help=listed)
    add_options(mapping, "--plant", help="plant that was recorded")
    add_options(
        mapping,
        "--map",
        help="time=elapsed output='t2, t3' (their mean) 'input=duty; scale=100' 'room=T1; unit=K'; for a "
        "bag: output=/camera/temperature:temperature",
    )
    add_options(mapping, "--map-file")
    add_options(mapping, "--period", help="sampling period, if not that of the rows")
    add_options(mapping, "--bridge", "--gaps")


def run(options: argparse.Namespace) -> int:
    """Write the session; returns the exit code.

    Raises:
        TwinmatchError: there is no session to write, or an option or the recording cannot be used.
    """
    if options.list:
        return _list(options.recording)
    if options.output is None:
        msg = "import: name the session to write with -o SESSION (or show the columns with --list)"
        raise TwinmatchError(msg)
    mapped = (
        options.map,
        options.map_file,
        options.plant,
        options.period,
        options.bridge,
    )
    if any(mapped) or options.gaps != "refuse" or is_bag(options.recording):
        return _import_mapped(options)

    with Progress("reading") as progress:
        window = read_recording(options.recording, progress.advance)
    _write(options, samples_of(window))
    seconds = time_text(len(window), window.period)
    print(
        f"{options.output}: {len(window)} samples, {seconds} s, from {options.recording.name}"
    )
    return 0


def _write(
    options: argparse.Namespace, samples: Sequence[Sample], **settings: Any
) -> None:
    settings["overwrite"] = options.overwrite
    with Progress("writing") as progress:
        write_session(options.output, samples, progress=progress.advance, **settings)


def _import_mapped(options: argparse.Namespace) -> int:
    signal_map = _given(options)
    limits = {"longest": options.bridge, "gaps": options.gaps}
    if not signal_map.plant:
        msg = "import: the plant is missing; give --plant NAME, --plant FILE.py, or plant: in the map file"
        raise TwinmatchError(msg)
    plant = find_plant(signal_map.plant)
    if is_bag(options.recording):
        with Progress("reading") as progress:
            imported = map_bag(
                options.recording,
                signal_map,
                plant,
                progress=progress.advance,
                **limits,
            )
    else:
        with Progress("reading") as progress:
            table = open_table(options.recording, progress.advance)
            progress.show(f"mapping {len(table.lines)} rows", 0, 0)
        table, signal_map = with_derived(table, signal_map)
        imported = map_samples(
            table, with_plant_names(table, plant, signal_map), plant, **limits
        )
    columns = "; ".join(
        f"{signal} = {source.text}" for signal, source in imported.sources.items()
    )
    record = {"plant": plant.name, "source": options.recording.name, "map": columns}
    record["reference"] = "recorded" if imported.has_reference else NO_REFERENCE
    topics = plant_topics(
        [y.unit for y in plant.outputs.values()], has_reference=imported.has_reference
    )
    split = options.gaps == "split"
    _write(
        options, imported.samples, records={PLANT: record}, gaps=split, topics=topics
    )
    seconds = time_text(len(imported.samples), imported.period)
    print(
        f"{options.output}: {len(imported.samples)} samples, one every {imported.period:g} s, "
        f"{seconds} s of {plant.title}, from {options.recording.name} ({columns})"
    )
    for note in imported.notes:
        print(f"Note: {note}")
    return 0


def _given(options: argparse.Namespace) -> SignalMap:
    period = positive_period(options, "import")
    return column_map(options).joined(
        SignalMap(plant=options.plant or "", period=period)
    )


def _list(path: Path) -> int:
    """Print what a table or a bag holds, and a first map."""
    from rich.table import Table  # noqa: PLC0415

    if is_bag(path):
        with open_bag(path) as bag:
            topics = bag.topics
            seconds = bag.seconds
            columns = bag.columns
            notes = bag.notes
        shown = Table("topic", "type", "messages", "per s", "numbers")
        for topic in topics:
            rate = f"{topic.messages / seconds:.3g}" if seconds else ""
            numbers = (
                ", ".join(topic.numbers[:8]) + (" …" if len(topic.numbers) > 8 else "")
                or topic.why
            )
            shown.add_row(topic.name, topic.kind, str(topic.messages), rate, numbers)
        sources = {
            name: source for name, source in proposed(columns).items() if name != "time"
        }
    else:
        with Progress("reading") as progress:
            table = open_table(path, progress.advance)
        columns = columns_of(table)
        shown = Table("column", "unit", "from", "to", "values", "empty", "looks like")
        for c in columns:
            ends = ("", "") if c.kind == "text" else (f"{c.low:.10g}", f"{c.high:.10g}")
            shown.add_row(
                c.title, c.unit, *ends, str(c.different), str(c.empty), c.kind
            )
        sources = proposed(columns, table)
        notes = [*table.notes, *notes_on_angles(columns, table)]
    console_for(140).print(shown)
    for note in notes:
        print(f"Note: {note}")
    if sources:
        entries = [f"{signal}={source.text}" for signal, source in sources.items()]
        print(f"A guess, please check: --map {shlex.join(entries)}")
    if seen_by_controller(columns, sources):
        print(SEEN)
    if of_all := in_words_of_all_loops(columns, sources):
        print(of_all)
    if "room" in sources:
        print(
            "room stands for a measured disturbance of your plant; use the names in your plant's file."
        )
    return 0
