"""`twinmatch try-controller`: may a controller be run? Answered from recorded sessions, before it runs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    open_shown,
    write_json,
)
from twinmatch.controllers import (
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    LawComparison,
    TriedTwin,
    try_controller,
    widened,
)
from twinmatch.dynamics import Law
from twinmatch.memory import Memory, MemoryFaultError, digest_of
from twinmatch.offline.controllers import (
    Ground,
    ground_of,
    members_from,
    planned_profile,
    read_law,
    recorded_profile,
    remembered,
    resting_point,
    stepped_profile,
    usual_profile,
)
from twinmatch.offline.outlooks import RECORDED, planned_rows
from twinmatch.offline.processes import held_interrupts
from twinmatch.offline.track_record import LawThatRan
from twinmatch.sessions import Session
from twinmatch.showing.controllers import (
    answer_document,
    answer_words,
    comparison_document,
    comparison_words,
)
from twinmatch.signals import FloatArray

EXITS: Final = {
    ControllerDecision.SAFE: 0,
    ControllerDecision.FAILS: 1,
    ControllerDecision.UNDECIDED: 3,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Judges the sessions, and tries the law on every twin at their end and on draws of what the "
        "recordings leave open. Exit code: 0 safe, 1 fails, 3 undecided. Nothing is commanded. Without a "
        "profile, every set-point steps up and down around the level of the session's end."
    )
    add_options(parser, "sessions")
    law = "the law to try: a document (.json), or Python (.py), which is executed, with the law as `loop`"
    parser.add_argument("--loop", type=Path, required=True, metavar="FILE", help=law)
    profile = parser.add_mutually_exclusive_group()
    over = "set-points to try it over: a .csv of seconds and a level for each output"
    profile.add_argument("--over", type=Path, metavar="PROFILE", help=over)
    steps: dict[str, Any] = {
        "action": "extend",
        "nargs": "+",
        "metavar": "NAME=LEVEL@S",
    }
    profile.add_argument(
        "--set", **steps, help="steps of set-points: output, level, and time in seconds"
    )
    profile.add_argument(
        "--reference", choices=[RECORDED], help="the set-points of the last session"
    )
    came = "predict this session, in which the law ran, and compare; with a memory, keep the comparison there"
    profile.add_argument("--came", type=Path, metavar="SESSION2", help=came)
    begin = "begin in the state of the session's end (default), or at rest"
    parser.add_argument("--begin", choices=["end", "rest"], default="end", help=begin)
    draws = "draws of the parameters over all twins (default: 200)"
    parser.add_argument("--draws", type=int, default=200, metavar="N", help=draws)
    add_options(
        parser,
        "--json",
        help="write the answer with all figures and bands to this file",
    )
    add_options(
        parser,
        "--figure",
        help="draw what happens, beside the law that ran (.png, .svg or .pdf)",
    )
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Try the law and print the answer; returns the exit code.

    Raises:
        TwinmatchError: a session, the law or the profile cannot be used.
    """
    check_writable(options.json, options.figure)
    with held_interrupts():
        opened = [_opened(path, options) for path in options.sessions]
        ground = _last(opened)
        law = read_law(options.loop, ground.plant, ground.session.period)
        ran = None if options.came is None else _ran(opened, law, options)
        answer = _answer(opened, ground, law, ran, options)
    comparison = None if ran is None else ran.comparison(answer, opened, options.rig)
    if comparison is None and options.memory is not None:
        answer = widened(
            answer,
            Memory(options.memory).comparisons(ground.plant.name, options.rig or None),
        )
    decision, *details = answer_words(answer)
    print(f"{options.loop.name}: {decision}")
    record = {}
    if comparison is not None:
        kept = _kept(ran, comparison, options)
        details = [comparison_words(comparison), *kept, *details]
        record = {"comparison": comparison_document(comparison)}
    for line in details:
        print(f"  {line}")
    write_json(options.json, lambda: answer_document(answer) | record)
    if options.figure is not None:
        from twinmatch.showing.figures.controllers import draw_answer  # noqa: PLC0415
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415

        save(draw_answer(answer), options.figure)
    return EXITS[answer.decision]


def _answer(
    opened: Sequence[Ground],
    ground: Ground,
    law: Law,
    ran: LawThatRan | None,
    options: argparse.Namespace,
) -> ControllerAnswer:
    """What the twins of all sessions, and of the memory, say of a law: over the profile that was given or, if it ran,
    over the course of that session."""
    if ran is None:
        question = _asked(options, ground, law)
        apart = None
    else:
        question = ran.question(ground.holding, options.draws)
        apart = ran.ground.session
    from_memory = _twins_from_memory(ground, apart, options)
    # A judgement that started from the memory has its twins, too.
    remembered_parameters = [twin.parameters for twin in from_memory]
    new = [
        twin
        for twin in _members(opened)
        if twin.parameters not in remembered_parameters
    ]
    members = [*new, *from_memory]
    begun = _begun(members, options) if ran is None else ran.begun(members)
    with Progress("trying") as progress:
        answer = try_controller(begun, question, progress.advance)
    notes = _missing(opened) + answer.notes + ground.unvisited(question.references)
    return replace(answer, notes=notes)


