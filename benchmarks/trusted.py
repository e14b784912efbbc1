"""What the word "trusted" is worth on recordings of real plants, by a count of our own.

    python -m benchmarks.trusted
    python -m benchmarks.trusted "rig 2" "kit, closed loop"

A forecast counts at the horizons that the newest verdict before it trusted, if that verdict's level is `trusted`.
Its error is that of the backtest; a horizon of a recording is better than a baseline if the sum of its errors is
smaller. The typical forecast's error, relative to that of ARX at the same sample, is beside it. The recordings are not
part of the project: TWINMATCH_RECORDINGS and TWINMATCH_PLANT_RECORDINGS name their folders, and absent ones are
skipped.
"""

from __future__ import annotations

import contextlib
import csv
import io
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from tests.support.places import OTHERS, RECORDINGS
from twinmatch.cli import main as twinmatch
from twinmatch.comparing import TrustLevel
from twinmatch.importing import open_any
from twinmatch.offline.backtest import Choices, Listener
from twinmatch.offline.backtest.run import graded_outputs
from twinmatch.offline.backtest.scoring import LEADER, PEERS, Backtest, Marks
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.sessions import Session, read_session, write_session
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin

LEAST: Final = 5
"""Number of trusted forecasts from which on a horizon of a recording is counted."""
KIT_COLUMNS: Final = ("T1", "T2", "Q1", "Q2")


