"""What is said of a live kit with two heaters: told and false, under two PIDs and under a linear law.

    python -m benchmarks.two_heaters
    python -m benchmarks.two_heaters --healthy 60 --mishaps 0

The kit is the model of the package `tclab`, whose equations differ from those of our plant file: linear, with
other lags, and readings in steps of 0.32 °C. Each run takes 40 minutes of its time. A mishap begins after 25
minutes; it counts if its name, with its channel, is the first that is given, and every other name is false.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import random
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.bank.kits import typical
from twinmatch.control import Loop
from twinmatch.dynamics import Law, LinearLaw, linearised
from twinmatch.dynamics.loop import Controller
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.plants import TCLabBoth
from twinmatch.signals import Sample

SIZE = 2400
"""Length of a run, s."""
BEGINS = 1500
"""When a mishap begins, s."""
LEVELS = [(35.0, 35.0), (50.0, 35.0), (50.0, 45.0), (40.0, 45.0)]
"""Set-points, °C, in turn."""
HOLD = 450
"""How long each of them is held, s."""
_SLICES = 10
"""Steps of the model in a second."""


class Mishap(NamedTuple):
    """What happens to one heater or sensor."""

    fault: str
    signal: str
    """Name by which it is to be reported, and the signal in the plant file."""
    place: int
    """0 for the first heater or sensor, 1 for the second."""
    offset: float = 0.0
    """What is added to the reading, °C."""
    share: float = 1.0
    """What arrives of the heater's power."""


MISHAPS = {
    "T1 +5 °C": Mishap("sensor-drift", "temperature", 0, offset=5.0),
    "T2 -4 °C": Mishap("sensor-drift", "second_temperature", 1, offset=-4.0),
    "Q1 × 0": Mishap("drive-lost", "power", 0, share=0.0),
    "Q2 × 0.5": Mishap("drive-weak", "second", 1, share=0.5),
    "Q1 × 0.7": Mishap("drive-weak", "power", 0, share=0.7),
}


def linear_law() -> LinearLaw:
    """A law for both heaters together: proportional and integral through the inverse of the kit's gains, with
    back-calculation at the limits."""
    kit = linearised(typical(), [42.0, 40.0], 1.0)
    states = len(kit.A)
    gains = kit.C @ np.linalg.solve(np.eye(states) - kit.A, kit.B)
    apart = np.array(np.linalg.inv(gains), dtype=np.float64)
    proportional = 3.0 * apart
    integral = 0.02 * apart
    untie = np.array(0.05 * np.linalg.inv(integral), dtype=np.float64)
    unit = np.eye(2)
    # x ← x + (r − y) + untie (u − the unlimited u), u = integral x + proportional (r − y)
    return LinearLaw(
        A=unit - untie @ integral,
        B=-unit + untie @ proportional,
        C=integral,
        D=-proportional,
        E=proportional,
        F=unit - untie @ proportional,
        G=untie,
        offset=np.zeros(2),
        shift=np.zeros(2),
        low=np.zeros(2),
        high=np.full(2, 100.0),
    )


def by_pids() -> Callable[[int, tuple[float, float], tuple[float, float]], Sample]:
    """The kit's own loop: samples from second, set-points and readings."""
    loop = Loop(TCLabBoth)

    def tick(
        second: int, wanted: tuple[float, float], read: tuple[float, float]
    ) -> Sample:
        loop.measure(read, second * 10**9)
        sample = loop.tick(second * 10**9, lambda _: wanted)
        assert sample is not None
        return sample

    return tick


def by_law(
    law: Law,
) -> Callable[[int, tuple[float, float], tuple[float, float]], Sample]:
    """The same with another law."""
    controller = Controller(law)

    def tick(
        second: int, wanted: tuple[float, float], read: tuple[float, float]
    ) -> Sample:
        commands = controller.step(wanted, read)
        return Sample(second, second * 10**9, wanted, read, tuple(commands.tolist()))

    return tick


def run(seed: int, mishap: Mishap | None, law: str) -> Iterator[Sample]:
    """One kit."""
    import tclab  # noqa: PLC0415

    random.seed(seed)  # the model draws its noise there
    np.random.seed(seed)
    with contextlib.redirect_stdout(io.StringIO()):
        model = tclab.TCLabModel(synced=False)
    model.tlast = 0.0
    tick = by_pids() if law == "pid" else by_law(linear_law())
    for second in range(SIZE):
        on = mishap if mishap is not None and second >= BEGINS else None
        read = [round(float(model.T1), 2), round(float(model.T2), 2)]
        if on is not None:
            read[on.place] += on.offset
        sample = tick(second, LEVELS[second // HOLD % len(LEVELS)], (read[0], read[1]))
        yield sample
        arrives = list(sample.inputs)
        if on is not None:
            arrives[on.place] *= on.share
        for part in range(1, _SLICES + 1):
            model.Q1(arrives[0])
            model.Q2(arrives[1])
            model.update(second + part / _SLICES)


def alarms_of(seed: int, mishap: Mishap | None, law: str) -> list[ChannelAlarm]:
    """What the monitor says of one kit."""
    monitor = ChannelMonitor(typical(), 1.0)
    for sample in run(seed, mishap, law):
        monitor.push(sample)
    return list(monitor.alarms)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.two_heaters", description=__doc__
    )
    parser.add_argument(
        "--healthy", type=int, default=6, help="healthy kits of each law"
    )
    parser.add_argument(
        "--mishaps", type=int, default=2, help="kits of each law with each mishap"
    )
    parser.add_argument("--seed", type=int, default=0, help="that of the first kit")
    options = parser.parse_args()
    print("law     mishap      told   delays, s        false names", flush=True)
    for law in ("pid", "linear"):
        names = []
        for seed in range(options.seed, options.seed + options.healthy):
            names += [
                f"{alarm.fault.value}@{alarm.flagged}"
                for alarm in alarms_of(seed, None, law)
            ]
        hours = options.healthy * SIZE / 3600.0
        print(
            f"{law:7s} none        {hours:.1f} h                  {' '.join(names) or 'none'}",
            flush=True,
        )
        for title, mishap in MISHAPS.items():
            delays = []
            false = []
            for seed in range(options.seed, options.seed + options.mishaps):
                for number, alarm in enumerate(alarms_of(seed, mishap, law)):
                    if number == 0 and (alarm.fault.value, alarm.signal) == (
                        mishap.fault,
                        mishap.signal,
                    ):
                        delays.append(alarm.flagged - BEGINS)
                    else:
                        false.append(f"{alarm.fault.value}@{alarm.flagged}")
            told = f"{len(delays)} of {options.mishaps}"
            print(
                f"{law:7s} {title:10s}  {told:6s} {' '.join(map(str, delays)):16s} {' '.join(false)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