def _twins_from_memory(
    ground: Ground, apart: Session | None, options: argparse.Namespace
) -> tuple[TriedTwin, ...]:
    """The twins that a memory gives, not those learned from the session `apart`; without a memory, or with
    one that cannot be read, there are none."""
    if options.memory is None:
        return ()
    try:
        twins = remembered(ground, options.memory, options.rig or None, apart=apart)
        Memory(options.memory).comparisons(ground.plant.name, options.rig or None)
    except MemoryFaultError as error:
        print(f"twinmatch: {error}; the law is tried without a memory", file=sys.stderr)
        options.memory = None
        return ()
    return twins


def _missing(opened: Sequence[Ground]) -> tuple[str, ...]:
    """What the sessions lack, each with the name of its session."""
    notes = []
    for ground in opened:
        for lack in ground.session.missing:
            notes.append(f"{ground.session.name}: {lack}")
    return tuple(notes)


def _opened(path: Path, options: argparse.Namespace) -> Ground:
    return ground_of(
        open_shown(path, options.plant), options.config, options.candidates
    )


def _asked(options: argparse.Namespace, ground: Ground, law: Law) -> ControllerQuestion:
    """The law over the profile that was given."""
    level = ground.level if ground.session.has_reference else _around(options, ground)
    references = _profile(options, ground, level)
    before = references[0] if options.begin == "rest" else level
    return ControllerQuestion(law, references, before, ground.holding, options.draws)


def _ran(opened: Sequence[Ground], law: Law, options: argparse.Namespace) -> LawThatRan:
    """The session in which the law ran; not one of those that it is predicted from."""
    came = _opened(options.came, options)
    digests = [digest_of(ground.session.samples) for ground in opened]
    _last([*opened, came])
    if digest_of(came.session.samples) in digests:
        raise ControllerError(
            f"--came {options.came}: is a session that it is predicted from; give another"
        )
    if options.begin == "rest":
        raise ControllerError(
            "--begin rest: with --came the course begins as that session did; leave it out"
        )
    return LawThatRan(came, law, options.loop.name)


def _kept(
    ran: LawThatRan | None, comparison: LawComparison, options: argparse.Namespace
) -> list[str]:
    """Keep a comparison in the memory that was named, and say so; not that of a session with a fault."""
    if options.memory is None:
        return []
    if ran is not None and ran.faulty:
        return [
            f"not kept: {comparison.name} has a fault, for which the law is not to blame"
        ]
    new = Memory(options.memory).add_comparison(comparison)
    return [
        f"kept in {options.memory}"
        if new
        else f"kept in {options.memory} already: the first one stays"
    ]


def _around(options: argparse.Namespace, ground: Ground) -> FloatArray:
    """The level of a session without set-points: that of the law's document, or where the outputs were."""
    point = resting_point(options.loop)
    return (
        ground.level
        if point is None or point.size != len(ground.plant.outputs)
        else point
    )


def _last(opened: Sequence[Ground]) -> Ground:
    """The last session, whose law and end count; all have to be of one plant and period."""
    last = opened[-1]
    for ground in opened[:-1]:
        if (ground.plant, ground.session.period) != (last.plant, last.session.period):
            raise ControllerError(
                f"session {ground.session.name}: is of another plant or period than {last.session.name}; try "
                "them one by one"
            )
    return last


def _members(opened: Sequence[Ground]) -> list[TriedTwin]:
    """The twins of all sessions; of several, with the session's name before theirs."""
    members: list[TriedTwin] = []
    for ground in opened:
        with Progress() as progress:
            twins = members_from(ground, watch=progress.advance)
        before = f"{ground.session.name}: " if len(opened) > 1 else ""
        members += [replace(member, name=before + member.name) for member in twins]
    return members


def _begun(
    members: Sequence[TriedTwin], options: argparse.Namespace
) -> list[TriedTwin]:
    """The twins with the states in which courses begin."""
    return [
        replace(member, states=None) if options.begin == "rest" else member
        for member in members
    ]


def _profile(
    options: argparse.Namespace, ground: Ground, level: FloatArray
) -> FloatArray:
    plant = ground.plant
    period = ground.session.period
    samples = ground.holding.samples
    if options.reference == RECORDED:
        return recorded_profile(ground.session)
    if options.over is not None:
        rows = [line.split(",") for line in planned_rows(options.over) if line.strip()]
        return planned_profile(plant, level, rows, period, samples)
    if options.set:
        return stepped_profile(plant, level, options.set, period, samples)
    return usual_profile(plant, level, samples)
