"""What courses of experiments bring on simulated rigs and kits, beside a step and a random binary sequence.

    python -m benchmarks.experiment 20 [--only structure]

Every plant is followed by its twins over usual set-points, and then asked what next. The course found, a step
and a PRBS then run on copies of it from the same moment on.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import NamedTuple

import numpy as np

from twinmatch.control import Loop, Profile
from twinmatch.controllers import (
    Contender,
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    ExperimentTerms,
    Holding,
    NextExperiment,
    TriedTwin,
    as_linear,
    bits_by,
    goal_named,
    next_experiment,
    try_controller,
)
from twinmatch.controllers.experiment_search import ExperimentSearch
from twinmatch.controllers.learning_goals import LEAD
from twinmatch.dynamics import Law, Plant, advance, begin, law_of, pids_of, readings
from twinmatch.plants import Peltier, TCLab
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin import Twin, TwinSettings
from twinmatch.twin.tried import tried_twins

LEVELS = {
    "peltier": ((30.0, 45.0, 38.0), 300.0, 0.1),
    "tclab": ((32.0, 45.0, 38.0), 700.0, 0.32),
}
"""Usual set-points, how long each is held, s, and the steps of the sensor."""
TYPICAL = {
    Peltier: "sink with mass, free ambient",
    TCLab: "sensor lag, radiation, neighbour",
}
"""The structure of plants whose parameters, laws and faults are asked about."""
LONGEST = 3
"""How many courses long a step and a PRBS may last."""
STEPS = 5
"""Steps of a fit."""
EVERY = 3
"""Samples between two looks at what the readings say."""


class Bench:
    """A simulated plant in its loop, whose parameters differ by up to a tenth from the typical ones."""

    def __init__(self, plant: type[Plant], structure: str, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        model = plant.model(structure)
        typical = model.parameters()
        scaled = {
            k: typical[k] * math.exp(self.random.uniform(-0.1, 0.1))
            for k in model.structure.free
        }
        if "ambient" in scaled:
            scaled["ambient"] = typical["ambient"] + self.random.uniform(-2.0, 2.0)
        self.truth = typical.replace(**scaled)
        self.share = 1.0
        self.plant = plant
        self.loop = Loop(plant)
        self.k = 0
        self.step_of_sensor = LEVELS[plant.name][2]
        self.states = begin(self.truth, [23.0])

    def sample(self, level: float) -> Sample:
        """The next one."""
        noise = self.plant.output.noise * self.random.standard_normal(1)
        y = (
            np.round((readings(self.truth, self.states) + noise) / self.step_of_sensor)
            * self.step_of_sensor
        )
        self.loop.measure(tuple(y.tolist()), self.k * 10**9)
        sample = self.loop.tick(self.k * 10**9, lambda _: level)
        assert sample is not None
        acting = self.truth.model.rest + self.share * (
            np.array(sample.inputs) - self.truth.model.rest
        )
        self.states = advance(self.truth, self.states, acting, 1.0)
        self.k = self.k + 1
        return sample


class Asked(NamedTuple):
    """A plant, its twins, and the course found for them."""

    bench: Bench
    members: tuple[TriedTwin, ...]
    found: NextExperiment
    cpu: float


def taught(
    plant: type[Plant], structure: str, seed: int
) -> tuple[Bench, tuple[TriedTwin, ...], ExperimentTerms]:
    """A plant after its usual set-points, its twins, and what a course may do."""
    bench = Bench(plant, structure, seed)
    twin = Twin(settings := TwinSettings.of(plant))
    levels, hold, _ = LEVELS[plant.name]
    usual = Profile(levels, (hold,) * len(levels), lowest=0.0, highest=90.0, unit="°C")
    for k in range(round(usual.duration)):
        twin.push(bench.sample(usual.reference(k)))
    members = tried_twins(twin.discriminator.forecaster.snapshot())
    holding = Holding(settings.law, 1.0, settings.schedule.span)
    return bench, members, ExperimentTerms.of(plant, holding, np.array([levels[-1]]))


def courses(asked: Asked) -> Iterator[tuple[str, FloatArray]]:
    """The course found, then the others, which are repeated: levels of every sample."""
    longest = LONGEST * len(asked.found.course.rows)
    for one in (asked.found.course, *asked.found.others[:2]):
        rows = one.rows[:, 0]
        yield (
            one.name,
            np.resize(rows, longest)
            if one.name == "PRBS"
            else np.pad(rows, (0, longest - len(rows)), "edge"),
        )


def run(asked: Asked, levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outputs and inputs of a copy of the plant over these levels."""
    bench = copy.deepcopy(asked.bench)
    samples = [bench.sample(level) for level in levels.tolist()]
    return np.array([s.outputs for s in samples]), np.array([s.inputs for s in samples])


