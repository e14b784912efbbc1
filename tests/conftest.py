"""Fixtures that many tests share."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import math
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import scipy.io
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

from tests.support.disks import keep_mounts_to_this_process
from tests.support.durations import Cost, Costs, files_that_grew, processor_seconds
from tests.support.places import (
    OTHERS,
    PROJECT,
    RECORDINGS,
    TESTS,
    remove_temporary_folders,
)
from tests.support.shared_memory import remove_ports, remove_segments
from twinmatch.cli.shared import Progress
from twinmatch.fmu import is_fmu
from twinmatch.plants import PLANTS
from twinmatch.signals import Window

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # how a shell starts what runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)

FIRST = (
    "system", "test_golden.py", "docs", "showing", "nodes", "packaging", "emulation", "fmu", "twin",
    "health", "offline", "words",
)  # fmt: skip
"""Whose tests wait for other processes or compute longest; they begin first, so that none is the last."""
APART = ("tests/test_golden.py", "tests/docs/test_examples.py")
"""Files whose tests share nothing and take long: each is run by whichever worker is free."""
TOGETHER = (
    ("tests/fmu/",),
    ("tests/offline/archive/",),
    ("tests/offline/backtest/",),
    ("tests/offline/test_controller",),
    ("tests/showing/page/test_foreign", "tests/showing/page/test_page_in_browser"),
    (
        "tests/showing/page/test_metrics",
        "tests/showing/page/test_page.py",
        "tests/showing/page/test_panels",
        "tests/showing/page/test_state",
    ),
    (
        "tests/showing/page/test_several",
        "tests/showing/report/",
        "tests/showing/test_several",
    ),
    ("tests/system/subscribers/",),
    ("tests/twin/",),
)
"""Files that share what takes long to make, by how their paths begin: one worker runs all of a group."""

TOOK = PROJECT / "build" / "durations.json"
"""What each test took when it ran last."""
STORED = TESTS / "durations.json"
"""What each file of the stored run took; `--store-durations` stores a run."""
SLOWEST = 10
"""Files that are listed at the end of a run."""

LONG_TESTS = 40
"""How many tests `make test` may leave to `make test-long`."""

settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=40
)
settings.load_profile("repeatable")


class Durations:
    """Collects what each test takes; a worker measures, the process that reports adds up."""

    def __init__(self) -> None:
        self.costs = Costs()
        self._computed_before = processor_seconds()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self,
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        # Its last phase counts for the whole test: to ask the kernel takes as long as many tests do.
        used = self._used_since_the_last() if report.when == "teardown" else 0.0
        report.computed = used  # type: ignore[attr-defined]  # travels with it
        return report

    def _used_since_the_last(self) -> float:
        """Time of the processors, s, since this was asked before."""
        computed = processor_seconds()
        # What a grandchild has used is lost when nobody waits for it, as happens to a browser's.
        used = max(0.0, computed - self._computed_before)
        self._computed_before = computed
        return used

    def pytest_collection_finish(self) -> None:
        """The first test has not used what was needed to collect all."""
        self._computed_before = processor_seconds()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        # The report of a worker that died is made by the process that lists the results.
        computed = getattr(report, "computed", 0.0)
        self.costs.add(report.nodeid, Cost(report.duration, computed))

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter
    ) -> None:
        """The slowest files, and what has changed since the stored run."""
        if not self.costs.by_test:
            return
        self.costs.write(TOOK)
        files = self.costs.by_file()
        if terminalreporter.config.getoption("store_durations"):
            stored = Costs()
            stored.by_test = files
            stored.write(STORED)
        terminalreporter.section("what took longest (clock, processors)")
        for name, cost in list(files.items())[:SLOWEST]:
            terminalreporter.line(
                f"{cost.waited:7.1f} s {cost.computed:7.1f} s  {name}"
            )
        if terminalreporter.config.getoption("markexpr") == "long":
            return  # the stored run has none of these tests
        for line in files_that_grew(Costs.read(STORED).by_file(), files):
            terminalreporter.line(f"grown: {line}")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--store-durations",
        action="store_true",
        help="keep what each file takes as tests/durations.json",
    )


def pytest_configure(config: pytest.Config) -> None:
    gc.disable()  # until all is collected: little of it is garbage
    if hasattr(config, "workerinput"):
        _lead_a_session()
    keep_mounts_to_this_process()
    config.pluginmanager.register(Durations())


def _lead_a_session() -> None:
    """Begin a session of this worker's own.

    Linux shares the processors among sessions, and the programs that tests start have their own: the workers, with
    the emulated hardware that runs in them, would share what one of these programs gets.
    """
    with contextlib.suppress(PermissionError):  # it leads a group already
        os.setsid()


def pytest_xdist_auto_num_workers() -> int:
    """Three times the processors: two thirds of the time tests wait for other processes, and none measures it."""
    return 3 * (os.cpu_count() or 1)


def _refuse(why: str) -> NoReturn:
    """End the run; of a worker's error pytest-xdist shows the place where it was noticed, and not the words."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        print(why, file=sys.__stderr__, flush=True)
    raise pytest.UsageError(why)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What waits begins first; the order within a folder stays."""
    long_tests = [item for item in items if item.get_closest_marker("long") is not None]
    if len(long_tests) > LONG_TESTS:
        _refuse(f"{len(long_tests)} tests are marked long; at most {LONG_TESTS} may be")
    for item in long_tests:
        if not reason_of(item):
            _refuse(f"{item.nodeid}: say why it is long: @pytest.mark.long('…')")
    folders = {name: place for place, name in enumerate(FIRST)}
    items.sort(
        key=lambda item: folders.get(item.path.relative_to(TESTS).parts[0], len(FIRST))
    )


def reason_of(item: pytest.Item) -> str:
    """Why a test is marked long."""
    marker = item.get_closest_marker("long")
    return str(marker.args[0]) if marker is not None and marker.args else ""


def pytest_collection_finish() -> None:
    """What is imported and collected stays to the end; a search for garbage passes over it."""
    gc.enable()
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Leave nothing behind in the temporary folder."""
    remove_temporary_folders()


