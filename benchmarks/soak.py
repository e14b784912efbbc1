"""A soak: a day of the plant with everything running, and whether the memory of any process grows.

    python -m benchmarks.soak [--plant tclab] [--speed 20] [--hours 24] [--session FOLDER] [--json OUT]

`live` runs a virtual plant with the twin, the recorder and the page; a client keeps the page open over its
websocket, as a browser does. The resident memory of every process is read every two seconds, and its median
is taken over each hour of plant time. The first hour fills what has a limit. A process whose memory has
grown by more than `ALLOWED` between the second hour and the last fails the soak. Exit code: 0 no process
has grown, 1 a process has grown or was restarted.

If the speed is too high for the machine, ticks are missed and reported as gaps: lower it then.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import defaultdict
from pathlib import Path
from statistics import median

import yaml
from bokeh.protocol import Protocol
from rich.console import Console
from rich.table import Table
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketError, websocket_connect

from twinmatch.emulation.faults import RigControlError, tell
from twinmatch.errors import TwinmatchError
from twinmatch.shipped import shipped

ALLOWED = 2.0
"""MB by which a process may grow from its second hour to the last: noise of the allocator."""
EVERY = 2.0
"""Wall seconds between two readings."""
START = 120.0
"""Wall seconds the virtual rig and the page have to start."""

CONFIGS = {"peltier": "rig.yaml", "tclab": "tclab.yaml"}
PATIENT = {
    "max_age": 10.0,
    "command_timeout": 10.0,
    "temperature_timeout": 60.0,
    "clock_timeout": 10.0,
}
"""Deadlines of the rig in seconds of the plant, as long as they may be: they are short on a wall clock."""


class Tab(threading.Thread):
    """A page that is open: takes the document and every change of it."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._url = url
        self.opened = self.messages = self.bytes = 0
        self.error = ""

    def run(self) -> None:
        while True:  # as a browser's tab does that lost its page
            try:
                asyncio.run(self._read())
            except (OSError, HTTPClientError, WebSocketError) as error:
                self.error = f"{type(error).__name__}: {error}"
            time.sleep(EVERY)

    async def _read(self) -> None:
        with urllib.request.urlopen(self._url) as answer:
            text = answer.read().decode()
        token = re.search(r'"token":\s*"([^"]+)"', text)
        assert token is not None, "the page has no token"
        address = self._url.replace("http", "ws") + "ws"
        origin = self._url.rstrip("/")
        request = HTTPRequest(address, headers={"Origin": origin})
        self.opened += 1
        connection = await websocket_connect(request, subprotocols=["bokeh", token[1]])
        for part in _parts(Protocol().create("PULL-DOC-REQ")):
            await connection.write_message(part)
        while (message := await connection.read_message()) is not None:
            self.messages += 1
            self.bytes += len(message)


def _parts(message: object) -> list[str]:
    return [message.header_json, message.metadata_json, message.content_json]  # type: ignore[attr-defined]


class Soak:
    """One run of `live` and what was read of its processes."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self.readings: list[tuple[float, str, float, float]] = []
        """Plant time, s; process; MB resident; MB of them that are not pages of files or shared memory."""
        self.lines: list[str] = []
        self.elapsed = 0.0
        self.speed = 0.0
        self._ids: dict[str, set[int]] = defaultdict(set)
        session = options.session or folder / "session"
        words = [
            "--plant",
            options.plant,
            "--virtual",
            "--speed",
            str(options.speed),
            "--dashboard",
            "0",
        ]
        words += ["--config", str(_patient(options.plant, folder))]
        self._begun = time.monotonic()
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "twinmatch.cli",
                "live",
                *words,
                "--session",
                str(session),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in self.process.stdout or ():
            self.lines.append(line.rstrip())

    def found(self, pattern: str) -> str:
        """The first group of the first line that fits; waits for it."""
        end = time.monotonic() + START
        while time.monotonic() < end and self.process.poll() is None:
            for line in list(self.lines):
                if (fits := re.search(pattern, line)) is not None:
                    return fits[1]
            time.sleep(0.2)
        raise TwinmatchError(
            f"soak: no line with {pattern} came:\n" + "\n".join(self.lines)
        )

    def read(self, control: str) -> bool:
        """Read the memory of all processes, at this time of the plant; False: the plant is gone."""
        try:
            state = json.loads(tell(control, "state"))
        except (RigControlError, OSError):
            return False
        self.elapsed = state["time"]
        self.speed = state["speed"]
        for process, name in _family(self.process.pid).items():
            self._ids[name].add(process)
            if (held := _resident(process)) is not None:
                self.readings.append((self.elapsed, name, *held))
        return True

    @property
    def restarted(self) -> list[str]:
        """Processes of which there was more than one."""
        return sorted(name for name, ids in self._ids.items() if len(ids) > 1)

    def medians(self, hours: int) -> dict[str, list[float]]:
        """MB resident of each process in each hour."""
        names = {name for _, name, *_ in self.readings}
        sizes: dict[str, list[list[float]]] = {
            name: [[] for _ in range(hours)] for name in names
        }
        for at, name, resident, _ in self.readings:
            if at < 3600 * hours:
                sizes[name][int(at // 3600)].append(resident)
        return {
            name: [median(hour) if hour else math.nan for hour in of_hours]
            for name, of_hours in sizes.items()
        }

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(120)


def _patient(plant: str, folder: Path) -> Path:
    """The plant's parameters with long deadlines."""
    config = yaml.safe_load(shipped(f"config/{CONFIGS[plant]}").read_text())
    for node in config.values():
        given = node["ros__parameters"]
        given |= {name: value for name, value in PATIENT.items() if name in given}
    path = folder / "patient.yaml"
    path.write_text(yaml.safe_dump(config))
    return path


