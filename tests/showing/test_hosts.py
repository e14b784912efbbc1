"""The names that a server answers to."""

from __future__ import annotations

import socket

import pytest

from twinmatch.showing.serving import Hosts

HERE = Hosts.of("127.0.0.1", ["Rig.Lab"])
OPEN = Hosts.of("0.0.0.0")


@pytest.mark.parametrize(
    ("hosts", "name", "answers"),
    [
        *(
            (HERE, name, True)
            for name in (
                "localhost",
                "LOCALHOST:80",
                "localhost.",
                "127.0.0.1:1",
                "[::1]:5",
                "127.9.9.9",
            )
        ),
        *((HERE, name, True) for name in ("rig.lab", "RIG.lab:80")),
        *(
            (HERE, name, False)
            for name in (
                "evil.example",
                "localhost.evil.example",
                "127.0.0.1.evil.example",
                "",
            )
        ),
        *(
            (HERE, name, False)
            for name in (
                "192.0.2.1",
                "[2001:db8::1]",
                "a@localhost",
                "localhost:x",
                "localhost/",
            )
        ),
        *(
            (HERE, name, False)
            for name in (
                "127.0.0.1, evil.example",
                "localhost evil",
                "::1",
                "[::1",
                "0.0.0.0",
            )
        ),
        *(
            (HERE, name, False)
            for name in ("2130706433", "0x7f.1", "rig", "notlocalhost", "\x1b]0;x\x07")
        ),
        *(
            (OPEN, name, True)
            for name in (
                "192.0.2.1:5006",
                "[2001:db8::1]",
                "localhost",
                socket.gethostname(),
            )
        ),
        *(
            (OPEN, name, False)
            for name in ("evil.example", "192.0.2.1.evil.example", "")
        ),
    ],
)
def test_it_answers_to_its_own_names_alone(
    hosts: Hosts, name: str, answers: bool
) -> None:
    assert (hosts.refusal(name, None) == "") == answers
    assert hosts.refusal(None, None)


@pytest.mark.parametrize(
    ("hosts", "origin", "page", "viewer"),
    [
        (HERE, "http://localhost:5006", True, True),
        (HERE, "https://localhost:5006", True, True),
        (HERE, "https://rig.lab", True, True),
        (HERE, "http://localhost:1", False, True),
        (HERE, "file://", False, True),
        (HERE, "http://evil.example", False, False),
        (HERE, "http://evil.example/localhost:5006", False, False),
        (HERE, "null", False, False),
        (HERE, "", False, False),
        (OPEN, "http://192.0.2.9:5006", False, False),
    ],
)
def test_pages_of_other_servers_may_not_use_it(
    hosts: Hosts, origin: str, page: bool, viewer: bool
) -> None:
    assert (hosts.refusal("localhost:5006", origin) == "") == page
    assert (hosts.refusal("localhost:5006", origin, beside=True) == "") == viewer


def test_a_refusal_is_one_short_line_without_control_characters() -> None:
    for host, origin in (
        ("\x1b[2J" * 5000, None),
        ("localhost", "http://\x1b]0;" + "é" * 5000),
    ):
        why = HERE.refusal(host, origin)
        assert why.isprintable()
        assert len(why) < 700
