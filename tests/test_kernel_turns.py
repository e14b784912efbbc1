"""The turn to compile a kernel: one process has it, and it never stops the others for good."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from twinmatch import kernel_turns
from twinmatch.kernel_turns import KernelTurn


def never() -> None:
    pytest.fail("there was nobody to wait for")


def test_the_turn_is_waited_for_until_it_is_given_back(tmp_path: Path) -> None:
    first = KernelTurn("kernel")
    second = KernelTurn("kernel")
    waits = threading.Event()
    first.take(str(tmp_path), never)
    waiting = threading.Thread(target=second.take, args=(str(tmp_path), waits.set))
    waiting.start()
    assert waits.wait(10.0)
    assert waiting.is_alive()
    first.give_back()
    waiting.join(10.0)
    assert not waiting.is_alive()
    second.give_back()


def test_other_kernels_are_not_waited_for(tmp_path: Path) -> None:
    first = KernelTurn("kernel")
    second = KernelTurn("other")
    first.take(str(tmp_path), never)
    second.take(str(tmp_path), never)
    first.give_back()
    second.give_back()


def test_a_turn_may_be_taken_again(tmp_path: Path) -> None:
    turn = KernelTurn("kernel")
    turn.take(str(tmp_path), never)
    turn.take(str(tmp_path), never)
    turn.give_back()
    turn.give_back()
    next_turn = KernelTurn("kernel")
    next_turn.take(str(tmp_path), never)
    next_turn.give_back()


def test_a_process_that_never_ends_is_not_waited_for_for_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_turns, "PATIENCE", 0.0)
    first = KernelTurn("kernel")
    first.take(str(tmp_path), never)
    waited: list[bool] = []
    second = KernelTurn("kernel")
    second.take(str(tmp_path), lambda: waited.append(True))
    assert waited == [True]
    # it is still the first one's
    second.give_back()
    second.take(str(tmp_path), lambda: waited.append(True))
    assert waited == [True, True]
    second.give_back()
    first.give_back()


def test_without_a_folder_for_locks_nobody_waits(tmp_path: Path) -> None:
    KernelTurn("kernel").take(str(tmp_path / "missing"), never)
