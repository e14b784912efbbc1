"""Maps of signals in YAML files, and a first map of a table or a bag, guessed from its columns."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from twinmatch.decoding import decoded
from twinmatch.errors import TwinmatchError
from twinmatch.importing.clocks import is_record_number
from twinmatch.importing.dates import is_two_numbers
from twinmatch.importing.pairs import moving, share_a_word, shared_words
from twinmatch.importing.stacked import SeriesTable
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times, read_times, unit_in
from twinmatch.sampling.sources import SignalMap, SignalSource, source_of
from twinmatch.sampling.turns import angle_words, shown_turn
from twinmatch.sessions.documents import read_yaml
from twinmatch.sessions.files import RecordingError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray
from twinmatch.units import measure, of_temperature


class _MapFile(msgspec.Struct, forbid_unknown_fields=True):
    columns: dict[str, Any]
    plant: str = ""
    period: float | None = None


def read_map(path: Path) -> SignalMap:
    """Read a map from a YAML file.

    Raises:
        DocumentError: the file does not exist, or is not YAML.
        RecordingError: it is not a map.
    """
    content = decoded(read_yaml(path), _MapFile, str(path), RecordingError)
    if not content.columns:
        raise RecordingError(
            f"{path}: columns is empty; give a line for each signal, such as output: T"
        )
    if content.period is not None and not 0 < content.period < np.inf:
        raise RecordingError(
            f"{path}: period is {content.period:g}; give a positive number of seconds"
        )
    sources = {
        name: source_of(f"{path}: {name}", entry)
        for name, entry in content.columns.items()
    }
    return SignalMap(sources, content.plant, content.period)


_REFERENCE: Final = re.compile(
    r"set.?-?point|\bsp\b|^sp[_ ]?\d*$|^sv\d*$|_sp$|reference|^ref$|^r$|desired|target|"
    r"^set$|^set[_ ]|[_ ]set$|(?-i:^[Ss]et[A-Z])|sollwert|[_ ]soll$|consigne",
    re.IGNORECASE,
)
_OUTPUT: Final = re.compile(
    r"^t\d*$|(?-i:^[Tt]_?out)|temp|(?-i:^y(?:[A-Z_\d].*)?$)|^y\d*$|speed|level|pressure|"
    r"output|measur|sensor|(?:\b|_)pv[_ ]?\d*$|position|angle|flow|voltage",
    re.IGNORECASE,
)
_INPUT: Final = re.compile(
    r"heater|^heat(ing)?([_ ]|$)|[_ ]heat(ing)?$|^cool(ing|er)?([_ ]|$)|[_ ]cool(ing)?$|relay|burner|"
    r"compressor|\bfan|(?-i:^u(?:[A-Z_\d].*)?$)|^u\d*$|^q\d*$|pwm|duty|volt|current|power|valve|pump|"
    r"command|\bcmd|input|(?:\b|_)(?:mv|op)[_ ]?\d*$|drive|actuat|throttle",
    re.IGNORECASE,
)
"""Names of what is commanded; `MV` and `OP` are those of control systems, as `PV` is of what is measured."""
_PV: Final = re.compile(r"(?:\b|_)pv(?=[_ ]?\d*$)", re.IGNORECASE)
_OUT: Final = re.compile(r"(?:\b|_)out(?=[_ ]?\d*$)", re.IGNORECASE)
"""What a control system calls the drive of a loop whose `PV` it measures; alone, it may be an outlet."""
_ROOM: Final = re.compile(
    r"amb|room|outside|outdoor|\boat\b|environment|t_?inf|surround", re.IGNORECASE
)
_OUTSIDE: Final = re.compile(
    r"amb|outside|outdoor|\boat\b|environment|t_?inf|surround|weather", re.IGNORECASE
)
_INCOMING: Final = re.compile(
    r"inflow|influent|inlet|intake|zulauf|(?:\b|_)feed", re.IGNORECASE
)
"""Names of what comes into a plant: it acts on it, and is an output only where nothing else is left."""
_TIME: Final = re.compile(
    r"^t$|^tout$|^t[ _.-](ns|us|ms|s|min|h)$|time|stamp|date|^sec|elapsed|^zeit",
    re.IGNORECASE,
)


class CommandedColumns(Rule):
    """Which columns look commanded rather than measured.

    A commanded column has few different values, or holds its value and jumps. A slow reading that is rounded
    repeats its value as often, but moves by one digit.
    """

    different: int = 12
    """Most different values."""
    repeated: float = 0.9
    """Share of the rows in which a column that jumps repeats its value."""
    jump: float = 0.05
    """Usual size of its jumps, as a share of its range."""


class TitledTimes(Rule):
    """Which columns that do not grow in each row are taken as times because of their title."""

    steps_back: float = 0.1
    """Most steps back, as a share of those forward."""
    repeats: float = 0.05
    """Largest share of rows that may repeat the time before."""


_COPIED: Final = 0.05
"""Largest standard deviation of the difference of two columns that read one thing, as a share of that of each:
an input moves before its output."""
_FEWEST_EVEN: Final = 20
"""Fewest equal steps that only a time makes."""
_COMMANDED: Final = CommandedColumns()
_TITLED: Final = TitledTimes()
_SURE_TIMES: Final = (
    "time",
    "t",
    "timestamp",
    "seconds",
    "sec",
    "elapsed",
    "zeit",
    "temps",
    "tiempo",
    "tempo",
)
"""Names of columns that are taken as times even if they go back now and then."""


CLOCK: Final = "time of day"
"""Unit of a column of durations or times of day."""


class Column(NamedTuple):
    """Summary of a column."""

    title: str
    unit: str
    """Unit in its title; empty without one."""
    low: float
    high: float
    different: int
    """Number of different values."""
    empty: int
    """Rows without a value."""
    kind: str
    """`time` (increasing), `day` (dates without a time of day), `record number`, `numbers`, `on or off`,
    `constant` or `text`."""
    stepped: bool = False
    """Whether it holds its value and jumps, as a command does."""
    even: bool = False
    """Whether it rises by equal steps, as a time does, and nothing that is measured."""
    name: str = ""
    """What tells its meaning, if that is not its title without the unit."""

    @property
    def short_name(self) -> str:
        """Its name without a unit, or what it is called within its domain: `heater` of `switch.heater`."""
        return (
            self.name.rpartition("=")[2].rpartition(".")[2]
            or split_title(self.title)[0]
        )


def columns_of(table: Table) -> list[Column]:
    """Summaries of all columns."""
    if isinstance(table, SeriesTable):
        return [
            _column(table, table.time),
            *(_series(table, title) for title in table.places_of),
        ]
    return _with_drives_of_loops([_column(table, title) for title in table.columns])


def notes_on_angles(columns: Sequence[Column], table: Table) -> list[str]:
    """A note on each column that begins again after a turn."""
    notes = []
    for column in columns:
        if column.kind != "numbers":
            continue
        values = _in_order(table, column.title)
        if turn := shown_turn(values, column.unit, column.title):
            notes.append(
                f"{angle_words(column.title, turn)}: turn={turn:.6g} in the plant "
                "file's Output, where new-plant writes it, or behind the column in a map, has its turns counted."
            )
    return notes


def _in_order(table: Table, title: str) -> FloatArray:
    """The values of a column or series in the order of their times, shape (N,)."""
    if isinstance(table, SeriesTable):
        return table.own_values(title)
    return table.values(title)


def _with_drives_of_loops(columns: Sequence[Column]) -> list[Column]:
    """The columns, with `OP` for `OUT` in the names of those beside which there is the `PV` of the same loop."""
    loops = {
        _PV.sub("", column.short_name).lower()
        for column in columns
        if _PV.search(column.short_name)
    }
    named = []
    for column in columns:
        is_of_loop = _OUT.sub("", column.short_name).lower() in loops
        is_drive = is_of_loop and _OUT.search(column.short_name) is not None
        name = _OUT.sub(" op", column.short_name).strip() if is_drive else column.name
        named.append(column._replace(name=name))
    return named


def _series(table: SeriesTable, title: str) -> Column:
    """The summary of a series of a table that stacks them."""
    if table.texts.get(title):
        different = {*table.texts[title].values()}
        return Column(
            title,
            "",
            np.nan,
            np.nan,
            len(different),
            0,
            "text",
            name=table.names[title],
        )
    column = described(title, table.unit(title), table.own_values(title), ordered=True)
    kind = "numbers" if column.kind in ("time", "record number") else column.kind
    return column._replace(kind=kind, name=table.names[title])


def _column(table: Table, title: str) -> Column:
    with suppress(TwinmatchError):
        unit = table.unit(title)
        column = described(title, unit, table.values(title), ordered=True)
        # as the import reads it
        return (
            column._replace(unit=unit or unit_in(title))
            if column.kind == "time"
            else column
        )
    try:
        times = _read_any_times(table, title)
    except TwinmatchError:
        numbers = table.columns[title]
        different_texts = {
            *table.texts[title].values(),
            *numbers[np.isfinite(numbers)].tolist(),
        }
        return Column(
            title, table.unit(title), np.nan, np.nan, len(different_texts), 0, "text"
        )
    seconds = times.seconds[np.isfinite(times.seconds)]
    different = np.unique(seconds).size
    unit = CLOCK if times.origin is None else "date"
    kind = "constant" if different == 1 else "time"
    if (
        times.origin is not None
        and not (np.rint(times.origin + seconds) % 86400.0).any()
    ):
        kind = "day"
    return Column(
        title,
        unit,
        0.0,
        float(seconds.max()),
        different,
        times.seconds.size - seconds.size,
        kind,
    )


def _read_any_times(table: Table, title: str) -> Times:
    """The times in a column; two numbers, as in `12:30`, are minutes and seconds until a map says more.

    Raises:
        TwinmatchError: it has no times.
    """
    try:
        return read_times(table, title)
    except TwinmatchError:
        if not is_two_numbers(next(iter(table.texts.get(title, {}).values()), "")):
            raise
        return read_times(table, title, "min")


def described(title: str, unit: str, values: FloatArray, *, ordered: bool) -> Column:
    """The summary of a column of numbers, shape (N,), nan in rows without a value.

    `ordered`: whether the values are in the order of time, so that the column may be a time or stepped.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Column(title, unit, np.nan, np.nan, 0, values.size, "text")
    different = np.unique(finite)
    return Column(
        title,
        unit,
        low=float(finite.min()),
        high=float(finite.max()),
        different=int(different.size),
        empty=values.size - finite.size,
        kind=_kind(title, finite, different, ordered=ordered),
        stepped=ordered and _is_stepped(finite),
        even=ordered and _is_even(finite),
    )


