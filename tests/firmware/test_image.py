"""The image that goes onto the board."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.damage import FUZZ, damaged_lines
from tests.support.places import PROJECT
from twinmatch.links.pwm_protocol import Damage, FrameReader, parse_request, seal

FLASH = 28_672
"""Bytes of an ATmega32U4 without its boot loader."""
MEMORY = 2_560


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if (
        shutil.which("avr-g++") is None
        or not Path("/usr/share/arduino/hardware/arduino/avr").exists()
    ):
        pytest.skip("no AVR toolchain; install gcc-avr, avr-libc and arduino-core-avr")
    build = tmp_path_factory.mktemp("firmware")
    command = ["make", "-s", "-C", str(PROJECT / "firmware"), f"BUILD={build}"]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr
    assert "warning" not in completed.stderr
    return build / "twinmatch_leonardo.elf"


def test_it_fits_with_room_for_the_stack(image: Path) -> None:
    sizes = subprocess.run(
        ["avr-size", "-B", image], capture_output=True, text=True, check=True
    ).stdout
    text, data, bss = map(int, sizes.splitlines()[1].split()[:3])
    assert text + data < 0.5 * FLASH
    assert data + bss < 0.5 * MEMORY


def test_the_hex_file_to_upload_is_there(image: Path) -> None:
    assert image.with_suffix(".hex").read_text().rstrip().endswith(":00000001FF")


def config(name: str) -> int:
    text = (PROJECT / "firmware" / "twinmatch_leonardo" / "config.h").read_text()
    match = re.search(rf"\b{name} = (\d+);", text)
    assert match is not None
    return int(match[1])


def test_host_and_firmware_agree_on_what_both_spell_out() -> None:
    from twinmatch.emulation.arduino import DEADLINE_MS, FULL_DRIVE_SECONDS, HOLD_PWM
    from twinmatch.links.pwm_protocol import PROTOCOL, PWM_LIMIT

    assert config("kProtocol") == PROTOCOL
    assert config("kDeadlineMs") == DEADLINE_MS
    assert config("kHoldPwm") == HOLD_PWM
    assert config("kFullDriveSeconds") == FULL_DRIVE_SECONDS
    assert config("kPwmLimit") == PWM_LIMIT


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("kDeadlineMs = 1000", "kDeadlineMs = 2500"),
        ("kDeadlineMs = 1000", "kDeadlineMs = 400"),
        ("kPwmTop = 799", "kPwmTop = 639"),
        ("kReversalMs = 2", "kReversalMs = 0"),
        ("kHoldPwm = 220", "kHoldPwm = 255"),
        ("kFullDriveSeconds = 480", "kFullDriveSeconds = 3600"),
    ],
)
def test_unsafe_settings_do_not_compile(
    tmp_path: Path, line: str, instead: str
) -> None:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler on this machine")
    text = (PROJECT / "firmware" / "twinmatch_leonardo" / "config.h").read_text()
    assert line in text
    for name, content, compiles in (
        ("good", text, True),
        ("bad", text.replace(line, instead), False),
    ):
        header = tmp_path / f"{name}.h"
        header.write_text(content)
        command = [compiler, "-std=c++11", "-fsyntax-only", "-x", "c++", str(header)]
        assert (
            subprocess.run(command, capture_output=True, check=False).returncode == 0
        ) is compiles


def test_the_line_to_try_by_hand_is_a_sound_one() -> None:
    from twinmatch.links.pwm_protocol import seal

    assert (
        f"`{seal('H 0').decode().strip()}`"
        in (PROJECT / "docs" / "rig" / "firmware.md").read_text()
    )


# The firmware's codec and ours, compiled and run on the same bytes.

HERE = Path(__file__).parent
SKETCH = HERE.parents[1] / "firmware" / "twinmatch_leonardo"


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler on this machine")
    program = tmp_path_factory.mktemp("codec") / "probe"
    sources = [HERE / "codec_probe.cpp", SKETCH / "frame.cpp", SKETCH / "request.cpp"]
    flags = [
        "-std=c++11",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-fsanitize=address,undefined",
    ]
    subprocess.run(
        [compiler, *flags, f"-I{SKETCH}", *map(str, sources), "-o", str(program)],
        check=True,
    )
    return program


def what_we_make_of(stream: bytes) -> list[str]:
    events = FrameReader().feed(stream)
    return [
        f"E - {e.value}" if isinstance(e, Damage) else str(parse_request(e))
        for e in events
    ]


def test_both_make_the_same_of_damaged_frames(probe: Path) -> None:
    stream = b"".join(
        line + b"\n" + seal("Q 9") for _, line in damaged_lines(FUZZ, seed=7)
    )
    # Sealed nonsense reaches the parser behind a right check sum.
    nonsense = "P 1 -0|P 1 256|P 1 99999|P 1 100000|Q 65536|Q 01|X 1|  1|P 1 5 |H"
    stream += b"".join(map(seal, nonsense.split("|")))
    completed = subprocess.run(
        [str(probe)], input=stream, capture_output=True, check=True
    )
    answers = completed.stdout.decode().split("\n")
    ours = what_we_make_of(stream)
    assert answers[: len(ours)] == ours
    assert (
        answers[len(ours)] == seal("S 65535 4294967295 -255 1023 255").decode().strip()
    )
    assert answers[len(ours) + 1] == "29B1"