@dataclass
class TrustedOrigins:
    """Which horizons were trusted when each forecast was made."""

    listener: Listener
    trusted: tuple[float, ...] = ()
    by_sample: dict[int, tuple[float, ...]] = field(default_factory=dict)

    def __call__(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Take the outcome of one sample, as the listener does."""
        for verdict in outcome.verdicts:
            is_trusted = verdict.level is TrustLevel.TRUSTED
            self.trusted = verdict.trusted if is_trusted else ()
        self.by_sample[sample.index] = self.trusted
        self.listener(twin, sample, outcome)


class HorizonRow(NamedTuple):
    """The trusted forecasts of one output of one recording at one horizon."""

    horizon: float
    """Horizon, s."""
    forecasts: int
    """Number of them."""
    persistence: float
    """Sum of the leader's errors over that of a forecast of no change."""
    arx: float
    """The same beside ARX."""
    typical: float
    """Median of the leader's errors over those of ARX, forecast by forecast."""
    halves: tuple[float, float]
    """Shares of the output's samples within the bands, in each half of these forecasts."""


def trusted_rows(tested: Backtest, origins: TrustedOrigins) -> Iterator[HorizonRow]:
    """The trusted forecasts of a backtest, horizon by horizon."""
    for horizon in tested.horizons:
        marks: dict[str, dict[int, Marks]] = {}
        for mark in tested.marked:
            if mark.horizon == horizon and horizon in origins.by_sample[mark.sample]:
                marks.setdefault(mark.who, {})[mark.sample] = mark.marks
        of_leader = marks.get(LEADER, {})
        if len(of_leader) < LEAST:
            continue
        error = sum(mark.error for mark in of_leader.values())
        errors_of_peers = [
            sum(mark.error for mark in marks[PEERS[peer]].values()) for peer in PEERS
        ]
        of_arx = marks[PEERS["arx"]]
        typical = np.median(
            [mark.error / of_arx[sample].error for sample, mark in of_leader.items()]
        )
        coverages = [of_leader[sample].output.coverage for sample in sorted(of_leader)]
        half = len(coverages) // 2
        yield HorizonRow(
            horizon,
            len(of_leader),
            error / errors_of_peers[0],
            error / errors_of_peers[1],
            float(typical),
            (float(np.mean(coverages[:half])), float(np.mean(coverages[half:]))),
        )


def imported(
    table: Path, plant: str, *mapped: str, gaps: str = "refuse"
) -> Callable[[Path], Session]:
    """A table by `twinmatch import`."""

    def session(folder: Path) -> Session:
        out = folder / "session"
        arguments = ["import", str(table), "--plant", plant, "--gaps", gaps]
        with contextlib.redirect_stdout(io.StringIO()):
            code = twinmatch([*arguments, "--map", *mapped, "-o", str(out)])
        if code != 0:
            raise FileNotFoundError(table)
        return open_any(out)

    return session


def kit(
    table: Path, period: int, columns: Sequence[str] = KIT_COLUMNS
) -> Callable[[Path], Session]:
    """A kit with both heaters, under its inputs."""

    def session(folder: Path) -> Session:
        with table.open(encoding="utf-8") as lines:
            rows = [
                {t.strip(): x for t, x in row.items()} for row in csv.DictReader(lines)
            ]
        samples = []
        for k, row in enumerate(rows):
            first, second, power, second_power = (
                float(row[title]) for title in columns
            )
            samples.append(
                Sample(
                    k,
                    10**9 * period * k,
                    (0.0, 0.0),
                    (first, second),
                    (power, second_power),
                )
            )
        written = read_session(write_session(folder / "kit", samples))
        return replace(written, plant="tclab-both", has_reference=False)

    return session


def rig(number: int) -> Callable[[Path], Session]:
    """An hour of the rig."""
    path = RECORDINGS / f"BMData{number}_022722.mat"
    return lambda _: open_any(path)


def recordings() -> dict[str, Callable[[Path], Session]]:
    """How each recording is opened, in an empty folder, by its name."""
    incubators = OTHERS / "incubator"
    of_box = ("time=time", "output=t2, t3", "input=heater_on", "room=t1")
    kits = OTHERS / "tclab_2x2"
    others = OTHERS / "tclab_other"
    wide = (
        "Temperature 1 (degC)",
        "Temperature 2 (degC)",
        "Heater 1 (%)",
        "Heater 2 (%)",
    )
    return {
        "kit, one heater": imported(
            OTHERS / "tclab" / "one_heater_600s.csv",
            "tclab",
            *("time=time", "output=T", "input=Q"),
        ),
        "kit, two heaters": kit(OTHERS / "tclab" / "two_heaters_600s.csv", 1, wide),
        **{
            f"kit, mpc {number}": kit(others / f"mpc_{number}.csv", 5)
            for number in (1, 44, 45, 54)
        },
        **{
            f"incubator {number}": imported(
                incubators / f"{name}.csv", "incubator", *of_box
            )
            for number, name in enumerate(("exp1_ht3_hg2", "exp2_ht20_hg30"), 1)
        },
        "incubator, lid in March": imported(
            incubators / "lid_opening_mar_2021_first.csv",
            "incubator",
            *of_box,
            gaps="split",
        ),
        "kit, open loop": kit(kits / "prbs_open_loop.csv", 1),
        "kit, closed loop": kit(kits / "closed_loop_lqg.csv", 1),
        "kit, disturbed a": kit(kits / "disturbances_a.csv", 1),
        "kit, disturbed b": kit(kits / "disturbances_b.csv", 1),
        **{f"rig {number}": rig(number) for number in (1, 2, 5, 9, 14, 20, 27)},
    }


def rows_of_recording(
    name: str, opened: Callable[[Path], Session]
) -> Iterator[tuple[str, HorizonRow]]:
    """The rows of each output of a recording."""
    with tempfile.TemporaryDirectory() as folder:
        session = replace(opened(Path(folder)), name=name)
    terms = terms_from_files(session)
    listener = Listener(name, terms.settings, Choices())
    origins = TrustedOrigins(listener)
    judgement = judge(session, terms, beside=origins)
    for tested in graded_outputs(judgement, listener):
        for row in trusted_rows(tested, origins):
            yield tested.name, row


def main(names: Sequence[str]) -> None:
    """Print a line for each trusted horizon, and the shares of all of them."""
    rows = []
    print(
        "recording                      horizon     n | / persistence  / ARX  typical | inside, by halves",
        flush=True,
    )
    for name, opened in recordings().items():
        if names and name not in names:
            continue
        try:
            of_recording = list(rows_of_recording(name, opened))
        except FileNotFoundError as error:
            print(f"{name}: skipped: {error}", flush=True)
            continue
        rows += [row for _, row in of_recording]
        for title, row in of_recording:
            early, late = row.halves
            print(
                f"{title:30s} {row.horizon:6.0f} s {row.forecasts:5d} | "
                f"{row.persistence:13.2f} {row.arx:6.2f} {row.typical:8.2f} | "
                f"{early:4.0%} {late:4.0%}",
                flush=True,
            )
        if not of_recording:
            print(f"{name}: no horizon was trusted for {LEAST} forecasts", flush=True)
    if not rows:
        return
    better = [row.persistence < 1.0 for row in rows]
    better_than_arx = [row.arx < 1.0 for row in rows]
    nearly_arx = [row.arx < 1.1 for row in rows]
    better_typically = [row.typical < 1.0 for row in rows]
    halves = [0.85 <= share <= 0.95 for row in rows for share in row.halves]
    print(
        f"{len(rows)} trusted horizons: better than persistence {np.mean(better):.0%}, "
        f"than ARX {np.mean(better_than_arx):.0%} (not worse by more than a tenth {np.mean(nearly_arx):.0%}; "
        f"typically better {np.mean(better_typically):.0%}); "
        f"halves whose bands hold 85 to 95 %: {np.mean(halves):.0%} of {len(halves)}"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