def _kind(
    title: str, finite: FloatArray, different: FloatArray, *, ordered: bool
) -> str:
    """The kind of a column with these `finite` values, in their order; `different` has each of them once."""
    if different.size == 1:
        return "constant"
    if ordered and _is_time(title, finite):
        name, _ = split_title(title)
        return "record number" if is_record_number(name, finite) else "time"
    return "on or off" if set(different) <= {0.0, 1.0} else "numbers"


def _is_time(title: str, finite: FloatArray) -> bool:
    """Whether a column grows in each row or, if its title is that of a time, in nearly all of them.

    A logger may write a row twice; more repeats are those of another quantity, such as a counter. A restarted
    logger sets its time back, and a time may have too few digits: the import says so.
    """
    if finite.size <= 2:
        return False
    steps = np.diff(finite)
    if (steps > 0).all():
        return True
    name, _ = split_title(title)
    if _TIME.search(name) is None:
        return False
    repeats_rarely = bool((steps >= 0).all()) and np.sum(steps == 0) <= max(
        1, _TITLED.repeats * steps.size
    )
    set_back_rarely = bool((steps < 0).sum() <= _TITLED.steps_back * (steps > 0).sum())
    return bool(repeats_rarely or (set_back_rarely and name.lower() in _SURE_TIMES))


