"""How long a twin that is killed after an hour needs to be back.

A player publishes samples with the shipped settings of the Peltier plant, an hour of them as fast as the
twin keeps up, then one a second. The twin is killed (SIGKILL) and started again at once. The time is from
that start to its first new message on `twin/state`, and to the first on `twin/forecast`, which the
discriminator publishes when it has judged every sample again. It includes the start of the process, and up
to a second until the next sample. The processor time of the new process until then is in the note.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter

from benchmarks.common import Row, main
from benchmarks.rig import recorded
from twinmatch.nodes import network
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.sessions import write_session
from twinmatch_msgs.msg import Forecast, TwinState

FAST = 1000.0
PATIENCE = 600.0
"""Wall seconds for anything."""


class Graph:
    """A player and a twin, and what the twin says."""

    def __init__(self, node: Node, session: Path) -> None:
        self._node = node
        self.newest = {"twin/state": -1, "twin/forecast": -1}
        """The newest sample of which there was a message, by topic."""
        node.create_subscription(TwinState, "twin/state", self._on_state, EVERYTHING)
        node.create_subscription(
            Forecast, "twin/forecast", self._on_forecast, EVERYTHING
        )
        self._processes: list[subprocess.Popen[bytes]] = []
        self.twin = self._start("twin")
        readers = "readers:=twin_simulator discriminator keeper"
        words = [f"session:={session}", f"rate:={FAST}", readers, "wait_timeout:=120.0"]
        self._start(
            "player", "--ros-args", *(part for word in words for part in ("-p", word))
        )
        self._rate = node.create_client(SetParameters, "player/set_parameters")

    def _start(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "twinmatch.nodes", name, *words]
        self._processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))
        return self._processes[-1]

    def kill_and_restart(self) -> None:
        self.twin.kill()
        self.twin.wait()
        self.twin = self._start("twin")

    @property
    def processor_time(self) -> float:
        """Of the twin's process, s."""
        words = (
            Path(f"/proc/{self.twin.pid}/stat").read_text().rpartition(")")[2].split()
        )
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def set_rate(self, rate: float) -> None:
        value = Parameter("rate", value=rate).to_parameter_msg()
        self._rate.wait_for_service(PATIENCE)
        answer = self._rate.call_async(SetParameters.Request(parameters=[value]))
        self.until(answer.done)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            rclpy.spin_once(self._node, timeout_sec=0.01)
            if time.monotonic() > end:
                raise TimeoutError("come_back: the twin or the player does not answer")

    def newer(self, topic: str, index: int) -> bool:
        return self.newest[topic] > index

    def close(self) -> None:
        for process in reversed(self._processes):
            process.terminate()
        for process in self._processes:
            process.wait()

    def _on_state(self, message: TwinState) -> None:
        self.newest["twin/state"] = max(self.newest["twin/state"], message.index)

    def _on_forecast(self, message: Forecast) -> None:
        self.newest["twin/forecast"] = max(self.newest["twin/forecast"], message.sample)


@contextmanager
def _graph(session: Path) -> Iterator[Graph]:
    network.prepare()
    rclpy.init()
    node = Node("come_back")
    graph = Graph(node, session)
    try:
        yield graph
    finally:
        graph.close()
        node.destroy_node()
        rclpy.try_shutdown()


def run(quick: bool) -> list[Row]:
    count, repeats = (600, 1) if quick else (3600, 3)
    times: dict[str, list[float]] = {}
    spent: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        session = write_session(Path(folder) / "hour", recorded(count + 2000))
        with _graph(session) as graph:
            graph.until(lambda: graph.newest["twin/state"] >= count)
            graph.set_rate(1.0)
            graph.until(
                lambda: (
                    graph.newest["twin/forecast"] >= graph.newest["twin/state"] > count
                )
            )
            for _ in range(repeats):
                known = dict(graph.newest)
                begin = time.monotonic()
                graph.kill_and_restart()
                for topic, index in known.items():
                    graph.until(partial(graph.newer, topic, index))
                    times.setdefault(topic, []).append(time.monotonic() - begin)
                    spent.setdefault(topic, []).append(graph.processor_time)
    return [
        Row(
            "come_back",
            f"killed after {count} samples, back on {topic}",
            "twinmatch",
            median(found),
            None,
            len(found),
            note=f"{min(found):.1f} to {max(found):.1f} s, processor {median(spent[topic]):.1f} s",
        )
        for topic, found in times.items()
    ]


if __name__ == "__main__":
    main(run, __doc__)
