"""What golden results are computed from: each source is a session and the commands that are run on it.

Everything goes through `twinmatch`, as users run it, so that the digests outlast any rebuilding inside.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from tests.support.fmus import build_c_fmu, write_map
from tests.support.places import OTHERS, RECORDINGS, SHIPPED
from tests.support.steps import quarter_of_an_hour
from twinmatch.cli import main
from twinmatch.plants import PLANTS
from twinmatch.sessions import write_session

Documents = dict[str, Any]
"""What the commands wrote, by the name of the command."""


class MissingSourceError(Exception):
    """A recording or a tool is not on this machine."""


def documents_of(name: str, folder: Path) -> Documents:
    """Run the commands of a source in an empty folder and return what they wrote.

    Raises:
        MissingSourceError: the recording is not here.
    """
    before = {plant: set(PLANTS[plant].structures) for plant in PLANTS}
    try:
        return SOURCES[name](folder)
    finally:
        for plant, names in before.items():
            for adopted in set(PLANTS[plant].structures) - names:
                source = PLANTS[plant].structures[adopted].external
                PLANTS[plant].disown(adopted)
                source.close()  # type: ignore[union-attr]


def _run(command: str, *options: object, out: Path | None = None) -> Any:
    """Run a command, quietly; returns the JSON that it wrote into `out`."""
    arguments = [command, *map(str, options), *(["--json", str(out)] if out else [])]
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(arguments)
    if code != 0:
        raise AssertionError(f"twinmatch {' '.join(arguments)} ended with {code}")
    return json.loads(out.read_text(encoding="utf-8")) if out else None


def _present(path: Path) -> Path:
    if not path.exists():
        raise MissingSourceError(
            f"{path} is not here; see TWINMATCH_RECORDINGS, TWINMATCH_PLANT_RECORDINGS"
        )
    return path


def _replayed(session: Path, folder: Path, *options: object) -> Documents:
    return {"replay": _run("replay", session, *options, out=folder / "replay.json")}


def _imported(
    table: Path, folder: Path, plant: str, *mapped: str, gaps: str = "refuse"
) -> Path:
    session = folder / "session"
    _run(
        "import",
        _present(table),
        "--plant",
        plant,
        "--gaps",
        gaps,
        "--map",
        *mapped,
        "-o",
        session,
    )
    return session


def _shipped(folder: Path) -> Documents:
    return _replayed(SHIPPED, folder)


def _rig(number: int) -> Callable[[Path], Documents]:
    return lambda folder: _replayed(
        _present(RECORDINGS / f"BMData{number}_022722.mat"), folder
    )


def _incubator(name: str) -> Callable[[Path], Documents]:
    mapped = ("time=time", "output=t2, t3", "input=heater_on", "room=t1")

    def documents(folder: Path) -> Documents:
        table = OTHERS / "incubator" / f"{name}.csv"
        return _replayed(_imported(table, folder, "incubator", *mapped), folder)

    return documents


def _one_heater(folder: Path) -> Documents:
    table = OTHERS / "tclab" / "one_heater_600s.csv"
    return _replayed(
        _imported(table, folder, "tclab", "time=time", "output=T", "input=Q"), folder
    )


def _two_heaters(folder: Path) -> Documents:
    """Judged once: the backtest has its own run through the twin."""
    mapped = (
        "time=Time (sec)",
        "output=Temperature 1 (degC)",
        "input=Heater 1 (%)",
        "second=Heater 2 (%)",
    )
    session = _imported(
        OTHERS / "tclab" / "two_heaters_600s.csv", folder, "tclab", *mapped
    )
    tested = _run("backtest", session, "--every", 100, out=folder / "backtest.json")
    return {**_replayed(session, folder), "backtest": tested}


def _quarter(folder: Path) -> Path:
    return write_session(folder / "quarter", quarter_of_an_hour())


def _forecasts(folder: Path) -> Documents:
    session = _quarter(folder)
    out = folder / "forecast.json"
    return {
        "held": _run("forecast", session, "--at", 500, 700, "--hold", 70, out=out),
        "recorded": _run(
            "forecast", session, "--at", 600, "--reference", "recorded", out=out
        ),
    }


def _backtest(folder: Path) -> Documents:
    return {
        "backtest": _run(
            "backtest", _quarter(folder), "--every", 180, out=folder / "backtest.json"
        )
    }


def _report(folder: Path) -> Documents:
    """The numbers in the tables of a report, table by table."""
    page = folder / "report.html"
    _run("report", _quarter(folder), "-o", page, "--peers", "persistence", "arx")
    tables = _Tables()
    tables.feed(page.read_text(encoding="utf-8"))
    return {"report": {f"table {k}": rows for k, rows in enumerate(tables.found)}}


def _split(folder: Path) -> Documents:
    """A table with two gaps and columns of its own, split where they are."""
    lines = ["elapsed,plate,target,pwm"]
    for s in quarter_of_an_hour():
        if not (250 <= s.index < 280 or 640 <= s.index < 650):
            lines.append(f"{s.index},{s.output!r},{s.reference!r},{s.input!r}")
    table = folder / "table.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    mapped = ("time=elapsed", "output=plate", "reference=target", "input=pwm")
    return _replayed(_imported(table, folder, "peltier", *mapped, gaps="split"), folder)


def _fmu(folder: Path) -> Documents:
    """Eight minutes with a compiled model exchange FMU among the structures."""
    if shutil.which("gcc") is None:
        raise MissingSourceError("no gcc to build an FMU with")
    allowed = write_map(folder, build_c_fmu(folder))
    session = write_session(folder / "eight", quarter_of_an_hour()[:480])
    return _replayed(session, folder, "--allow-fmu", allowed)


SOURCES: dict[str, Callable[[Path], Documents]] = {
    **{f"rig_{number}": _rig(number) for number in (1, 2, 5, 9, 14, 20, 27)},
    "incubator_first": _incubator("exp1_ht3_hg2"),
    "incubator_second": _incubator("exp2_ht20_hg30"),
    "incubator_lid": _incubator("lid_opening_jan_2021"),
    "shipped": _shipped,
    "fmu": _fmu,
    "report": _report,
    "backtest": _backtest,
    "forecasts": _forecasts,
    "tclab_one": _one_heater,
    "tclab_two": _two_heaters,
    "split_table": _split,
}
"""Commands of every source, the longest first."""


class _Tables(HTMLParser):
    """The numbers in the cells of a report's tables, row by row; not in those of what it was made with."""

    _NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

    def __init__(self) -> None:
        super().__init__()
        self.found: list[list[list[str]]] = []
        self._inside = self._over = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        # versions, paths and dates
        self._over = self._over or ("id", "provenance") in attrs
        if self._over:
            return
        if tag == "table":
            self.found.append([])
        elif tag == "tr" and self.found:
            self.found[-1].append([])
        elif tag in ("td", "th"):
            self._inside = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._inside = False

    def handle_data(self, data: str) -> None:
        if self._inside and not self._over and self.found and self.found[-1]:
            self.found[-1][-1] += self._NUMBER.findall(data)