def _is_even(values: FloatArray) -> bool:
    """Whether a column rises by equal steps."""
    steps = np.diff(values)
    return (
        steps.size >= _FEWEST_EVEN
        and float(steps.min()) > 0.0
        and float(np.ptp(steps)) < 1e-6 * float(steps.max())
    )


def _is_stepped(values: FloatArray) -> bool:
    """Whether a column mostly holds its value and else jumps."""
    changes = np.abs(np.diff(values))
    moved = changes[changes > 0]
    if not moved.size or moved.size > (1.0 - _COMMANDED.repeated) * changes.size:
        return False
    return float(np.median(moved)) >= _COMMANDED.jump * float(np.ptp(values))


def proposed(
    columns: Sequence[Column], table: Table | None = None
) -> dict[str, SignalSource]:
    """A guess at the columns of time, output, input, reference and room, for a person to check.

    With the `table` itself, further inputs are `input.2` and so on: those with which the output moves, too.
    """
    chosen = _chosen(columns)
    if table is not None:
        _replace_copy(columns, chosen, table)
    if table is not None and "output" not in chosen and "room" in chosen:
        chosen["output"] = chosen.pop("room")
    _pair_by_name(columns, chosen)
    if table is not None:
        _replace_unmoved(columns, chosen, table)
    if seen_by_controller(
        columns, {signal: SignalSource((c.title,)) for signal, c in chosen.items()}
    ):
        chosen["output"], chosen["input"] = _in_and_out(columns)
    elif table is not None:
        _add_inputs(columns, chosen, table)
    sources = {
        signal: SignalSource((column.title,)) for signal, column in chosen.items()
    }
    if day_and_clock := _day_and_clock(columns):
        sources["time"] = SignalSource(day_and_clock)
    order = (
        "time",
        "output",
        "input",
        *(signal for signal in sources if "." in signal),
        "reference",
        "room",
    )
    return {signal: sources[signal] for signal in order if signal in sources}


