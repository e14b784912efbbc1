"""Texts of others on a terminal: nothing in them is carried out."""

from __future__ import annotations

import io
import sys
import unicodedata
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import pytest
from rich.table import Table
from rich.text import Text

from tests.support.processes import run_twinmatch
from tests.support.verdicts import LED
from twinmatch.errors import TwinmatchError
from twinmatch.printing import one_line, original, printable, printable_output
from twinmatch.sessions import SessionWriter
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.showing.console import Console
from twinmatch.showing.lines import Lines
from twinmatch.showing.terminal import Screen
from twinmatch.signals import Sample

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.\r[/bold]:bomb:"
TITLE = "\x1b]0;owned\x07"
ESCAPED = r"\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.\r[/bold]:bomb:"


def test_what_controls_a_terminal_is_escaped_and_nothing_else() -> None:
    for code in (
        *range(0x3000),
        *range(0xD7F0, 0xE010),
        *range(0xFE00, 0xFF10),
        *range(0xE0000, 0xE0080),
    ):
        letter = chr(code)
        odd = (
            unicodedata.category(letter) in {"Cc", "Cs", "Zl", "Zp"}
            and letter not in "\n\t"
        )
        assert odd <= (printable(letter) != letter), hex(code)
        assert printable(letter).isascii() or printable(letter) == letter
    harmless = "60 °C · ν-gap ▶ ○ → “words” −1 000 ²³⁸ é\n\t日本語"
    assert printable(harmless) == harmless
    assert printable(EVIL) == ESCAPED
    assert one_line("a\nb") == r"a\nb"


def test_all_that_a_program_prints_is_printable() -> None:
    out = io.StringIO()
    error = io.StringIO()
    with redirect_stdout(out), redirect_stderr(error):
        with printable_output(), printable_output():
            print(EVIL)
            print(TwinmatchError(EVIL), file=sys.stderr)
            sys.stdout.writelines([EVIL])
            assert original(sys.stdout) is out
        assert sys.stdout is out
    assert out.getvalue() == f"{ESCAPED}\n{ESCAPED}"
    assert error.getvalue() == f"{ESCAPED}\n"


def test_a_table_and_a_view_have_the_consoles_own_control_sequences_alone() -> None:
    stream = io.StringIO()
    with redirect_stdout(stream), printable_output():
        console = Console(force_terminal=True, width=200, color_system="standard")
        assert console.file is stream
        table = Table("name")
        table.add_row(EVIL)
        console.print(table, Text(EVIL, style="red"), EVIL)
        screen = Screen(console, EVIL)
        screen.open()
        screen.say(EVIL, "red")
        screen.close()
        Lines(console=console).say(EVIL)
    shown = stream.getvalue()
    assert shown.count(r"\x1b]0;owned") >= 6  # rich itself leaves out bells
    assert shown.count(r"\x1b[2J\x9b31m\u202egnp.") >= 4
    assert "\x1b[31m" in shown  # a colour of the project
    for bad in ("\x1b]0;", "\x1b[2J", "\x9b", "\x07", "\u202e"):
        assert bad not in shown


def test_a_verdicts_texts_stay_in_their_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with printable_output():
        Lines().take_verdict(replace(LED, leader=f"a\n{EVIL}", reason=f"b\n{EVIL}"))
    printed = capsys.readouterr().out
    assert printed.count("\n") == 2
    assert printed.count(r"\x1b]0;owned") == 2
    assert "\x1b" not in printed


def test_names_in_a_foreign_bag_are_listed_escaped(tmp_path: Path) -> None:
    name = f"/a{TITLE}[/x]"
    with SessionWriter(tmp_path / "bag") as writer:
        writer.add_topic(SAMPLE._replace(name=name))
        for k in range(5):
            writer.write(
                name, encode_sample(Sample(k, k * 10**9, 1.0, 2.0, 3.0)), k * 10**9
            )
    for words in ((tmp_path / "bag", "--list"), (tmp_path / TITLE, "--list")):
        completed = run_twinmatch("import", *words)
        printed = completed.stdout + completed.stderr
        assert r"\x1b]0;owned" in printed
        assert not {"\x1b", "\x07"} & set(printed)
