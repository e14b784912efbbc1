"""What the monitor of several signals says of simulated kits with two heaters.

    python -m benchmarks.bank 6 --seed 3
    python -m benchmarks.bank 2 --only "T1 +5 °C" --verbose

The number is that of kits for each mishap. Right is the first name during the mishap, with its channel;
delays in seconds.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from benchmarks.bank.kits import BEGINS, ENDS, MISHAPS, SIZE, run, typical
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import Fault


def watched(seed: int, mishap: str) -> tuple[list[ChannelAlarm], float]:
    """The alarms of a run, and what a sample costs, µs."""
    monitor = ChannelMonitor(typical(), 1.0)
    samples = list(run(seed, mishap))
    began = time.process_time()
    for sample in samples:
        monitor.push(sample)
    return list(monitor.alarms), 1e6 * (time.process_time() - began) / SIZE


def row(mishap: str, runs: list[list[ChannelAlarm]]) -> str:
    """What was said of all runs with a mishap."""
    name, signal = MISHAPS[mishap]
    delays = list[int]()
    wrong = 0
    none = 0
    early = 0
    for alarms in runs:
        named = [a for a in alarms if a.fault is not Fault.DRIFT]
        early += sum(a.flagged < BEGINS or name is None for a in named)
        first = next((a for a in named if BEGINS <= a.flagged < ENDS), None)
        if first is None:
            none += 1
        elif (first.fault.value, first.signal) == (name, signal):
            delays.append(first.flagged - BEGINS)
        else:
            wrong += 1
    times = f"{np.median(delays):6.0f} {max(delays):5d}" if delays else "     –     –"
    return f"{mishap:13s} {len(delays):5d} {wrong:5d} {none:4d} | {times} | {early:5d}"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.bank", description=__doc__
    )
    parser.add_argument("kits", type=int)
    parser.add_argument("--seed", type=int, default=0, help="that of the first kit")
    parser.add_argument(
        "--only", choices=MISHAPS, action="append", help="mishaps; default: all"
    )
    parser.add_argument("--verbose", action="store_true", help="a line for each alarm")
    options = parser.parse_args()
    costs = []
    print("mishap        right wrong none | median worst | false", flush=True)
    for mishap in options.only or MISHAPS:
        runs = []
        for seed in range(options.seed, options.seed + options.kits):
            alarms, cost = watched(seed, mishap)
            runs.append(alarms)
            costs.append(cost)
            for a in alarms if options.verbose else ():
                near = ", ".join(
                    f"{f.cause[0].value} {f.cause[1]} {f.evidence:.1f}"
                    for f in a.suspects[:4]
                )
                print(
                    f"  {seed} {a.flagged} {a.fault.value} {a.signal} since {a.first}, over {a.last}: {near}"
                )
            print(f"{mishap} {seed}: {len(alarms)} alarms", file=sys.stderr)
        print(row(mishap, runs), flush=True)
    print(f"a sample costs {np.median(costs):.0f} µs")


if __name__ == "__main__":
    main()
