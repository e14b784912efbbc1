"""`make setup` says what a machine lacks before it starts."""

from __future__ import annotations

import platform
import shutil
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import check_machine
import pytest


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module, on a machine that has everything."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(Path, "exists", lambda _: True)
    return check_machine


def test_complete_machine(machine: ModuleType) -> None:
    assert machine.missing() is None


@pytest.mark.parametrize("version", [(3, 9), (3, 14)])
def test_other_python(machine: ModuleType, monkeypatch: pytest.MonkeyPatch, version: tuple[int, int]) -> None:
    monkeypatch.setattr(sys, "version_info", (*version, 0))
    assert f"Python {version[0]}.{version[1]}" in machine.missing()
    assert "use 3.10 to 3.13" in machine.missing()


def test_other_processor(machine: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert "linux on aarch64" in machine.missing()


def test_no_compiler(machine: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert "apt-get install g++" in machine.missing()


def test_no_headers(machine: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "exists", lambda _: False)
    assert str(Path(sysconfig.get_path("include")) / "Python.h") in machine.missing()
