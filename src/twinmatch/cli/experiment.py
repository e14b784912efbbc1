"""`twinmatch experiment`: what to record next, from what a session leaves open."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from twinmatch.adding.data import data_for
from twinmatch.cli.shared import (
    TERMS,
    Progress,
    add_options,
    check_writable,
    column_map,
    node_words,
    open_shown,
    positive,
    positive_period,
    write_json,
)
from twinmatch.controllers import (
    GOALS,
    ControllerAnswer,
    ControllerError,
    ControllerQuestion,
    ExperimentTerms,
    NextExperiment,
    TriedTwin,
    goal_named,
    next_experiment,
    pid_document,
    try_controller,
)
from twinmatch.controllers.next_experiment import LEAST
from twinmatch.importing.tables import TEXTS
from twinmatch.nodes import require_ros
from twinmatch.offline.controllers import (
    Ground,
    NotTrustedError,
    experiment_terms,
    ground_of,
    members_from,
    moved_together,
    read_law,
    usual_profile,
)
from twinmatch.offline.first_steps import (
    ProposedPid,
    course_from_file,
    first_steps,
    pid_or_reason,
)
from twinmatch.offline.processes import held_interrupts
from twinmatch.plants import find_plant
from twinmatch.sessions import Session
from twinmatch.showing.controllers import experiment_document, experiment_words
from twinmatch.showing.first_steps import (
    course_document,
    course_words,
    first_steps_document,
    first_steps_words,
    pid_words,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Judges the session, and finds the shortest course of set-points (of inputs, where the loop is not "
        "known) within the safe range after which most is known. While no twin is trusted, it says why, "
        "which course to record next, and which PID to begin with. Nothing is commanded. Exit code: 0 a "
        "course, 3 none that tells more than is known."
    )
    session = (
        "the recorded session, or a table (.csv) with --plant; leave it out with --live, or if nothing is "
        "recorded yet: then --plant alone gives the first course"
    )
    parser.add_argument(
        "session", type=Path, nargs="?", metavar="SESSION", help=session
    )
    live = (
        "ask the twin that runs beside the plant, which proposes a course from now on"
    )
    parser.add_argument("--live", action="store_true", help=live)
    go = "with --live: the controller follows it, replanned at every verdict, until it is decided or Ctrl-C"
    parser.add_argument("--go", action="store_true", help=go)
    resume = "let the controller's profile continue, which waits since an experiment on the running plant"
    parser.add_argument("--resume", action="store_true", help=resume)
    minutes = "longest course (default: 10 on a plant with a time constant of 100 s, on others in proportion)"
    parser.add_argument(
        "--minutes",
        type=positive(float, "a number of minutes"),
        metavar="MIN",
        help=minutes,
    )
    within = "range that every output keeps, bands included (default: the plant file's safe range)"
    parser.add_argument(
        "--within", type=float, nargs=2, metavar=("LOW", "HIGH"), help=within
    )
    goal = "what is to be known (default: the structure, or the parameters where all twins have one structure)"
    parser.add_argument("--for", dest="goal", choices=tuple(GOALS), help=goal)
    law = "with --for controller: the law in question, as try-controller takes it"
    parser.add_argument("--loop", type=Path, metavar="FILE", help=law)
    pid = "write a first PID that is safe for all that is possible to this file, as apply takes it"
    parser.add_argument("--pid", type=Path, metavar="FILE", help=pid)
    add_options(parser, "--map", help="columns of a table, as for twinmatch import")
    add_options(parser, "--map-file")
    add_options(
        parser,
        "--period",
        help="sampling period, if the table has no times or finer ones",
    )
    add_options(
        parser, "--json", help="write the course, and what it brings, to this file"
    )
    add_options(
        parser,
        "--figure",
        help="draw the course with the bands of all twins (.png, .svg or .pdf)",
    )
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
    check_writable(options.json, options.figure, options.pid)
    if options.session is None:
        return _from_plant_file(options)
    if (options.goal == "controller") != (options.loop is not None):
        raise ControllerError(
            "experiment: --for controller and --loop FILE belong together"
        )
    with held_interrupts():
        ground = ground_of(_opened(options), options.config, options.candidates)
        for part in ground.left_out:
            print(f"Note: {part.sentence}")
        terms = experiment_terms(ground, options.minutes, options.within)
        try:
            with Progress() as progress:
                twins = members_from(ground, watch=progress.advance)
        except NotTrustedError as error:
            return _before_trust(ground, error.reason, options)
        if options.pid is not None:
            return _first_pid(ground, twins, options)
        experiment = _best_experiment(ground, twins, terms, options)
    _show_experiment(experiment, ground, options)
    return 0 if experiment.course.bits >= LEAST else 3


def _best_experiment(
    ground: Ground,
    twins: tuple[TriedTwin, ...],
    terms: ExperimentTerms,
    options: argparse.Namespace,
) -> NextExperiment:
    """The course after which most is known of what is asked.

    Raises:
        ControllerError: there is none, or nothing to decide.
    """
    answer = None if options.loop is None else _tried(options.loop, ground, twins)
    goal = goal_named(options.goal, twins, terms, answer)
    try:
        with Progress("searching") as progress:
            return next_experiment(twins, goal, terms, progress.advance)
    except ControllerError as error:
        together = moved_together(ground)
        if together is None:
            raise
        raise ControllerError(f"experiment: {together.sentence}") from error


def _show_experiment(
    experiment: NextExperiment, ground: Ground, options: argparse.Namespace
) -> None:
    """Print the course; write and draw it where that was asked for."""
    for line in experiment_words(experiment):
        print(line)
    left_out = [part.sentence for part in ground.left_out]
    notes = {"notes": [*ground.session.missing, *left_out]}
    write_json(options.json, lambda: experiment_document(experiment) | notes)
    if options.figure is not None:
        from twinmatch.showing.figures.controllers import draw_experiment  # noqa: PLC0415
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415

        save(draw_experiment(experiment), options.figure)


def _opened(options: argparse.Namespace) -> Session:
    """The session, or the table with the plant's names or a map."""
    path: Path = options.session
    if options.plant is None or path.suffix.lower() not in TEXTS:
        return open_shown(path, options.plant)
    plant = find_plant(options.plant)
    with Progress("reading") as progress:
        return data_for(
            path, plant, column_map(options), options.period, progress.advance
        )


