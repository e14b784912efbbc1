"""Sampler, twin and recorder in one process, for a plant that speaks no ROS."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import Empty
from typing import Any, Final

from twinmatch.comparing import Candidate
from twinmatch.dynamics.prepare import prepare
from twinmatch.ending import end_in_order
from twinmatch.launching.judging import Judged, Judging
from twinmatch.launching.results import RunResults
from twinmatch.launching.shown import RunShown
from twinmatch.parameters.candidates import parse_candidates
from twinmatch.parameters.sampler import SAMPLER, listener_of, source_of
from twinmatch.parameters.twin import values_of
from twinmatch.plants.records import description_of
from twinmatch.record import Tree, description_tree, tree_of
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.listener import SEARCH, Open
from twinmatch.sampling.sampler import TIMER
from twinmatch.sessions import Recording, RecordingLimits
from twinmatch.sessions.cdr import encode, encode_sample
from twinmatch.sessions.messages import SAMPLE, topic_named
from twinmatch.sessions.metadata import CANDIDATES, parameters_record
from twinmatch.sessions.recording import FLUSH
from twinmatch.showing.page.goal import Goal
from twinmatch.showing.page.health import kind_of
from twinmatch.showing.view import view_of
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

LOOK: Final = 1.0
"""Interval at which troubles are looked for, s."""


@dataclass(frozen=True)
class AlonePlan:
    """One such run."""

    values: Mapping[str, Any]
    """Parameters of the sampler."""
    settings: TwinSettings
    candidates: str = ""
    """Text of the file of candidates; empty: none are given."""
    session: Path | None = None
    """Folder to record into; None: nothing is recorded."""
    limits: RecordingLimits | None = None
    """When to split its files, and to stop; None: the usual ones."""
    page: int | None = None
    """Port of the page; None: there is none."""
    tell: str | None = None
    """Broker that gets what the page shows; None: none."""
    goal: Goal | None = None
    """Level of which page and broker show when it is reached; None: none."""


class TwinSession(Recording):
    """The session of such a run: samples, matches, verdicts, and the parameters they were made with."""

    def __init__(self, folder: Path, plan: AlonePlan) -> None:
        """Create the folder; the records are those of the nodes whose part is taken.

        Raises:
            SessionError: it cannot be made.
        """
        super().__init__(folder, plan.limits)
        self._plant = plan.settings.plant.name
        plant = description_of(plan.settings.plant)
        twin = {
            **values_of(plan.settings),
            "candidates": "given" if plan.candidates else "",
        }
        for name, values in (
            (SAMPLER, plan.values),
            ("matcher", twin),
            ("discriminator", twin),
        ):
            texts = {key: json.dumps(value) for key, value in values.items()}
            self.add_record(parameters_record(f"/{name}"), texts)
        if plan.candidates:
            self.add_record(CANDIDATES, {"text": plan.candidates})
        self.add_topic(SAMPLE)
        self.record("/plant/description", description_tree(plant, plan.settings.period))

    def sample(self, sample: Sample) -> None:
        """Write a sample."""
        self.write(SAMPLE.name, encode_sample(sample, self._plant), time.time_ns())

    def take(self, judged: Judged) -> None:
        """Write what the twin made of a sample."""
        if (match := judged.outcome.match) is not None:
            self.record("/twin/match", tree_of(match), judged.stamps[match.sample])
        for verdict in judged.outcome.verdicts:
            self.record(
                "/twin/model_score", tree_of(verdict), judged.stamps[verdict.sample]
            )

    def record(self, name: str, tree: Tree, stamp: int | None = None) -> None:
        """Write a record on a topic; `stamp` is that of the sample behind it, ns."""
        topic = topic_named(name)
        self.add_topic(topic)
        self.write(name, encode(topic, tree, stamp), time.time_ns())


class Alone:
    """The run itself: its thread listens, records and shows."""

    def __init__(self, plan: AlonePlan) -> None:
        """Connect to the source, and create the session.

        Raises:
            TwinmatchError: one of the parts cannot be used.
        """
        candidates = (
            parse_candidates(plan.candidates, "candidates") if plan.candidates else []
        )
        opened = source_of(plan.values)
        if opened is None:
            raise SamplingError(
                "attach: --alone takes no topics of ROS; give --source URL, such as mqtt://HOST or "
                "modbus://HOST/UNIT, or leave --alone out"
            )
        self._settings = plan.settings
        try:
            self._open(plan, opened, candidates)
        except BaseException:
            self._close()
            raise
        self._every = {self._search: SEARCH, self._flush: FLUSH, self._look: LOOK}
        if plan.values["paced_by"] == TIMER:
            self._every[self._listener.tick] = plan.settings.period
        self._sampled = self._judged = self._missed = 0
        self._troubles: dict[str, str] = {}
        self._ended = False

    def _open(
        self, plan: AlonePlan, opened: Open, candidates: Sequence[Candidate]
    ) -> None:
        self._view = view_of("live", plan.settings.period)
        for _ in prepare(plan.settings.plant):
            # a compiler beside the samples would cost some of them
            pass
        self._listener = listener_of(SAMPLER, plan.values, time.time_ns)
        self._listener.open(opened)
        self._shown = RunShown(plan.settings, plan.page, plan.tell, plan.goal)
        self._session = (
            TwinSession(plan.session, plan) if plan.session is not None else None
        )
        self._judging = Judging(plan.settings, candidates, shown=self._shown.wanted)
        self._results = RunResults()

    def run(self) -> None:
        """Run until `end` is called.

        Raises:
            TwinmatchError: a place cannot be used, or the disk is full.
        """
        due = dict.fromkeys(self._every, time.monotonic())
        try:
            self._view.open()
            while not self._ended:
                for call, interval in self._every.items():
                    if (wall_now := time.monotonic()) >= due[call]:
                        due[call] = max(due[call] + interval, wall_now)
                        call()
                self._take_samples()
                self._take_judged()
                time.sleep(self._listener.interval)
            self._finish()
        finally:
            self._close()

    def end(self, *_: object) -> None:
        """End the run soon."""
        self._ended = True

    def _search(self) -> None:
        self._listener.search()
        if self._listener.failed is not None:
            raise self._listener.failed
        if self._judging.failure is not None:
            raise self._judging.failure

    def _flush(self) -> None:
        if self._session is not None:
            self._session.flush()

    def _look(self) -> None:
        """Show what keeps signals from giving samples, once each; and that ticks were missed."""
        listener = self._listener
        missed = self._listener.sampler.grid.missed
        for line in listener.news():
            self._view.say(line, "yellow")
        for name in listener.channels:
            is_due = self._sampled or listener.late or listener.refusals[name].now
            self._say_trouble(name, listener.trouble(name) if is_due else "")
        self._say_trouble("pace", listener.sampler.troubles.get("pace", ""))
        if missed != self._missed:
            self._view.say(
                f"the loop paused: {missed} ticks were missed in all", "yellow"
            )
            self._missed = missed
        self._shown.tell()

    def _say_trouble(self, name: str, text: str) -> None:
        """Show what is wrong with a signal or the pace, once; or that nothing is."""
        self._shown.trouble(name, text)
        kind = kind_of(text)
        if kind != self._troubles.get(name, ""):
            right = (
                "the ticks are right again"
                if name == "pace"
                else f"{name}: there are values again"
            )
            self._view.say(text or right, "red" if text else "green")
        self._troubles[name] = kind

    def _say_left_out(self) -> None:
        """Say how much was left out in all."""
        for name, refusals in self._listener.refusals.items():
            if refusals.count:
                self._view.say(
                    f"{name}: {refusals.count} values could not be read and are left out",
                    "yellow",
                )
        if repeated := self._listener.sampler.repeated:
            self._view.say(
                f"{repeated} messages were sent twice or more often at once, and count once"
            )

    def _take_samples(self) -> None:
        for sample in self._listener.samples():
            self._sampled += 1
            if self._session is not None:
                self._session.sample(sample)
            self._judging.push(sample)
            self._shown.sample(sample)

    def _take_judged(self) -> None:
        while True:
            try:
                judged = self._judging.judged.get_nowait()
            except Empty:
                return
            self._judged += 1
            if self._session is not None:
                self._session.take(judged)
            self._results.take_settled(judged.outcome.settled)
            if judged.outcome.match is not None:
                self._view.take_match(judged.outcome.match)
            for verdict in judged.outcome.verdicts:
                self._results.take_verdict(verdict)
                self._view.take_verdict(verdict)
            self._view.advance(self._judged)
            self._shown.take(judged, self._judging.snapshot)

    def _finish(self) -> None:
        """Wait for what is being judged, and summarise."""
        until = time.monotonic() + Judging.LEAVE
        while (
            self._judged < self._sampled
            and time.monotonic() < until
            and self._judging.failure is None
        ):
            self._take_judged()
            time.sleep(self._listener.interval)
        self._view.close()
        self._view.say(
            f"ended: {self._sampled} samples, {self._results.tally.verdicts} verdicts"
        )
        self._say_left_out()
        summary = self._results.summary(self._settings)
        if summary is not None:
            for line in self._results.closing_lines(summary):
                self._view.say(line)

    def _close(self) -> None:
        parts = (getattr(self, name, None) for name in _ORDER)
        end_in_order(*(part.close for part in parts if part is not None))


_ORDER: Final = ("_view", "_listener", "_judging", "_session", "_shown", "_results")
"""The parts in the order in which they end: what brings samples, what judges and keeps them, what shows them.
One that could not be made is missing."""


def run_alone(plan: AlonePlan) -> None:
    """Run until Ctrl-C or SIGTERM; either of them interrupts the start.

    Raises:
        KeyboardInterrupt: a signal came before the run had begun.
        TwinmatchError: a file, an option or the source cannot be used, or the disk is full.
    """
    before = {
        number: signal.signal(number, _interrupt)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        run = Alone(plan)
        for number in before:
            signal.signal(number, run.end)
        run.run()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