def decided(
    asked: Asked, outputs: FloatArray, inputs: FloatArray
) -> tuple[int | None, str]:
    """Samples until one contender leads, and which it is."""
    for size in range(EVERY, len(outputs) + 1, EVERY):
        each = bits_by(asked.found, outputs[:size], inputs[:size])
        second, first = np.sort(each)[-2:]
        if (first - second) * math.log(2.0) >= LEAD:
            return size, asked.found.goal.label(int(each.argmax()))
    return None, ""


def structures(plant: type[Plant], number: int, seed: int) -> None:
    """Which structure is decided, and how soon."""
    watched = [
        name for name, structure in plant.structures.items() if structure.watched
    ]
    results: dict[str, list[tuple[int | None, bool]]] = {}
    beyond = 0.0
    cpu = []
    for k in range(number):
        true = watched[k % len(watched)]
        asked = _asked(plant, true, seed + k, "structure")
        if asked is None:
            continue
        cpu.append(asked.cpu)
        line = []
        for name, levels in courses(asked):
            outputs, inputs = run(asked, levels)
            size, which = decided(asked, outputs, inputs)
            results.setdefault(name, []).append(
                (size, size is not None and _contains(plant, which, true))
            )
            line.append(f"{name} {size} {which}")
            if name == "proposed":
                low, high = asked.found.terms.outputs
                beyond = max(
                    beyond, float(np.max(outputs - high)), float(np.max(low - outputs))
                )
        print(f"  {true}: {'; '.join(line)}", flush=True)
    for name, each in results.items():
        sizes = [math.inf if size is None else size for size, _ in each]
        right = sum(ok for _, ok in each)
        wrong = sum(size is not None and not ok for size, ok in each)
        print(
            f"{plant.name}, {name}: median {median(sizes):g} samples, right {right}, wrong {wrong}, "
            f"of {len(each)}"
        )
    print(
        f"beyond the range by {max(beyond, 0.0):.2g}; {median(cpu):.2f} s of CPU, at most {max(cpu):.2f}"
    )


def spreads(plant: type[Plant], number: int, seed: int) -> None:
    """Errors of the leader's parameters after the course, in predicted deviations."""
    true = TYPICAL[plant]
    errors: dict[str, list[float]] = {}
    for k in range(number):
        asked = _asked(plant, true, seed + k, "parameters")
        twin = asked and next(
            (m for m in asked.members if m.parameters.model.structure_name == true),
            None,
        )
        if asked is None or twin is None:
            continue
        levels = asked.found.course.rows[:, 0]
        for name, error in zip(
            twin.free, *_errors(asked, twin, *run(asked, levels)), strict=True
        ):
            errors.setdefault(name, []).append(error)
    ratios = {
        name: float(np.sqrt(np.mean(np.square(each)))) for name, each in errors.items()
    }
    count = len(next(iter(errors.values()), []))
    words = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    print(f"{plant.name}, RMS error / predicted, {count} plants: {words}")


def _errors(
    asked: Asked, twin: TriedTwin, outputs: FloatArray, inputs: FloatArray
) -> tuple[list[float]]:
    """Errors of a twin's parameters once it has been fitted to these readings within what it left open."""
    centre, known = learned(asked, twin, outputs, inputs)
    true = np.array([asked.bench.truth[name] for name in twin.free])
    return (((centre - true) / np.sqrt(np.diag(known))).tolist(),)