def _chosen(columns: Sequence[Column]) -> dict[str, Column]:
    """The first column for each signal that no signal before has."""
    chosen: dict[str, Column] = {}
    for signal, candidates in _candidates(columns):
        free = [column for column in candidates if column not in chosen.values()]
        if signal not in chosen and free:
            chosen[signal] = free[0]
    return chosen


def _replace_copy(
    columns: Sequence[Column], chosen: dict[str, Column], table: Table
) -> None:
    """Take no column for the input that reads what the output does, such as the largest value of each interval.

    Another one that is left takes its place; without one there is no input. One that is called an input stays.
    """
    output = chosen.get("output")
    guessed = chosen.get("input")
    if output is None or guessed is None or _INPUT.search(guessed.short_name):
        return
    if not _is_copy(table, guessed.title, output.title):
        return
    del chosen["input"]
    for column in _of_kind(columns, "numbers"):
        is_free = column not in chosen.values() and not column.even
        if is_free and not _is_copy(table, column.title, output.title):
            chosen["input"] = column
            return


def _replace_unmoved(
    columns: Sequence[Column], chosen: dict[str, Column], table: Table
) -> None:
    """Take another output where the input moves that one, and not the one that was taken.

    One of the same kind that no input moves, such as a temperature outside, is a disturbance.
    """
    output = chosen.get("output")
    drive = chosen.get("input")
    if output is None or drive is None or isinstance(table, SeriesTable):
        return
    others = [
        column
        for signal, candidates in _candidates(columns)
        if signal == "output"
        for column in candidates
        if column not in chosen.values()
        and column.kind == "numbers"
        and not _may_be_commanded(column)
        and column.unit == output.unit
    ]
    if not others or _is_moved(table, output, drive):
        return
    moved = next((c for c in others if _is_moved(table, c, drive)), None)
    if moved is not None:
        chosen["output"] = moved
        chosen.setdefault("room", output)


