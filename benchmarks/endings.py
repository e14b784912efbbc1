"""Each kind of process, ended at random moments: does it end as it should, and leave nothing behind?

    python -m benchmarks.endings [N] [--seed S] [--kinds NAME ...] [--within 8] [--list]

Each kind is started N times as the launch scripts start it, and gets SIGINT or SIGTERM at a random moment. It
has ended well if

* its exit code is 0 or 130, or SIGINT if it says that it was interrupted: Python ends so if the interrupt
  came while it ran generated code, and a shell says 130, too; or the signal itself while it was importing;
* it has printed no traceback, and has not killed what it had started;
* nothing that it had started still runs, and its temporary folder is empty.

Exit code of this program: 0 all have ended well, 1 some have not.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

from pymodbus.server import ModbusTcpServer

from tests.links.test_modbus_source import PLACES, RunningDevice, ServedOven
from tests.support.broker import RunningBroker
from tests.support.foreign_rig import Oven
from tests.support.oven import HOLD, MAP, PERIOD, RIG, oven_file
from tests.support.places import PROJECT
from tests.support.processes import Process
from twinmatch.errors import EXIT_INTERRUPTED
from twinmatch.links.mqtt_client import Broker, leave

SESSION: Final = PROJECT / "bags" / "four_setpoints"
START: Final = 120.0
"""Longest start of what a kind needs, wall s."""
PATIENCE: Final = 90.0
"""Longest end, wall s."""
AMISS: Final = re.compile(
    r"Traceback|Fatal Python error|terminate called|did not end in time|with code -"
)
"""What is printed by a process that has not ended well, or by its launcher."""
SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
TOPICS: Final = ("oven/set_point", "oven/temperature", "oven/heater")


class World:
    """What the kinds are connected to; each part is started when a kind first needs it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.plant = oven_file(folder)
        self._endings: list[Callable[[], object]] = []

    def start(self, name: str, *words: object) -> Process:
        """Start a program, which ends with this world."""
        process = Process(sys.executable, *words, output=self.folder / f"{name}.txt")
        self._endings.append(process.kill)
        return process

    @cached_property
    def rig(self) -> dict[str, str]:
        """Addresses of a virtual Peltier rig."""
        return self._virtual("rig")

    @cached_property
    def kit(self) -> dict[str, str]:
        """Addresses of a virtual Temperature Control Lab."""
        return self._virtual("kit", "--plant", "tclab")

    def _virtual(self, name: str, *options: str) -> dict[str, str]:
        process = self.start(name, "-m", "twinmatch.cli", "virtual-rig", *options)
        process.said("^ready$", START)
        return dict(line.split(": ", 1) for line in process.lines if ": " in line)

    @cached_property
    def samples(self) -> Process:
        """Somebody else's rig with ROS; its topics are those of `MAP`."""
        return self.start("foreign", RIG, "--period", PERIOD)

    @cached_property
    def broker(self) -> str:
        """URL of a broker to which an oven publishes."""
        broker = RunningBroker(self.folder / "broker")
        self._endings.append(broker.close)
        client = Broker.parse(broker.url).connected(lambda _: None)
        self._endings.append(lambda: leave(client))
        oven = Oven(PERIOD, HOLD)

        def publish() -> None:
            while True:
                for topic, value in zip(TOPICS, oven.step(), strict=True):
                    client.publish(topic, f"{value:.4f}")
                time.sleep(PERIOD)

        threading.Thread(target=publish, daemon=True).start()
        return broker.url

    @cached_property
    def device(self) -> str:
        """URL of an oven behind Modbus."""
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = int(free.getsockname()[1])

        def make(device: Any, trace: Any) -> ModbusTcpServer:
            return ModbusTcpServer(device, address=("127.0.0.1", port), trace_pdu=trace)

        made = RunningDevice(
            make, ServedOven().device(), f"modbus://127.0.0.1:{port}/1"
        )
        self._endings.append(made.end)
        return made.url

    def close(self) -> None:
        """End all of it."""
        for ending in reversed(self._endings):
            ending()


Words = list[object]
Kind = Callable[[World, Path], Words]
"""The words of a program, given a new folder for what it writes."""


def node(name: str, **parameters: object) -> Words:
    """The words of a node's program."""
    given = [
        word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")
    ]
    return ["-m", "twinmatch.nodes", name, "--ros-args", *given]