def learned(
    asked: Asked, twin: TriedTwin, outputs: FloatArray, inputs: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Parameters and their covariance after these readings, by steps of Gauss and Newton."""
    assert twin.covariance is not None
    search = ExperimentSearch([twin], asked.found.goal, asked.found.terms)
    [leader] = search.family
    seen = search.run(leader, outputs, inputs)
    root = leader.root
    n = len(root)
    start = np.array([twin.parameters[name] for name in twin.free])
    moved = np.zeros(seen.slopes.shape[2])
    for _ in range(STEPS):
        values = np.clip(start + root @ moved[:n], 0.2 * start, 5.0 * start)
        at = Contender(
            replace(
                twin,
                parameters=twin.parameters.replace(
                    **dict(zip(twin.free, values.tolist(), strict=True))
                ),
            )
        )
        search.starts[at] = search.starts[leader]
        seen = search.run(at, outputs, inputs)
        whole = np.eye(moved.size) + np.einsum("koi,koj->ij", seen.slopes, seen.slopes)
        miss = (outputs - seen.outputs) / seen.noise
        miss[:, :] -= seen.slopes[:, :, n:] @ moved[n:]
        pull = np.einsum("ko,koi->i", miss, seen.slopes) - moved
        moved = moved + np.linalg.solve(whole, pull)
    inside = np.linalg.inv(whole)[:n, :n]
    return start + root @ moved[:n], root @ inside @ root.T


def faults(plant: type[Plant], number: int, seed: int) -> None:
    """Plants whose drive is weak or whose losses have grown, at a level at which these leave one mark."""
    told = 0
    right = 0
    cpu = []
    for k in range(number):
        asked = _asked(plant, TYPICAL[plant], seed + k, "fault")
        if asked is None:
            continue
        cpu.append(asked.cpu)
        weak, sick = asked.found.goal.contenders
        declared = weak.twin.parameters.model.declared
        [lost] = [each for each in weak.twin.free if declared[each].role == "losses"]
        name = "weak drive" if k % 2 else "grown losses"
        if name == "weak drive":
            asked.bench.share = weak.share
        else:
            grown = sick.twin.parameters[lost] / weak.twin.parameters[lost]
            asked.bench.truth = asked.bench.truth.replace(
                **{lost: grown * asked.bench.truth[lost]}
            )
        before = float(asked.found.terms.before[0])
        for _ in range(1200):  # the loop holds its level again
            asked.bench.sample(before)
        size, which = decided(asked, *run(asked, asked.found.course.rows[:, 0]))
        told = told + (size is not None)
        right = right + (which == name)
        print(
            f"  {name}: {which} after {size} of {len(asked.found.course.rows)}",
            flush=True,
        )
    words = f"parted {told}, rightly {right}, of {len(cpu)}; {median(cpu):.2f} s of CPU"
    print(f"{plant.name}, faults said as both: {words}")


def laws(number: int, seed: int) -> None:
    """Laws whose stability hangs on what is open, before and after the course."""
    told = 0
    right = 0
    asked_of = 0
    for k in range(number):
        plant = (Peltier, TCLab)[k % 2]
        true = TYPICAL[plant]
        bench, members, terms = taught(plant, true, seed + k)
        members = tuple(
            m for m in members if m.parameters.model.structure_name == true
        )[:1]
        answer = members and _undecided(members, terms, bench)
        if not answer:
            continue
        try:
            goal = goal_named("controller", members, terms, answer[1])
            found = next_experiment(members, goal, terms)
        except ControllerError as error:
            print(f"  {plant.name}: {error}")
            continue
        asked = Asked(bench, members, found, 0.0)
        twin = members[0]
        centre, known = learned(asked, twin, *run(asked, found.course.rows[:, 0]))
        values = dict(zip(twin.free, centre.tolist(), strict=True))
        better = replace(
            twin,
            parameters=twin.parameters.replace(**values),
            covariance=known,
            states=None,
        )
        after = try_controller(
            [better], ControllerQuestion(answer[0], *_level(terms), draws=60)
        )
        truth = replace(better, parameters=bench.truth, covariance=None)
        really = try_controller(
            [truth], ControllerQuestion(answer[0], *_level(terms), draws=1)
        ).decision
        asked_of += 1
        told += after.decision is not ControllerDecision.UNDECIDED
        right += after.decision is really
        words = f"{after.decision.value}, really {really.value}; {len(found.course.rows)} samples"
        print(f"  {plant.name}: {words}", flush=True)
    print(f"controllers: decided {told}, rightly {right}, of {asked_of}")


def _level(terms: ExperimentTerms) -> tuple[FloatArray, FloatArray, Holding]:
    return np.tile(terms.before, (30, 1)), terms.before, terms.holding


def _undecided(
    members: Sequence[TriedTwin], terms: ExperimentTerms, bench: Bench
) -> tuple[Law, ControllerAnswer] | None:
    """The plant's own law with so much gain that some draws are unstable and some are not."""
    [gains] = pids_of(law_of(bench.plant, 1.0))
    low = 1.0
    high = 1000.0
    for _ in range(14):
        by = math.sqrt(low * high)
        law = as_linear(
            replace(
                gains,
                proportional=by * gains.proportional,
                integral=by * gains.integral,
            )
        )
        answer = try_controller(
            members, ControllerQuestion(law, *_level(terms), draws=40)
        )
        unstable = [one for one in answer.stability if not one.sound]
        if answer.question is not None:
            return law, answer
        low, high = (low, by) if unstable else (by, high)
    return None


def _asked(plant: type[Plant], structure: str, seed: int, goal: str) -> Asked | None:
    """A plant that has been asked; None, and why, if there is no question."""
    bench, members, terms = taught(plant, structure, seed)
    begun = time.process_time()
    try:
        found = next_experiment(members, goal_named(goal, members, terms), terms)
    except ControllerError as error:
        print(f"  {structure}: {error}")
        return None
    return Asked(bench, members, found, time.process_time() - begun)


def _contains(plant: type[Plant], name: str, true: str) -> bool:
    """Whether a structure has all that another has: it can be that one."""
    one = plant.structures[name]
    other = plant.structures[true]
    return one.parts >= other.parts and set(one.free) >= set(other.free)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each plant, then what they come to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "number", type=int, nargs="?", default=20, help="plants of each kind"
    )
    parser.add_argument(
        "--only", choices=("structure", "parameters", "controller", "fault")
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    number = options.number
    seed = options.seed
    for plant in (Peltier, TCLab):
        if options.only in {None, "structure"}:
            structures(plant, number, seed)
        if options.only in {None, "parameters"}:
            spreads(plant, number, seed)
        if options.only in {None, "fault"}:
            faults(plant, number, seed)
    if options.only in {None, "controller"}:
        laws(number, seed)


if __name__ == "__main__":
    main()