def _is_moved(table: Table, output: Column, drive: Column) -> bool:
    """Whether an output moves with an input."""
    return moving(table.values(output.title), [table.values(drive.title)])[0]


def _is_copy(table: Table, title: str, of_title: str) -> bool:
    """Whether a column differs little from another one in each row."""
    try:
        column = table.values(title)
        original = table.values(of_title)
    except TwinmatchError:
        return False
    is_there = np.isfinite(column) & np.isfinite(original)
    if not is_there.any():
        return False
    difference = column[is_there] - original[is_there]
    movement = float(np.std(original[is_there]))
    is_near = float(np.abs(np.mean(difference))) <= movement
    return is_near and float(np.std(difference)) < _COPIED * movement


def _pair_by_name(columns: Sequence[Column], chosen: dict[str, Column]) -> None:
    """Exchange input and set-point for those of the thing that the output is of, where names say it."""
    output = chosen.get("output")
    if output is None:
        return
    for signal in ("input", "reference"):
        column = chosen.get(signal)
        if column is None:
            continue
        of_signal = [
            c
            for name, candidates in _candidates(columns)
            if name == signal
            for c in candidates
        ]
        others = [chosen[name] for name in chosen if name != signal]
        free = [column, *(c for c in of_signal if c not in others)]
        if signal == "input":
            free = _as_likely(free)
        chosen[signal] = _most_alike(output, free)


def _as_likely(inputs: Sequence[Column]) -> list[Column]:
    """The inputs that are as likely as the first: a number in its name makes no input of a reading, as L2 is one
    beside P2."""
    first = inputs[0]
    is_likely = _may_be_commanded(first)
    measured = _of_units(inputs)
    return [
        column
        for column in inputs
        if _may_be_commanded(column) >= is_likely
        and (column not in measured or first in measured)
    ]


def _may_be_commanded(column: Column) -> bool:
    """Whether a column is called an input, or holds its values as one."""
    return (
        column.stepped
        or column.kind == "on or off"
        or _INPUT.search(column.short_name) is not None
    )


def _most_alike(output: Column, columns: Sequence[Column]) -> Column:
    """The first of the columns that share most words with an output."""
    return max(columns, key=lambda c: shared_words(c.short_name, output.short_name))


def of_all_loops(
    columns: Sequence[Column], sources: Mapping[str, SignalSource]
) -> dict[str, SignalSource]:
    """The guess with the further outputs that have an input of the same thing, by name; empty without one.

    `sources` is the guess at one loop, or at one output with several inputs.
    """
    inputs = _columns_of_role(columns, sources, "input")
    outputs = _columns_of_role(columns, sources, "output")
    if not inputs or len(outputs) != 1:
        return {}
    further_outputs, further_inputs = _free_signals(columns, sources)
    if len(inputs) == 1:
        # one that moves the output needs no name of the same thing
        first = [(outputs[0], inputs[0])]
        pairs = [*first, *_paired(further_outputs, further_inputs)]
    else:
        pairs = _paired([*outputs, *further_outputs], [*inputs, *further_inputs])
    if len(pairs) < 2 or outputs[0] not in [output for output, _ in pairs]:
        return {}
    pairs.sort(key=lambda pair: columns.index(pair[0]))
    several = {
        name: source for name, source in sources.items() if name in ("time", "room")
    }
    for number, (output, drive) in enumerate(pairs, 1):
        several[f"output.{number}"] = SignalSource((output.title,))
        several[f"input.{number}"] = SignalSource((drive.title,))
    return several


def _columns_of_role(
    columns: Sequence[Column], sources: Mapping[str, SignalSource], role: str
) -> list[Column]:
    """The columns of the signals of a role, such as `input` and `input.2`, in the order of the guess."""
    of_title = {column.title: column for column in columns}
    return [
        of_title[title]
        for signal, source in sources.items()
        if signal.partition(".")[0] == role
        for title in source.places
        if title in of_title
    ]