def command(*words: object) -> Words:
    """The words of a command."""
    return ["-m", "twinmatch.cli", *words]


def _bridge(world: World, name: str = "") -> dict[str, object]:
    host, port = world.rig["camera"].rsplit(":", 1)
    return {f"{name}host": host, f"{name}port": port}


def _rig(world: World, _: Path) -> Words:
    pair = {**_bridge(world, "camera_bridge:"), "pwm_bridge:port": world.rig["serial"]}
    return node("rig", **pair)


def _attached(world: World, folder: Path, *more: object) -> Words:
    where = (
        "--plant",
        world.plant,
        "--period",
        PERIOD,
        "--session",
        folder / "session",
    )
    return command("attach", *where, *more)


def _of_ros(world: World) -> Words:
    assert world.samples.running
    return ["--map", *(f"{name}={place}" for name, place in MAP.items())]


def _of_mqtt(world: World) -> Words:
    names = ("reference", "output", "input")
    places = [f"{name}={topic}" for name, topic in zip(names, TOPICS, strict=True)]
    return ["--source", world.broker, "--map", *places]


def _of_modbus(world: World) -> Words:
    return ["--source", world.device, "--map", *PLACES]


def _sampler(world: World, source: Words) -> Words:
    url = source[1] if source[0] == "--source" else ""
    places = dict(
        str(word).split("=", 1) for word in source[source.index("--map") + 1 :]
    )
    given = {f"map.{name}": f"'{place}'" for name, place in places.items()}
    return node("sampler", plant=world.plant, period=PERIOD, source=f"'{url}'", **given)


KINDS: Final[dict[str, Kind]] = {
    "camera_bridge": lambda world, _: node("camera_bridge", **_bridge(world)),
    "pwm_bridge": lambda world, _: node("pwm_bridge", port=world.rig["serial"]),
    "controller": lambda _, __: node("controller"),
    "rig": _rig,
    "tclab_bridge": lambda world, _: node("tclab_bridge", port=world.kit["serial"]),
    "tclab_rig": lambda world, _: node(
        "tclab_rig", **{"tclab_bridge:port": world.kit["serial"]}
    ),
    "plant_clock": lambda world, _: node("plant_clock", address=world.rig["clock"]),
    "player": lambda _, __: node(
        "player", session=SESSION, rate=50.0, wait_timeout=60.0
    ),
    "recorder": lambda _, folder: node("recorder", folder=folder / "sessions"),
    "twin": lambda _, __: node("twin"),
    "twin_simulator": lambda _, __: node("twin_simulator"),
    "matcher": lambda _, __: node("matcher"),
    "discriminator": lambda _, __: node("discriminator"),
    "sampler of ROS": lambda world, _: _sampler(world, _of_ros(world)),
    "sampler of MQTT": lambda world, _: _sampler(world, _of_mqtt(world)),
    "sampler of Modbus": lambda world, _: _sampler(world, _of_modbus(world)),
    "page": lambda world, _: command("dashboard", "--port", 0, "--tell", world.broker),
    "foxglove": lambda _, __: command("foxglove", "--port", 0),
    "virtual rig": lambda _, __: command("virtual-rig", "--speed", 5),
    "virtual kit": lambda _, __: command(
        "virtual-rig", "--plant", "tclab", "--speed", 5
    ),
    "alone, MQTT": lambda world, folder: _attached(
        world, folder, "--alone", "--dashboard", 0, *_of_mqtt(world)
    ),
    "alone, Modbus": lambda world, folder: _attached(
        world, folder, "--alone", *_of_modbus(world)
    ),
    "attach, ROS": lambda world, folder: _attached(world, folder, *_of_ros(world)),
    "attach, MQTT": lambda world, folder: _attached(
        world, folder, "--dashboard", 0, *_of_mqtt(world)
    ),
    "attach, Modbus": lambda world, folder: _attached(
        world, folder, *_of_modbus(world)
    ),
    "live": lambda _, folder: command(
        "live",
        "--virtual",
        "--speed",
        5,
        "--dashboard",
        0,
        "--session",
        folder / "session",
    ),
    "play": lambda _, __: command("play", SESSION, "--rate", 50, "--dashboard", 0),
}


class Ending(NamedTuple):
    """How a process has ended."""

    code: str
    """Exit code; "hangs" if it had to be killed."""
    wrong: str
    """What was wrong, with what it has printed; empty if nothing was."""


