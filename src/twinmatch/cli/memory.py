"""`twinmatch memory`: what is remembered of rigs, and what has changed on them."""

from __future__ import annotations

import argparse

from twinmatch.cli.shared import add_options, check_writable, console_for, write_json
from twinmatch.errors import TwinmatchError
from twinmatch.memory import Lesson, Memory, default_files, in_order
from twinmatch.memory.store import MOST
from twinmatch.plants import find_plant, plant_named
from twinmatch.showing.memory import RememberedRig, remembered


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser, "--memory", help="the memory (default: all in the user's data folder)"
    )
    add_options(parser, "--rig", default=None, help="show this rig only")
    add_options(
        parser,
        "--plant",
        help="your plant file, which is executed, if the memory is one of it",
    )
    add_options(parser, "--json", help="write everything to this file")
    add_options(
        parser,
        "--figure",
        help="draw the parameters over the sessions (.png, .svg or .pdf)",
    )


def run(options: argparse.Namespace) -> int:
    """Show it; returns the exit code."""
    check_writable(options.json, options.figure)
    if options.plant is not None:
        find_plant(options.plant)
    files = [options.memory] if options.memory else default_files()
    memories = [Memory(file) for file in files]
    lessons = in_order(
        lesson for memory in memories for lesson in memory.lessons(rig=options.rig)
    )
    lessons_by_rig: dict[tuple[str, str], list[Lesson]] = {}
    for lesson in lessons:
        lessons_by_rig.setdefault((lesson.plant, lesson.rig), []).append(lesson)
    rigs = []
    for (plant, rig_name), of_rig in lessons_by_rig.items():
        rigs.append(remembered(of_rig, plant_named(plant), rig_name))
    for rig in rigs:
        _print(rig)
    if not rigs:
        print("Nothing is remembered yet; add sessions with twinmatch remember SESSION")
    for memory in memories:
        if unread := memory.unread(options.rig):
            print(
                f"{memory.path}: the newest {MOST} lessons are read; {unread} older ones are not"
            )
    write_json(options.json, lambda: [rig.document() for rig in rigs])
    if options.figure is not None:
        if len(rigs) != 1:
            raise TwinmatchError(
                f"--figure: draws one rig, but there are {len(rigs)}; give --memory or --rig"
            )
        from twinmatch.showing.figures.drawing import save  # noqa: PLC0415
        from twinmatch.showing.figures.memory import draw_memory  # noqa: PLC0415

        save(draw_memory(rigs[0].report, rigs[0].plant), options.figure)
    return 0


def _print(rig: RememberedRig) -> None:
    if rig.report.lessons:
        console_for(180).print(rig.table())
    for sentence in rig.sentences:
        print(sentence)
