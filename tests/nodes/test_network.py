"""What is set before ROS starts, and which sockets are whose."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from twinmatch.nodes import problem
from twinmatch.nodes.network import (
    LEASE,
    PROFILES,
    Network,
    NetworkError,
    check_sockets,
    lease,
    log_arguments,
    prepare,
    sockets_elsewhere,
)

VERSIONS = {
    "fastrtps": "FASTRTPS_DEFAULT_PROFILES_FILE",
    "fastdds": "FASTDDS_DEFAULT_PROFILES_FILE",
}


@pytest.mark.parametrize("folder", VERSIONS)
def test_loopback_is_the_default(tmp_path: Path, folder: str) -> None:
    """Of both profiles the one that the installed Fast DDS can parse."""
    (tmp_path / "share" / folder).mkdir(parents=True)
    environment = {
        "HOME": "/",
        "AMENT_PREFIX_PATH": f"/nowhere:{tmp_path}",
        "ROS_STATIC_PEERS": "10.0.0.1",
        "ROS_DISCOVERY_SERVER": "10.0.0.1:11811",
        **dict.fromkeys(PROFILES, "/elsewhere.xml"),
    }
    assert prepare(environment) is Network.LOOPBACK
    assert {name: environment[name] for name in PROFILES if name in environment} == {
        VERSIONS[folder]: str(PROFILES[VERSIONS[folder]])
    }
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert "ROS_STATIC_PEERS" not in environment
    assert "ROS_DISCOVERY_SERVER" not in environment


def test_open_leaves_the_variables_and_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    environment = {"TWINMATCH_NETWORK": "open", "ROS_STATIC_PEERS": "10.0.0.1"}
    assert prepare(environment) is Network.OPEN
    assert environment["ROS_STATIC_PEERS"] == "10.0.0.1"
    assert "FASTDDS_DEFAULT_PROFILES_FILE" not in environment
    assert "NETWORK OPEN" in capsys.readouterr().err


@pytest.mark.parametrize("name", PROFILES)
def test_closed_when_a_profile_is_missing(tmp_path: Path, name: str) -> None:
    with pytest.raises(
        NetworkError,
        match=r"gone\.xml is missing, without which the nodes would be open",
    ):
        prepare(
            {"AMENT_PREFIX_PATH": "/nowhere"}, {**PROFILES, name: tmp_path / "gone.xml"}
        )


def test_both_profiles_say_the_same() -> None:
    """But for one name and the sentence that says which is which."""
    second, third = (path.read_text().splitlines() for path in PROFILES.values())
    assert len(second) == len(third)
    changed = [(a, b) for a, b in zip(second, third, strict=True) if a != b]
    sentence, heartbeat = changed
    assert "For Fast DDS 2" in sentence[0]
    assert "For Fast DDS 3" in sentence[1]
    assert heartbeat[0].replace("heartbeatPeriod", "heartbeat_period") == heartbeat[1]


def test_a_graph_in_step_has_another_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The profile is otherwise the same; after the run the lease is that of the profile again."""
    monkeypatch.setenv("TWINMATCH_CACHE", str(tmp_path))
    with lease(45.0):
        environment = {"AMENT_PREFIX_PATH": "/nowhere", LEASE: os.environ[LEASE]}
        prepare(environment)
    assert LEASE not in os.environ
    for name, profile in PROFILES.items():
        path = Path(environment[name])
        assert path.is_relative_to(tmp_path)
        written = path.read_text()
        text = profile.read_text()
        assert (
            written
            == text.replace("<leaseDuration><sec>5<", "<leaseDuration><sec>45<")
            != text
        )
    with pytest.raises(NetworkError, match="is 'long'; give whole seconds"):
        prepare({"AMENT_PREFIX_PATH": "/nowhere", LEASE: "long"})


def test_a_middleware_that_cannot_be_restricted_to_this_machine_is_refused() -> None:
    with pytest.raises(
        NetworkError,
        match="rmw_cyclonedds_cpp, which twinmatch cannot restrict to this machine",
    ):
        prepare({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})


@pytest.mark.parametrize("value", ["", "OPEN", "yes", "loopback,open"])
def test_other_words_are_refused(value: str) -> None:
    with pytest.raises(NetworkError, match=r"use 'loopback' .* or 'open'"):
        prepare({"TWINMATCH_NETWORK": value})


@pytest.mark.parametrize("environment", [{}, {"HOME": "/nowhere"}])
def test_without_a_home_no_logs_are_written(environment: dict[str, str]) -> None:
    assert log_arguments(environment) == ["--ros-args", "--disable-external-lib-logs"]


