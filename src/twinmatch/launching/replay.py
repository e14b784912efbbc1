"""A recorded session through the ROS graph: player, twin simulator, matcher, discriminator."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from twinmatch.comparing import Verdict
from twinmatch.errors import EXIT_INTERRUPTED
from twinmatch.launching.plan import ros_arguments
from twinmatch.launching.processes import LaunchError
from twinmatch.launching.watch import Supervised, Watch
from twinmatch.offline.judging import terms_from_files
from twinmatch.offline.summary import SessionSummary, summarise
from twinmatch.parameters.twin import UNKNOWN
from twinmatch.plants import written_name
from twinmatch.sessions import Session, samples_of, write_session
from twinmatch.showing.lines import Lines
from twinmatch.showing.summary import closing_lines
from twinmatch.showing.view import view_of
from twinmatch.twin import MatchReport, TwinSettings, filled_stretches

if TYPE_CHECKING:
    from twinmatch.showing.terminal import Screen

READERS = "twin_simulator discriminator keeper"
"""Nodes that must receive every sample."""


@dataclass
class Replay:
    """What to play, and the results."""

    session: Session
    rate: float = 50.0
    """Recorded seconds per second; 0: as fast as possible."""
    candidates: Path | None = None
    config: Path | None = None
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
    settings = terms_from_files(session, replay.config).settings
    with tempfile.TemporaryDirectory(prefix="twinmatch-") as folder:
        playable = _playable(session, Path(folder))
        view = view_of(session.name, settings.period, len(session.samples))
        code = _ReplayRun(replay, settings, playable, view).run()
    if code == 0 and not replay.whole:
        view.say(f"interrupted after {len(replay.verdicts)} verdicts")
        return EXIT_INTERRUPTED
    if code == 0:
        replay.summary = summarise(
            filled_stretches(session.samples, settings, replay.verdicts),
            replay.verdicts,
            settings.law,
            session.notes,
        )
        for line in closing_lines(
            replay.summary, replay.verdicts[-1] if replay.verdicts else None
        ):
            view.say(line)
    return code


def values_for_twin(settings: TwinSettings) -> dict[str, object]:
    """Parameters of the twin's nodes that follow from the session."""
    values: dict[str, object] = {
        "period": settings.period,
        "plant": written_name(settings.plant),
    }
    if settings.law is None:
        values["loop"] = UNKNOWN
    if settings.read_through:
        values["read_through"] = " ".join(settings.read_through)
    return values


def _playable(session: Session, folder: Path) -> Path:
    if session.path.is_dir() or session.path.suffix == ".mcap":
        return session.path
    return write_session(folder / session.name, samples_of(session.window()))


class _ReplayRun(Supervised):
    RESTARTS: Final = 3
    """Most restarts of a killed twin; it catches up on what it missed."""
    STALLED: Final = 120.0
    """Longest wait for the next verdict after the last sample was played, s."""

    NAME = "replay_watch"
    STOP_ORDER = ("player", "twin")

    def __init__(
        self,
        replay: Replay,
        settings: TwinSettings,
        playable: Path,
        view: Screen | Lines,
    ) -> None:
        super().__init__(view)
        self._replay = replay
        self._settings = settings
        self._playable = playable
        self._changed = time.monotonic()
        self._restarts = 0
        self._playing = False

    def start(self, node: Watch) -> None:  # noqa: ARG002
        """Start the twin."""
        session = self._replay.session
        self.view.say(
            f"{session.name}: {len(session.samples)} samples at {self._replay.rate:g} times their speed"
        )
        self._start_twin()

    def take_verdict(self, verdict: Verdict) -> None:
        """Keep and show it."""
        self._replay.verdicts.append(verdict)
        self._changed = time.monotonic()
        self.view.take_verdict(verdict)

    def take_match(self, report: MatchReport) -> None:
        """Keep and show it."""
        self._replay.matches.append(report)
        super().take_match(report)

    def check(self, node: Watch) -> int | None:
        """Start the player once this node is connected to the twin's verdicts; over after the last of them.

        Raises:
            LaunchError: a process was lost, or verdicts stay away.
        """
        replay = self._replay
        samples = self._replay.session.samples
        if replay.verdicts:
            self.view.advance(replay.verdicts[-1].sample - samples[0].index + 1)
        if not self._playing and node.count_publishers("twin/model_score"):
            self._start_player()
        if not self._has_ended():
            return None
        if self.settled.complete(samples[-1].index, len(replay.verdicts)):
            self.view.advance(len(samples))
            replay.whole = True
            return 0
        if time.monotonic() - self._changed > self.STALLED:
            raise LaunchError(
                f"replay: no verdict for {self.STALLED:g} s after {len(replay.verdicts)} verdicts, although "
                "samples are still to be judged; look at /diagnostics"
            )
        return None

    def _has_ended(self) -> bool:
        """Whether the player has ended; a killed twin is restarted before that.

        Raises:
            LaunchError: a process was lost.
        """
        ended = self.processes.ended
        for name, code in ended.items():
            if (
                name == "twin"
                and code < 0
                and self._restarts < self.RESTARTS
                and "player" not in ended
            ):
                self._restarts += 1
                self.view.say(f"twin ended with code {code}; restarting it", "yellow")
                self._start_twin()
            elif name == "twin" or code != 0:
                raise LaunchError(
                    f"replay: {name} ended with code {code}; see its output above"
                )
        return "player" in ended

    def _start_twin(self) -> None:
        replay = self._replay
        settings = self._settings
        values = values_for_twin(settings)
        if replay.candidates is not None:
            values["discriminator:candidates"] = replay.candidates
        options = ros_arguments(
            values, *(() if replay.config is None else (replay.config,))
        )
        self.processes.start_module("twin", "twinmatch.nodes", "twin", *options)

    def _start_player(self) -> None:
        self._playing = True
        values = {
            "session": self._playable,
            "readers": READERS,
            "rate": float(self._replay.rate),
        }
        options = ros_arguments({**values, "wait_timeout": 60.0})
        self.processes.start_module("player", "twinmatch.nodes", "player", *options)