def end_once(
    words: Words, folder: Path, moment: float, number: signal.Signals
) -> Ending:
    """Start a program and send it a signal at a moment (s after its start)."""
    temporary = folder / "tmp"
    temporary.mkdir()
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "TMPDIR": str(temporary)}
    output = folder / "output.txt"
    process = Process(
        sys.executable, *words, output=output, environment=environment, forked=True
    )
    time.sleep(moment)
    by_itself = not process.running
    started = descendants(process.id)
    process.send(number)
    try:
        code = process.wait(PATIENCE)
    except AssertionError:
        process.kill()
        code = None
    wrong = list(_amiss(code, process.text, number, by_itself=by_itself))
    wrong += [f"{name} still runs" for pid, name in started.items() if _runs(pid)]
    wrong += [
        f"{path.name} is left"
        for path in temporary.iterdir()
        if not path.name.startswith("pymp-")
    ]
    said = f"{number.name} after {moment:.2f} s: {', '.join(wrong)}\n{process.text[-3000:]}"
    return Ending("hangs" if code is None else str(code), said if wrong else "")


def _amiss(
    code: int | None, text: str, number: signal.Signals, *, by_itself: bool
) -> Iterator[str]:
    importing = code == -number and not text
    interrupted = code == -signal.SIGINT and text.endswith("twinmatch: interrupted\n")
    if code is None:
        yield f"still running after {PATIENCE:g} s"
    elif by_itself and code != 0:
        yield f"had ended before with {code}"
    elif code not in (0, EXIT_INTERRUPTED) and not importing and not interrupted:
        yield f"exit code {code}"
    if found := AMISS.search(text):
        yield f"printed {found[0]!r}"


def descendants(process: int) -> dict[int, str]:
    """All that a process has started: process id and name."""
    found: dict[int, str] = {}
    waiting = [process]
    while waiting:
        try:
            children = Process.children_of(waiting.pop())
        except OSError:  # it has just ended
            continue
        for child in children:
            found[child] = _name(child)
        waiting += children
    return found


def _name(process: int) -> str:
    try:
        return Path(f"/proc/{process}/comm").read_text().strip()
    except OSError:
        return "?"


def _runs(process: int) -> bool:
    """Whether it runs, also a moment later: a process ends after those who wait for its output know."""
    for _ in range(20):
        try:
            state = (
                Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
            )
        except OSError:
            return False
        if state == "Z":
            return False
        time.sleep(0.1)
    return True


@contextmanager
def world() -> Iterator[World]:
    """A world of its own, in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="twinmatch-endings-") as folder:
        made = World(Path(folder))
        try:
            yield made
        finally:
            made.close()


def end_often(name: str, there: World, number: int, seed: int, within: float) -> int:
    """End a kind so many times, at most `within` s after its start; returns how many have not ended well."""
    rng = random.Random(f"{seed} {name}")
    codes = Counter[str]()
    wrong = 0
    for k in range(number):
        folder = there.folder / f"{re.sub('[^a-zA-Z_]', '_', name)}_{k}"
        folder.mkdir()
        words = KINDS[name](there, folder)
        ending = end_once(words, folder, rng.uniform(0.0, within), rng.choice(SIGNALS))
        shutil.rmtree(folder, ignore_errors=True)
        codes[ending.code] += 1
        if ending.wrong:
            wrong += 1
            print(f"   {name}: {ending.wrong}", flush=True)
    shown = ", ".join(f"{code}: {count}" for code, count in sorted(codes.items()))
    print(
        f"{name:18} {number - wrong} of {number} well; exit codes {shown}", flush=True
    )
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.endings", description=__doc__
    )
    parser.add_argument(
        "number", type=int, nargs="?", default=50, metavar="N", help="of each kind (50)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--kinds", nargs="+", choices=[*KINDS], metavar="NAME", default=[*KINDS]
    )
    parser.add_argument(
        "--within", type=float, default=8.0, help="latest moment after the start, s (8)"
    )
    parser.add_argument("--list", action="store_true", help="name the kinds and stop")
    options = parser.parse_args()
    if options.list:
        print("\n".join(KINDS))
        return 0
    for number in SIGNALS:
        # so that the world ends, too; and a shell's background would ignore SIGINT
        signal.signal(number, signal.default_int_handler)
    wrong = 0
    with world() as there:
        for name in options.kinds:
            wrong += end_often(
                name, there, options.number, options.seed, options.within
            )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