class ByFile(LoadFileScheduling):
    """The tests of a file stay together, or of a folder, unless they are `APART`."""

    def _split_scope(self, nodeid: str) -> str:
        if nodeid.startswith(APART):
            return nodeid
        group = next((group for group in TOGETHER if nodeid.startswith(group)), None)
        return group[0] if group is not None else str(super()._split_scope(nodeid))


def pytest_xdist_make_scheduler(
    config: pytest.Config, log: object
) -> LoadFileScheduling | None:
    return ByFile(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """Every test has the signal handlers it began with: a program that ran in this process leaves its own."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture(scope="session", autouse=True)
def no_lines_of_progress() -> Iterator[None]:
    """Programs say that they still work only to tests that ask for it; others would depend on the load."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Progress, "SILENCE", math.inf)
        yield


@pytest.fixture(scope="session", autouse=True)
def ros_domain() -> Iterator[int]:
    """A ROS domain of its own for every worker of every test run on this machine, in the environment.

    The process that locks a domain's file has the domain for as long as it lives. Domains above 101 would use
    ports that the kernel hands out to others.
    """
    folder = Path(tempfile.gettempdir()) / f"twinmatch-domains-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for domain in range(1, 102):
        with (folder / str(domain)).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            yield domain
            remove_ports(domain)
            remove_segments()
            return
    pytest.fail(f"all ROS domains are taken by other test runs; see {folder}")


@pytest.fixture(scope="session")
def ros(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> None:  # noqa: ARG001
    """The environment of all ROS in this process and its children, in the domain of this worker."""
    pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
    pytest.importorskip(
        "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
    )
    from twinmatch.nodes import network

    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))
    os.environ.pop(network.VARIABLE, None)
    network.prepare()


@pytest.fixture(scope="module", autouse=True)
def no_adopted_structures() -> Iterator[None]:
    """Return every plant to its own structures after each test file: FMUs that one adopts are no other's."""
    yield
    for plant in PLANTS.values():
        for name in [name for name in plant.structures if is_fmu(name)]:
            source = plant.structures[name].external
            plant.disown(name)
            if hasattr(source, "close"):
                source.close()


@pytest.fixture(scope="session")
def recordings() -> dict[int, Path]:
    """Paths of the real rig's recordings by their number."""
    found = {
        int(p.name[6:].split("_")[0]): p
        for p in sorted(RECORDINGS.glob("BMData*_*.mat"))
    }
    if not found:
        pytest.skip(
            f"no rig recordings in {RECORDINGS}; set TWINMATCH_RECORDINGS to their folder"
        )
    return found


@pytest.fixture(scope="session")
def recorded_hour(recordings: dict[int, Path]) -> Callable[[int], Window]:
    """Read one recording as a window: `recorded_hour(5)`."""

    def read(number: int) -> Window:
        if number not in recordings:
            pytest.skip(f"recording {number} is not in {RECORDINGS}")
        u, y, _, r = np.asarray(
            scipy.io.loadmat(recordings[number])["simout"], dtype=np.float64
        ).T
        return Window(r, y, u)

    return read


@pytest.fixture(scope="session")
def kit_recording() -> Callable[[str], Window]:
    """Read a recording of a Temperature Control Lab, which was driven without a loop."""

    def read(name: str) -> Window:
        path = OTHERS / "tclab" / name
        if not path.exists():
            pytest.skip(
                f"no {path}; set TWINMATCH_PLANT_RECORDINGS to the folder of other plants' recordings"
            )
        rows = np.genfromtxt(path, delimiter=",", skip_header=1)
        pair = rows.shape[1] > 3
        q1, q2, t1 = (
            (rows[:, 1], rows[:, 2], rows[:, 3])
            if pair
            else (rows[:, 1], 0 * rows[:, 1], rows[:, 2])
        )
        return Window(np.full(t1.size, t1[0]), t1, q1, disturbances=q2[:, None])

    return read


@pytest.fixture(scope="session")
def incubator_folder() -> Path:
    """Where the recordings of the published incubator are."""
    path = OTHERS / "incubator"
    if not path.is_dir():
        pytest.skip(
            f"no {path}; set TWINMATCH_PLANT_RECORDINGS to the folder of other plants' recordings"
        )
    return path
