"""A recorded session through the ROS graph: player, twin simulator, matcher, discriminator."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rich.console import Console

from twinmatch.comparing import Verdict
from twinmatch.launching.processes import LaunchError, Processes
from twinmatch.launching.settled import Settled
from twinmatch.nodes.messages import match_from, verdict_from
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.runner import run
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.offline.summary import SessionSummary, summarise
from twinmatch.parameters.loop import UNKNOWN
from twinmatch.parameters.twin import at_period, read_settings
from twinmatch.plants import written_name
from twinmatch.sessions import Session, samples_of, write_session
from twinmatch.showing.lines import Lines
from twinmatch.showing.summary import closing_lines
from twinmatch.showing.terminal import Screen, view_on
from twinmatch.twin import MatchReport, TwinSettings
from twinmatch_msgs.msg import Match, ModelScore

__all__ = ["Replay", "play"]

EXIT_INTERRUPTED = 130
READERS = "twin_simulator discriminator keeper"
"""Nodes that must receive every sample."""
RESTARTS = 3
"""Most restarts of a killed twin; it catches up on what it missed."""
POLL = 0.2
"""Interval at which the children are checked, s."""
STALLED = 120.0
"""Longest wait for the next verdict after the last sample was played, s."""


@dataclass
class Replay:
    """What to play, and the results."""

    session: Session
    rate: float = 50.0
    """Recorded seconds per second; 0: as fast as possible."""
    candidates: Path | None = None
    config: Path | None = None
    console: Console = field(default_factory=lambda: Console(soft_wrap=True, highlight=False))
    verdicts: list[Verdict] = field(default_factory=list)
    matches: list[MatchReport] = field(default_factory=list)
    summary: SessionSummary | None = None
    whole: bool = False
    """Whether all verdicts were received."""


def play(replay: Replay) -> int:
    """Run the graph until the last verdict or Ctrl-C; returns the exit code.

    Raises:
        TwinmatchError: the session or one of the files cannot be used.
    """
    session = replay.session
    held = read_settings(replay.config, session.plant, driven=not session.has_reference)
    settings = at_period(held, session.period, replay.config)
    with tempfile.TemporaryDirectory(prefix="twinmatch-") as folder:
        playable = _playable(session, Path(folder))
        view = view_on(replay.console, session.name, settings.period, len(session.samples))
        try:
            code = run([_watch_class(replay, session, settings, playable, view)], ["replay"])
        finally:
            view.close()
    if code == 0 and not replay.whole:
        view.say(f"interrupted after {len(replay.verdicts)} verdicts")
        return EXIT_INTERRUPTED
    if code == 0:
        replay.summary = summarise(
            session.samples, replay.verdicts, settings.gains, session.notes, settings.period
        )
        for line in closing_lines(replay.summary, replay.verdicts[-1] if replay.verdicts else None):
            view.say(line)
    return code


def _playable(session: Session, folder: Path) -> Path:
    """The session's own folder, or a session written from the recording."""
    if session.path.is_dir() or session.path.suffix == ".mcap":
        return session.path
    return write_session(folder / session.name, samples_of(session.window()))


def _watch_class(
    replay: Replay,
    session: Session,
    settings: TwinSettings,
    playable: Path,
    view: Screen | Lines,
) -> type[TwinmatchNode]:
    """The node of this process, bound to one replay."""

    class Watch(TwinmatchNode):
        """Starts the other processes, prints the verdicts, ends after the last one."""

        NAME: ClassVar = "replay_watch"
        CLOSING: ClassVar = 30

        def open(self) -> None:
            """Subscribe, then start the twin and the player."""
            self._processes = Processes(view.say)
            self._changed = time.monotonic()
            self._settled = Settled()
            self.create_subscription(ModelScore, "twin/model_score", self._on_score, EVERYTHING)
            self.create_subscription(Match, "twin/match", self._on_match, EVERYTHING)
            self.create_subscription(DiagnosticArray, "/diagnostics", self._settled.take, 100)
            self.create_timer(POLL, self._look)
            view.say(f"{session.name}: {len(session.samples)} samples at {replay.rate:g} times their speed")
            view.open()
            self._restarts = 0
            self._playing = False
            self._start_twin()

        def _start_twin(self) -> None:
            options = ["--ros-args", "-p", f"period:={settings.period}"]
            options += ["-p", f"plant:={written_name(settings.plant)}"]
            if settings.gains is None:
                options += ["-p", f"loop:={UNKNOWN}"]
            if replay.config is not None:
                options += ["--params-file", str(replay.config)]
            if replay.candidates is not None:
                options += ["-p", f"discriminator:candidates:={replay.candidates}"]
            self._processes.start_module("twin", "twinmatch.nodes.twin", *options)

        def _play(self) -> None:
            """Start the player, once this node is connected to the twin's verdicts."""
            self._playing = True
            self._processes.start_module(
                "player",
                "twinmatch.nodes.player",
                *("--ros-args", "-p", f"session:={playable}", "-p", f"rate:={float(replay.rate)}"),
                *("-p", f"readers:={READERS}", "-p", "wait_timeout:=60.0"),
            )

        def close(self) -> bool:
            """End the other processes."""
            view.close()
            killed = self._processes.stop(("player", "twin"))
            for name in killed:
                view.say(f"{name} did not end in time and was killed")
            return True

        def _on_score(self, message: ModelScore) -> None:
            verdict = verdict_from(message)
            replay.verdicts.append(verdict)
            self._changed = time.monotonic()
            view.take_verdict(verdict)

        def _on_match(self, message: Match) -> None:
            replay.matches.append(match_from(message))
            view.take_match(replay.matches[-1])

        def _look(self) -> None:
            if self.exit_code is not None:
                return
            if replay.verdicts:
                view.advance(replay.verdicts[-1].sample - session.samples[0].index + 1)
            if not self._playing and self.count_publishers("twin/model_score"):
                self._play()
            ended = self._processes.ended
            for name, code in ended.items():
                if name == "twin" and code < 0 and self._restarts < RESTARTS and "player" not in ended:
                    self._restarts += 1
                    view.say(f"twin ended with code {code}; restarting it", "yellow")
                    self._start_twin()
                elif name == "twin" or code != 0:
                    msg = f"replay: {name} ended with code {code}; see its output above"
                    raise LaunchError(msg)
            if "player" not in ended:
                return
            if self._settled.complete(session.samples[-1].index, len(replay.verdicts)):
                view.advance(len(session.samples))
                replay.whole, self.exit_code = True, 0
            elif time.monotonic() - self._changed > STALLED:
                msg = (
                    f"replay: no verdict for {STALLED:g} s after {len(replay.verdicts)} verdicts, although "
                    "samples are still to be judged; look at /diagnostics"
                )
                raise LaunchError(msg)

    return Watch