def _free_signals(
    columns: Sequence[Column], sources: Mapping[str, SignalSource]
) -> tuple[list[Column], list[Column]]:
    """The outputs and the inputs among the columns that a guess does not use, by names and units."""
    used = {title for source in sources.values() for title in source.places}
    free = [
        c
        for c in columns
        if c.title not in used and not _REFERENCE.search(c.short_name)
    ]
    measured = _of_units(free)
    drives = [
        c for c in _named(free, _INPUT, ("on or off", "numbers")) if c not in measured
    ]
    outputs = [
        c
        for c in _named(free, _OUTPUT, ("numbers",))
        if c not in drives and c not in measured
    ]
    return [*outputs, *measured], drives


def in_words_of_all_loops(
    columns: Sequence[Column], sources: Mapping[str, SignalSource]
) -> str:
    """A sentence with that guess; empty without one."""
    several = of_all_loops(columns, sources)
    if not several:
        return ""
    loops = sum(name.startswith("input.") for name in several)
    words = shlex.join(f"{signal}={source.text}" for signal, source in several.items())
    return f"The table has signals of {loops} loops; for a plant of all of them: --map {words}"


def _paired(
    outputs: Sequence[Column], drives: Sequence[Column]
) -> list[tuple[Column, Column]]:
    """Each output with the drive of the same thing that no other output has."""
    pairs: list[tuple[Column, Column]] = []
    for output in outputs:
        taken = [drive for _, drive in pairs]
        free = [drive for drive in drives if drive not in taken]
        if not free:
            break
        drive = _most_alike(output, free)
        if share_a_word(drive.short_name, output.short_name):
            pairs.append((output, drive))
    return pairs


def _add_inputs(
    columns: Sequence[Column], chosen: dict[str, Column], table: Table
) -> None:
    """Add what is an input by its name or its values, if the output moves with it beside the first input.

    What reads back another input is none.
    """
    if not {"output", "input"} <= chosen.keys():
        return
    output = chosen["output"]
    outputs = [c for c in _of_units(columns) if c is not output]
    further = [
        c
        for c in columns
        if c not in chosen.values()
        and _is_like_input(c, chosen["input"])
        and not any(share_a_word(c.short_name, other.short_name) for other in outputs)
        and not _is_copy(table, c.title, chosen["input"].title)
    ]
    inputs = [chosen["input"], *further]
    if not further or isinstance(table, SeriesTable):
        return
    is_moving = moving(
        table.values(output.title), [table.values(column.title) for column in inputs]
    )
    moved_by = [
        column for column, moves in zip(inputs, is_moving, strict=True) if moves
    ]
    if len(moved_by) < 2:
        return
    del chosen["input"]
    chosen.update(
        {f"input.{number}": column for number, column in enumerate(moved_by, 1)}
    )


def _is_like_input(column: Column, first: Column) -> bool:
    """Whether a column is switched, steps under the name of an input, or is of the first input's kind: two valves
    in per cent."""
    if column.kind == "on or off":
        return True
    words = _words_of_inputs(column)
    has_its_words = column.kind == "numbers" and bool(words & _words_of_inputs(first))
    is_of_its_kind = has_its_words and column.unit == first.unit != ""
    return is_of_its_kind or (column.stepped and bool(words))


def _words_of_inputs(column: Column) -> frozenset[str]:
    """What in the name of a column is that of an input, such as `valve`."""
    words = (found.group().strip(" _") for found in _INPUT.finditer(column.short_name))
    return frozenset(word.lower() for word in words)


def _day_and_clock(columns: Sequence[Column]) -> tuple[str, ...]:
    """The titles of a column of dates and of one of times of day, which are one time; empty without both."""
    days = _of_kind(columns, "day")
    clocks = [column for column in columns if column.unit == CLOCK]
    return (days[0].title, clocks[0].title) if days and clocks else ()