@pytest.mark.parametrize(
    "variables", [{"ROS_LOG_DIR": "/here"}, {"ROS_HOME": "/there"}, {"HOME": "/"}]
)
def test_a_place_for_logs_is_kept(variables: dict[str, str]) -> None:
    environment = dict(variables)
    assert log_arguments(environment) == []
    prepare(environment)
    assert environment.get("ROS_LOG_DIR") == variables.get("ROS_LOG_DIR")


@pytest.mark.parametrize(
    ("family", "address", "shown"),
    [
        (socket.AF_INET, "0.0.0.0", "udp 0.0.0.0"),
        (socket.AF_INET, "127.0.0.1", None),
        (socket.AF_INET, "127.1.2.3", None),
        (socket.AF_INET6, "::", "udp6 ::"),
        (socket.AF_INET6, "::1", None),
        (socket.AF_INET6, "::ffff:127.0.0.1", None),
    ],
)
def test_udp_sockets_that_other_machines_reach_are_listed(
    family: int, address: str, shown: str | None
) -> None:
    before = set(sockets_elsewhere())
    with socket.socket(family, socket.SOCK_DGRAM) as bound:
        try:
            bound.bind((address, 0))
        except OSError as error:
            pytest.skip(f"no {address} on this machine: {error}")
        elsewhere = set(sockets_elsewhere()) - before
        assert elsewhere == ({f"{shown}:{bound.getsockname()[1]}"} if shown else set())


def test_only_listening_tcp_sockets_count() -> None:
    before = set(sockets_elsewhere())
    with socket.socket() as bound:
        bound.bind(("0.0.0.0", 0))
        assert set(sockets_elsewhere()) == before
        bound.listen()
        assert set(sockets_elsewhere()) - before == {
            f"tcp 0.0.0.0:{bound.getsockname()[1]}"
        }


def test_udp_sockets_elsewhere_are_refused() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as bound:
        bound.bind(("0.0.0.0", 0))
        with pytest.raises(NetworkError, match=r"bound to udp 0\.0\.0\.0"):
            check_sockets()


def test_no_such_process_has_no_sockets() -> None:
    assert sockets_elsewhere(2**22 + 1) == []


@pytest.mark.parametrize("value", ["", "0", "7", "232"])
def test_every_domain_that_there_is_may_be_named(value: str) -> None:
    assert prepare({"ROS_DOMAIN_ID": value}) is Network.LOOPBACK


@pytest.mark.parametrize("value", ["233", "-1", "abc", "1.5", "9" * 5000, "²", " 7"])
@pytest.mark.parametrize("network", ["loopback", "open"])
def test_a_domain_that_there_is_not_is_refused(value: str, network: str) -> None:
    with pytest.raises(
        NetworkError, match=r"^network: ROS_DOMAIN_ID is .* whole number from 0 to 232$"
    ) as e:
        prepare({"ROS_DOMAIN_ID": value, "TWINMATCH_NETWORK": network})
    assert len(str(e.value)) < 200


@pytest.mark.parametrize(
    ("start", "network"),
    [
        (["-m", "twinmatch.nodes", "matcher"], "open"),
        (["launch_scripts/live.py", "--virtual"], "loopback"),
    ],
)
def test_a_middleware_that_is_not_installed_is_named_before_ros_starts(
    start: list[str], network: str
) -> None:
    wrong = {"RMW_IMPLEMENTATION": "rmw_gone_cpp", "TWINMATCH_NETWORK": network}
    completed = subprocess.run(
        [sys.executable, *start],
        cwd=Path(__file__).resolve().parents[2],
        env=os.environ | wrong,
        capture_output=True,
        text=True,
        check=False,
        timeout=360,
    )
    assert completed.returncode == 2
    assert completed.stderr.count("\n") == 1
    assert (
        "RMW_IMPLEMENTATION is 'rmw_gone_cpp', which is not installed (installed: rmw_fastrtps"
        in completed.stderr
    )


def test_a_middleware_is_looked_for_where_ros_is(tmp_path: Path) -> None:
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    (index / "rmw_other_cpp").touch()
    environment = {
        "RMW_IMPLEMENTATION": "rmw_other_cpp",
        "AMENT_PREFIX_PATH": f"/nowhere:{tmp_path}",
    }
    assert problem(environment) == ""
    assert "'rmw_third_cpp', which is not installed" in problem(
        environment | {"RMW_IMPLEMENTATION": "rmw_third_cpp"}
    )
    # nobody knows
    assert (
        problem({"RMW_IMPLEMENTATION": "rmw_other_cpp"}, wheel_prefix="/nowhere") == ""
    )