def _family(parent: int) -> dict[int, str]:
    """A process and all its descendants: process id → what it is."""
    found = {parent: "live"}
    waiting = [parent]
    while waiting:
        for task in Path(f"/proc/{waiting.pop()}/task").glob("*/children"):
            try:
                children = [int(child) for child in task.read_text().split()]
                names = {
                    child: _name(Path(f"/proc/{child}/cmdline").read_bytes())
                    for child in children
                }
            except OSError:
                continue
            found |= {child: name for child, name in names.items() if name}
            waiting += children
    return found


def _name(command: bytes) -> str:
    """A program by its module, a subcommand by its name."""
    # of one that has ended, but was not waited for yet: none
    words = command.decode().split("\0")
    module = words[words.index("-m") + 1] if "-m" in words else Path(words[0]).name
    named = module in ("twinmatch.cli", "twinmatch.nodes")
    return words[words.index("-m") + 2] if named else module.rpartition(".")[2]


def _resident(process: int) -> tuple[float, float] | None:
    """MB of memory that a process holds, and MB of them that are its own."""
    try:
        text = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return None
    found = dict(re.findall(r"(VmRSS|RssAnon):\s+(\d+) kB", text))
    return (
        (int(found["VmRSS"]) / 1024, int(found["RssAnon"]) / 1024)
        if len(found) == 2
        else None
    )


def main() -> int:
    title = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.soak", description=title
    )
    parser.add_argument("--plant", default="peltier", choices=("peltier", "tclab"))
    parser.add_argument(
        "--speed", type=float, default=20.0, help="plant time per wall time (20)"
    )
    parser.add_argument("--hours", type=float, default=24.0, help="of plant time (24)")
    parser.add_argument(
        "--session", type=Path, help="record here and leave it (a temporary folder)"
    )
    parser.add_argument(
        "--json", type=Path, metavar="OUT", help="write all readings to this file"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="twinmatch-soak-") as folder:
        soak = Soak(options, Path(folder))
        try:
            tab = Tab(soak.found(r"(http://\S+)"))
            tab.start()
            control = soak.found(r"control: (\S+)")
            hour = 0
            while (
                soak.read(control)
                and soak.elapsed < options.hours * 3600
                and soak.process.poll() is None
            ):
                time.sleep(EVERY)
                if soak.elapsed // 3600 > hour:
                    hour = int(soak.elapsed // 3600)
                    print(f"hour {hour}, {soak.speed:.0f} times real time", flush=True)
        finally:
            soak.stop()
    wall = time.monotonic() - soak._begun
    return _tell(soak, tab, wall, options)


def _tell(soak: Soak, tab: Tab, wall: float, options: argparse.Namespace) -> int:
    table = Table(
        title="Memory, MB: median of each hour of plant time",
        title_justify="left",
        box=None,
    )
    table.add_column("process")
    last = max(0, int(soak.elapsed // 3600) - 1)  # the last whole hour
    shown = sorted({0, 1, 2, 6, 12, 18, last} & set(range(last + 1)))
    for hour in shown:
        table.add_column(f"hour {hour + 1}", justify="right")
    table.add_column("growth after hour 1", justify="right")
    medians = soak.medians(last + 1)
    grew = []
    for name, values in sorted(medians.items()):
        growth = values[-1] - values[min(1, last)]
        if not growth <= ALLOWED:
            grew.append(name)
        table.add_row(
            name, *(f"{values[hour]:.1f}" for hour in shown), f"{growth:+.1f}"
        )
    Console(width=140).print(table)
    print(
        f"{soak.elapsed:.0f} s of the plant in {wall:.0f} s, {soak.elapsed / wall:.0f} times real time"
    )
    print(
        f"page: opened {tab.opened} times, {tab.messages} messages, {tab.bytes / 1e6:.0f} MB {tab.error}"
    )
    gaps = sum("are missing" in line for line in soak.lines)
    print(f"{gaps} gaps in the samples were reported; health of the rig, and the end:")
    told = re.compile("bridge: health|controller: health|^ended")
    print("\n".join(line for line in soak.lines if told.search(line)))
    if options.json is not None:
        options.json.write_text(json.dumps(soak.readings) + "\n")
    for name in grew:
        print(f"soak: {name} grew by more than {ALLOWED:g} MB after its first hour")
    for name in soak.restarted:
        print(f"soak: {name} was started more than once")
    return 1 if grew or soak.restarted else 0


if __name__ == "__main__":
    sys.exit(main())
