"""`twinmatch experiment`: what to record next, from what a session leaves open."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    node_words,
    open_shown,
    positive,
    write_json,
)
from twinmatch.controllers import (
    GOALS,
    ControllerAnswer,
    ControllerError,
    ControllerQuestion,
    TriedTwin,
    goal_named,
    next_experiment,
    try_controller,
)
from twinmatch.controllers.next_experiment import LEAST
from twinmatch.nodes import require_ros
from twinmatch.offline.controllers import (
    Ground,
    experiment_terms,
    ground_of,
    members_from,
    read_law,
    usual_profile,
)
from twinmatch.offline.processes import held_interrupts
from twinmatch.showing.controllers import experiment_document, experiment_words


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Judges the session, and finds the shortest course of set-points (of inputs, where the loop is not "
        "known) within the safe range after which most is known. Nothing is commanded. Exit code: 0 a "
        "course, 3 none that tells more than is known."
    )
    session = "the recorded session; leave it out with --live"
    parser.add_argument("session", type=Path, nargs="?", metavar="SESSION", help=session)
    live = "ask the twin that runs beside the plant, which proposes a course from now on"
    parser.add_argument("--live", action="store_true", help=live)
    go = "with --live: the controller follows it, replanned at every verdict, until it is decided or Ctrl-C"
    parser.add_argument("--go", action="store_true", help=go)
    resume = "let the controller's profile continue, which waits since an experiment on the running plant"
    parser.add_argument("--resume", action="store_true", help=resume)
    minutes = "longest course (default: 10 on a plant with a time constant of 100 s, on others in proportion)"
    parser.add_argument("--minutes", type=positive(float, "a number of minutes"), metavar="MIN", help=minutes)
    within = "range that every output keeps, bands included (default: the plant file's safe range)"
    parser.add_argument("--within", type=float, nargs=2, metavar=("LOW", "HIGH"), help=within)
    goal = (
        "what is to be known (default: the structure, or the parameters where all twins have one structure)"
    )
    parser.add_argument("--for", dest="goal", choices=tuple(GOALS), help=goal)
    law = "with --for controller: the law in question, as try-controller takes it"
    parser.add_argument("--loop", type=Path, metavar="FILE", help=law)
    add_options(parser, "--json", help="write the course, and what it brings, to this file")
    add_options(parser, "--figure", help="draw the course with the bands of all twins (.png, .svg or .pdf)")
    add_options(parser, *TERMS)


def run(options: argparse.Namespace) -> int:
    """Find the course and print it; returns the exit code.

    Raises:
        TwinmatchError: the session or an option cannot be used, or there is nothing to decide.
    """
    if options.resume:
        return _resume(options)
    if options.live or options.go:
        return _ask(options)
    if options.session is None:
        options.parser.error("give a SESSION, or --live to ask the twin that runs")
    check_writable(options.json, options.figure)
    if (options.goal == "controller") != (options.loop is not None):
        raise ControllerError("experiment: --for controller and --loop FILE belong together")
    with held_interrupts():
        ground = ground_of(open_shown(options.session, options.plant), options.config, options.candidates)
        terms = experiment_terms(ground, options.minutes, options.within)
        with Progress() as progress:
            twins = members_from(ground, watch=progress.advance)
        answer = None if options.loop is None else _tried(options.loop, ground, twins)
        goal = goal_named(options.goal, twins, terms, answer)
        with Progress("searching") as progress:
            experiment = next_experiment(twins, goal, terms, progress.advance)
    for line in experiment_words(experiment):
        print(line)
    write_json(
        options.json, lambda: experiment_document(experiment) | {"notes": list(ground.session.missing)}
    )
    if options.figure is not None:
        from twinmatch.showing.figures.controllers import draw_experiment  # noqa: PLC0415 — matplotlib is slow
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415

        save(draw_experiment(experiment), options.figure)
    return 0 if experiment.course.characters >= LEAST else 3


def _tried(path: Path, ground: Ground, twins: tuple[TriedTwin, ...]) -> ControllerAnswer:
    law = read_law(path, ground.plant, ground.session.period)
    references = usual_profile(ground.plant, ground.level, ground.holding.samples)
    with Progress("trying") as progress:
        question = ControllerQuestion(law, references, ground.level, ground.holding)
        return try_controller(twins, question, progress.advance)


def _resume(options: argparse.Namespace) -> int:
    if options.live or options.go or options.session is not None:
        options.parser.error("give --resume alone")
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.asking import ProfileAsking  # noqa: PLC0415 — needs ROS

    return run_nodes([ProfileAsking], node_words("experiment", {}))


def _ask(options: argparse.Namespace) -> int:
    offline = (
        options.session,
        options.loop,
        options.json,
        options.figure,
        options.config,
        options.candidates,
    )
    if any(option is not None for option in offline) or options.goal == "controller":
        options.parser.error(
            "--live takes --go, --minutes, --within and --for structure, parameters or fault"
        )
    within = "" if options.within is None else " ".join(map(str, options.within))
    asked = {"goal": options.goal, "minutes": options.minutes, "within": within or None, "run": options.go}
    require_ros("experiment", "without --live it works on a recorded SESSION")
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.asking import ExperimentAsking  # noqa: PLC0415 — needs ROS

    return run_nodes([ExperimentAsking], node_words("experiment", asked))
