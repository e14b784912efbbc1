"""`twinmatch retune`: better gains for the PID of a recorded session, with a margin on every twin."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    open_shown,
    write_json,
)
from twinmatch.cli.try_controller import EXITS
from twinmatch.controllers import (
    AIMS,
    ControllerError,
    ControllerQuestion,
    pid_document,
    retune,
    try_controller,
)
from twinmatch.dynamics import PidGains
from twinmatch.offline.controllers import ground_of, members_from, usual_profile
from twinmatch.offline.processes import held_interrupts
from twinmatch.showing.controllers import answer_words, retuned_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Finds the gains of a session's PID that are best in the mean over all twins at its end, with the "
        "maximum sensitivity M_s of every twin below a ceiling, and tries them. Nothing is commanded. Exit "
        "code: 0 better and safe, or nothing to gain; 1 fails; 3 undecided."
    )
    add_options(parser, "session", metavar="SESSION")
    aim = "what to make small: the error after a load (default) or a set-point step, or the travel by noise"
    parser.add_argument("--for", dest="aim", choices=AIMS, default="load", help=aim)
    ceiling = "ceiling of M_s (default: 1.6)"
    parser.add_argument(
        "--max-sensitivity", type=float, default=1.6, metavar="MS", help=ceiling
    )
    most = "largest factor by which a gain may change (default: 2)"
    parser.add_argument(
        "--most-change", type=float, default=2.0, metavar="N", help=most
    )
    add_options(
        parser,
        "--json",
        help="write the gains to this file, as a law that try-controller reads",
    )
    add_options(
        parser, "--figure", help="draw old and new side by side (.png, .svg or .pdf)"
    )
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Find gains, try them and print both; returns the exit code.

    Raises:
        TwinmatchError: the session or an option cannot be used, or its controller is not a PID.
    """
    check_writable(options.json, options.figure)
    with held_interrupts():
        ground = ground_of(
            open_shown(options.session, options.plant),
            options.config,
            options.candidates,
        )
        gains = ground.holding.law
        if not isinstance(gains, PidGains):
            raise ControllerError(
                f"retune: {ground.session.name}: its controller is not a known PID"
            )
        with Progress() as progress:
            twins = members_from(ground, watch=progress.advance)
        retuned = retune(
            twins,
            gains,
            float(ground.level[0]),
            ground.holding,
            aim=options.aim,
            max_sensitivity=options.max_sensitivity,
            most_change=options.most_change,
        )
        references = usual_profile(ground.plant, ground.level, ground.holding.samples)
        question = ControllerQuestion(
            retuned.after, references, ground.level, ground.holding
        )
        with Progress("trying") as progress:
            answer = try_controller(twins, question, progress.advance)
    for line in (
        *retuned_words(retuned, answer),
        *(f"  {line}" for line in answer_words(answer)),
    ):
        print(line)
    write_json(options.json, lambda: pid_document(retuned.after))
    if options.figure is not None:
        from twinmatch.showing.figures.controllers import draw_answer  # noqa: PLC0415
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415

        save(draw_answer(answer), options.figure)
    return EXITS[answer.decision]