def _from_plant_file(options: argparse.Namespace) -> int:
    """The first course of a plant of which nothing is recorded; returns the exit code."""
    if options.plant is None:
        options.parser.error(
            "give a SESSION, --plant FILE if nothing is recorded yet, or --live to ask the twin that runs"
        )
    plant = find_plant(options.plant)
    course, period = course_from_file(
        plant, positive_period(options, "experiment"), options.within
    )
    print(
        f"{plant.title}: nothing is recorded yet; by the plant file alone, at one sample every {period:g} s:"
    )
    for line in course_words(course):
        print(f"  {line}")
    print(f"then: twinmatch experiment LOG.csv --plant {shlex.quote(options.plant)}")
    write_json(options.json, lambda: course_document(course))
    return 0


def _before_trust(ground: Ground, reason: str, options: argparse.Namespace) -> int:
    """What to do while the twin is not trusted; returns the exit code."""
    steps = first_steps(ground, reason, options.within)
    for line in first_steps_words(steps):
        print(line)
    if steps.pid is not None:
        _write_pid(steps.pid, options)
    write_json(options.json, lambda: first_steps_document(steps))
    return 0


def _first_pid(
    ground: Ground, twins: tuple[TriedTwin, ...], options: argparse.Namespace
) -> int:
    """A first PID from twins that are trusted; returns the exit code."""
    proposed, why_not = pid_or_reason(ground, twins)
    print(f"{ground.session.name}: its twin is trusted")
    for line in pid_words(proposed, why_not):
        print(line)
    gains = None if proposed is None else pid_document(proposed.pid.gains)
    write_json(options.json, lambda: {"trusted": True, "pid": gains})
    if proposed is None:
        return 3
    _write_pid(proposed, options)
    return 0


def _write_pid(proposed: ProposedPid, options: argparse.Namespace) -> None:
    """Write the PID to the file that was named, and say how it is tried with a way back."""
    write_json(options.pid, lambda: pid_document(proposed.pid.gains))
    low, _, high = proposed.answer.courses.outputs
    output = proposed.answer.plant.output
    name = (
        options.pid.name
        if options.pid is not None
        else "FILE (written with --pid FILE)"
    )
    print(
        f"  on a rig of this package: twinmatch apply {name}, which gives the law before back by itself"
    )
    print(
        "  on another controller: note its gains first, and go back to them if a step by a tenth of the "
        f"range takes {output.name} below {low.min():.4g} or above {high.max():.4g} {output.unit}".rstrip()
    )


def _tried(
    path: Path, ground: Ground, twins: tuple[TriedTwin, ...]
) -> ControllerAnswer:
    law = read_law(path, ground.plant, ground.session.period)
    references = usual_profile(ground.plant, ground.level, ground.holding.samples)
    with Progress("trying") as progress:
        question = ControllerQuestion(law, references, ground.level, ground.holding)
        return try_controller(twins, question, progress.advance)


def _resume(options: argparse.Namespace) -> int:
    if options.live or options.go or options.session is not None:
        options.parser.error("give --resume alone")
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.asking import ProfileAsking  # noqa: PLC0415

    return run_nodes([ProfileAsking], node_words("experiment", {}))


def _ask(options: argparse.Namespace) -> int:
    offline = (
        options.session,
        options.loop,
        options.json,
        options.figure,
        options.config,
        options.candidates,
        options.pid,
    )
    if any(option is not None for option in offline) or options.goal == "controller":
        options.parser.error(
            "--live takes --go, --minutes, --within and --for structure, parameters or fault"
        )
    within = "" if options.within is None else " ".join(map(str, options.within))
    asked = {
        "goal": options.goal,
        "minutes": options.minutes,
        "within": within or None,
        "run": options.go,
    }
    require_ros("experiment", "without --live it works on a recorded SESSION")
    from twinmatch.nodes.runner import run as run_nodes  # noqa: PLC0415
    from twinmatch.showing.asking import ExperimentAsking  # noqa: PLC0415

    return run_nodes([ExperimentAsking], node_words("experiment", asked))