def _candidates(columns: Sequence[Column]) -> list[tuple[str, list[Column]]]:
    """Signals, each with columns that may be it; a signal comes again with weaker candidates.

    Pairs are tried in this order: what a title says comes before how the values behave.
    """
    references = _named(columns, _REFERENCE, ("numbers", "constant"))
    signals = [
        column for column in columns if column not in references and not column.even
    ]
    titled_inputs = _named(signals, _INPUT, ("on or off", "numbers"))
    incoming = _named(signals, _INCOMING, ("numbers",))
    titled_outputs = _liveliest(
        [
            column
            for column in _named(signals, _OUTPUT, ("numbers", "time"))
            if column not in incoming
        ]
    )
    measured = _liveliest(
        [column for column in _of_units(signals) if column not in incoming]
    )
    numbers = _of_kind(signals, "numbers")
    going_out = [column for column in numbers if column not in incoming]
    return [
        ("time", _named(columns, _TIME, ("time",))),
        ("reference", references),
        ("room", _named(columns, _OUTSIDE, ("numbers", "constant"))),
        ("room", _named(columns, _ROOM, ("numbers", "constant"))),
        (
            "input",
            [
                column
                for column in titled_inputs
                if column.stepped or column.kind == "on or off"
            ],
        ),
        ("input", titled_inputs),
        ("input", [column for column in numbers if column.stepped]),
        ("output", [column for column in titled_outputs if not column.stepped]),
        ("output", [column for column in measured if not column.stepped]),
        ("output", titled_outputs),
        ("time", _of_kind(columns, "time")),
        ("input", _of_kind(columns, "on or off")),
        (
            "input",
            [column for column in numbers if column.different <= _COMMANDED.different],
        ),
        ("output", _liveliest(going_out)),
        ("output", _liveliest(incoming)),
        ("input", [column for column in numbers if column not in measured]),
        ("input", numbers),
    ]


SEEN: Final = (
    "Input is taken as what is measured, and Output as the drive: the set-point is near Input, as where PID "
    "libraries give these names. If that is wrong, exchange them in --map."
)


def seen_by_controller(
    columns: Sequence[Column], sources: Mapping[str, SignalSource]
) -> bool:
    """Whether Input and Output are the controller's, as in PID libraries: Input is what it measures.

    The set-point tells, since what is measured follows it: its range is then nearer to that of Input.
    """
    input_and_output = _in_and_out(columns)
    references = sources["reference"].places if "reference" in sources else ()
    reference = next((column for column in columns if column.title in references), None)
    if len(input_and_output) != 2 or reference is None:
        return False
    input_distance, output_distance = (
        _distance(column, reference) for column in input_and_output
    )
    return input_distance < output_distance


def _distance(column: Column, other: Column) -> float:
    """How far the lowest and the highest values of two columns differ, together."""
    return abs(column.low - other.low) + abs(column.high - other.high)


def _in_and_out(columns: Sequence[Column]) -> list[Column]:
    """The columns Input and Output, if there are both."""
    named = {c.short_name.lower(): c for c in columns if c.kind != "text"}
    return [named[name] for name in ("input", "output") if name in named]


def _named(
    columns: Sequence[Column], words: re.Pattern[str], kinds: Sequence[str]
) -> list[Column]:
    """The columns of these kinds whose names, without units, match."""
    return [c for c in columns if c.kind in kinds and words.search(c.short_name)]


def _of_units(columns: Sequence[Column]) -> list[Column]:
    """The columns with a unit of what is measured, rather than commanded: a temperature, a pressure."""
    temperature_and_pressure = (measure("K").dimension, measure("Pa").dimension)
    return [
        column
        for column in columns
        if column.kind == "numbers"
        and column.unit
        and measure(of_temperature(column.unit)).dimension in temperature_and_pressure
    ]


def _of_kind(columns: Sequence[Column], kind: str) -> list[Column]:
    return [column for column in columns if column.kind == kind]


def _liveliest(columns: Sequence[Column]) -> list[Column]:
    """Columns with most different values first: of several temperatures, the room's varies least."""
    return sorted(columns, key=lambda column: -column.different)
