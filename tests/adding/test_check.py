"""What `check-plant` says, of units too: of plants that are right, and of every mistake it is made for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.exchanging import Heaters
from tests.support.plant_files import plant_file
from tests.support.plants import Lag, Motor, Tank
from tests.support.processes import run_twinmatch
from tests.support.servo import Servo
from twinmatch.adding import CheckedPlant, check_plant
from twinmatch.adding.check import ranges
from twinmatch.adding.dimensions import Dimensions
from twinmatch.adding.trial import inseparable, time_constants
from twinmatch.cli import main
from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)
from twinmatch.plants import PLANTS, Peltier, find_plant


class Fan(Plant, name="fan"):
    """A speed that follows a power of a voltage, which begins at 0."""

    speed = Output(unit="1/s", noise=0.5, span=(-10.0, 200.0))
    volts = Drive(unit="V", limits=(0.0, 5.0), noise=0.01)
    omega = State(unit="1/s", span=(-10.0, 200.0))
    acts = State(unit="V", span=(0.0, 5.0))
    gain = Parameter(unit="1/s", default=10.0, bounds=(1.0, 100.0), positive=True)
    one = Parameter(unit="V", default=1.0, bounds=(0.5, 2.0), positive=True)
    power = Parameter(default=1.5, bounds=(1.0, 4.0), positive=True)
    lag = Parameter(unit="s", default=1.0, bounds=(0.1, 10.0), positive=True)
    slow = Parameter(unit="s", default=0.3, bounds=(0.05, 3.0), positive=True)
    structures = {"all": Structure(free=("gain", "power", "lag", "slow"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        thrust = self.gain * (self.acts / self.one) ** self.power
        rates = {
            self.omega: (thrust - self.omega) / self.lag,
            self.acts: (self.volts - self.acts) / self.slow,
        }
        return Equations(
            rates=rates, output=self.omega, start={self.omega: self.speed, self.acts: 0}
        )


class Reversing(Fan, name="reversing"):
    """The same under a voltage of either sign."""

    volts = Drive(unit="V", limits=(-5.0, 5.0), noise=0.01)
    acts = State(unit="V", span=(-5.0, 5.0))


class Twice(Plant, name="twice"):
    """A lag whose parameters are seen only in combinations, each structure in another way."""

    y = Output(unit="1", noise=0.01, span=(-100.0, 100.0))
    u = Drive(unit="1", limits=(-1.0, 1.0), noise=0.1)
    x = State(unit="1", span=(-50.0, 50.0))
    a = Parameter(unit="1", default=2.0, bounds=(0.1, 10.0), positive=True)
    b = Parameter(unit="1", default=3.0, bounds=(0.1, 10.0), positive=True)
    c = Parameter(unit="s", default=4.0, bounds=(0.1, 10.0), positive=True)
    unseen = Parameter(unit="1", default=4.0, bounds=(0.1, 10.0), positive=True)
    idle = Parameter(unit="1", default=4.0, bounds=(0.1, 10.0), positive=True)
    parts = ("ratio", "product", "growing")
    structures = {  # noqa: RUF012
        "plain": Structure(free=("a", "c")),
        "ratio": Structure(free=("a", "b"), parts=frozenset({"ratio"})),
        "product": Structure(free=("a", "b", "c"), parts=frozenset({"product"})),
        "growing": Structure(free=("a", "b", "c"), parts=frozenset({"growing"})),
        "unseen": Structure(free=("a", "unseen")),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        drive = self.a * self.u + 0 * self.b
        rate = (drive - self.x) / self.c
        if "ratio" in parts:
            rate = (self.a / self.b * self.u - self.x) / self.c
        if "product" in parts:
            rate = (self.a * self.b * self.u - self.x) / self.c
        if "growing" in parts:
            rate = (self.a * self.u - self.b * self.x) / self.c
        # A parameter that is in the equations and yet not in what they say.
        rate += self.unseen * ((self.u + 1) ** 2 - self.u**2 - 2 * self.u - 1)
        return Equations(rates={self.x: rate}, output=self.x, start={self.x: self.y})


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        ("plain", ""),
        ("ratio", "no data can determine b and a separately, only b/a"),
        ("product", "no data can determine b and a separately, only b·a"),
        ("growing", "no data can determine c, a and b separately, only their ratios"),
        ("unseen", "the output does not depend on unseen, which is free"),
    ],
)
def test_what_no_data_can_tell_apart_is_named(structure: str, message: str) -> None:
    findings = [finding.what for finding in inseparable(Twice.model(structure))]
    assert len(findings) == bool(message)
    assert all(sentence.endswith(message) for sentence in findings)


def test_time_constants_are_those_of_the_equations() -> None:
    np.testing.assert_allclose(
        time_constants(Lag.model().parameters(lag=7.0)), [7.0], rtol=1e-12
    )


def test_a_plant_without_mistakes_has_no_findings() -> None:
    shown: list[tuple[str, int, int]] = []
    checked = check_plant(Lag, 1.0, lambda *what: shown.append(what))
    assert checked.findings == ()
    total = len(Lag.structures) + 1
    assert [progress for _, *progress in shown] == [
        [count, total] for count in range(total)
    ]
    assert shown[-1][0].startswith("checking structure ")
    assert checked.exit_code == 0
    assert checked.notes == ("time constants at the defaults: 5 s",)


def test_how_far_an_angle_goes_is_not_a_contradiction() -> None:
    """Nothing pulls the shaft back: over the drive's range it turns as long as it is let."""

    class Narrow(Servo, name="narrow_servo"):
        angle = Output(unit="deg", noise=0.06, span=(-180.0, 180.0))
        phi = State(unit="deg", span=(-180.0, 180.0))

    assert not [*ranges(Narrow.model("free"))]

    class Slow(Servo, name="slow_servo"):
        omega = State(unit="deg/s", span=(-10.0, 10.0))

    (finding,) = ranges(Slow.model("free"))
    assert "state omega goes from" in finding.what


def test_a_power_of_a_state_that_begins_at_zero_is_not_a_finding() -> None:
    """Its slope is 0/0 there for SymPy, which writes power·acts**power/acts."""
    checked = check_plant(Fan, 0.05)
    assert (checked.unusable, checked.findings) == ("", ())


def test_a_power_whose_base_may_be_negative_comes_with_what_to_write() -> None:
    refusal = check_plant(Reversing, 0.05).unusable
    assert (
        "where acts/one is negative; write maximum(acts/one, 1e-6)**(power), or to keep the sign"
        in refusal
    )


def test_what_several_structures_share_is_said_once() -> None:
    sentences = [finding.what for finding in check_plant(Twice, 500.0).findings]
    slow = [sentence for sentence in sentences if "shortest time constant" in sentence]
    assert len(slow) == 1
    assert slow[0].startswith("structures 'plain', 'ratio', 'product'")


def checked_file(
    folder: Path, name: str, *changes: tuple[str, str], period: float | None = None
) -> CheckedPlant:
    return check_plant(find_plant(str(plant_file(folder, name, *changes))), period)


SHELL = (
    "    gain =",
    '    shell = State(unit="°C", span=(0.0, 110.0))\n'
    '    tau = Parameter(unit="s", default=9.0, bounds=(1.0, 99.0), positive=True)\n    gain =',
)
SHELL_START = ("start={", "start={self.shell: self.temperature, ")
HOT = (
    'gain = Parameter(unit="W/%", default=0.5',
    'gain = Parameter(unit="W/%", default=4.0',
)


@pytest.mark.parametrize(
    ("changes", "period", "message"),
    [
        ([HOT], None, "the output goes from .* beyond its span -10 to 120"),
        ([HOT], None, "state block goes from .* beyond its span 0 to 110"),
        ([], 500.0, "its slowest time constant, .* s, is below the period of 500 s"),
        ([("default=100.0", "default=10000.0")], None, "default of capacity, 10000, is outside its bounds "
            "10 to 1000"),
        (
            [("noise=0.1", "noise=10.0")],
            None,
            "temperature: with a noise of 10 °C, a step that stands out is 200 °C, more than its span",
        ),
        ([], 1e-4, "its slowest time constant, 100 s, is 1e.06 periods of 0.0001 s: no window can show it"),
        ([("- lost)", "+ lost)")], None, "it is unstable at its defaults: deviations grow by e in 100 s"),
        ([("self.gain * self.heater", "self.gain * self.room")], None, "the drive heater does not act on"),
        ([SHELL, SHELL_START, ("rates={", "rates={self.shell: (self.block - self.shell) / self.tau, ")], None,
         "state shell does not act on the output, so no recording can show it"),
        ([("structures", 'parts = ("sun",)\n    structures')], None, "part 'sun': no structure has it"),
        ([("structures = {", 'parts = ("sun",)\n    structures = {"sunny": Structure(free=("gain",), '
           'parts=frozenset({"sun"})), ')], None, "structures 'sunny' and 'block' have the same equations"),
        ([("structures", 'extra = Parameter(default=1.0, bounds=(0.0, 2.0))\n    structures')], None,
         "parameter extra: no structure depends on it"),
        ([('loss = Parameter(unit="W/K", default=1.0, bounds=(0.1, 10.0), positive=True)',
           'loss = Parameter(unit="W/K", default=1.0, bounds=(-10.0, 10.0))'),
          ('free=("gain", ', 'free=("loss", ')], None, "cannot be simulated at"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported(
    tmp_path: Path, changes: list[tuple[str, str]], period: float | None, message: str
) -> None:
    name = f"checked_{crc32(repr((changes, message)).encode())}"
    checked = checked_file(tmp_path, name, *changes, period=period)
    assert checked.exit_code == 1
    assert any(re.search(message, finding.what) for finding in checked.findings), (
        checked
    )
    assert all(finding.todo for finding in checked.findings)


class FastAndSlow(Plant, name="fast_and_slow"):
    """Oxygen that follows within seconds, beside a level that takes hours."""

    oxygen = Output(unit="%", noise=0.05, span=(-50.0, 50.0))
    level = Output(unit="m", noise=0.02, span=(-50.0, 50.0))
    air = Drive(unit="1", limits=(0.0, 1.0), noise=0.01)
    water = Drive(unit="1", limits=(0.0, 1.0), noise=0.01)
    gas = State(unit="%", span=(-50.0, 50.0))
    drum = State(unit="m", span=(-50.0, 50.0))
    quick = Parameter(unit="s", default=5.0, bounds=(1.0, 25.0), positive=True)
    slow = Parameter(unit="s", default=11e3, bounds=(1e3, 1e5), positive=True)
    ratio = Parameter(unit="1", default=1.0, bounds=(0.1, 10.0), positive=True)
    structures = {  # noqa: RUF012
        "lags": Structure(free=("quick", "slow")),
        "lags and ratio": Structure(free=("quick", "slow", "ratio")),
    }

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        rates = {
            self.gas: (18.0 * self.air - self.gas) / (self.quick * self.ratio),
            self.drum: (20.0 * self.water - self.drum) / self.slow,
        }
        return Equations(
            rates=rates,
            output={self.oxygen: self.gas, self.level: self.drum},
            start={self.gas: self.oxygen, self.drum: self.level},
        )


def test_a_lag_that_is_over_before_the_slowest_has_begun_is_seen() -> None:
    """Sampled by the slowest time constant, "the output does not depend on" a lag of 5 s."""
    assert inseparable(FastAndSlow.model("lags")) == []
    (finding,) = inseparable(FastAndSlow.model("lags and ratio"))
    assert "ratio and quick separately" in finding.what


@pytest.mark.parametrize("period", [None, 10.0])
def test_a_stiff_plant_is_usable(tmp_path: Path, period: float | None) -> None:
    """A block of 1e5 s behind a shell of 3 s: its trial takes shorter samples than the block needs."""
    shell = (
        SHELL[0],
        SHELL[1].replace(
            "default=9.0, bounds=(1.0, 99.0)", "default=3.0, bounds=(1.0, 9.0)"
        ),
    )
    shell_rate = (
        "rates={",
        "rates={self.shell: (self.block - self.shell) / self.tau, ",
    )
    heavy = ("default=100.0, bounds=(10.0, 1000.0)", "default=1e5, bounds=(1e4, 1e6)")
    shown = ("output=self.block", "output=self.shell")
    checked = checked_file(
        tmp_path,
        f"checked_stiff_{period or 0:.0f}",
        shell,
        SHELL_START,
        shell_rate,
        heavy,
        shown,
        period=period,
    )
    assert (checked.unusable, checked.findings) == ("", ())


def test_a_state_is_seen_through_another(tmp_path: Path) -> None:
    change = (
        "rates={self.block: (",
        "rates={self.shell: (self.block - self.shell) / self.tau, self.block: (",
    )
    coupled = ("- lost)", "- lost + self.loss * (self.shell - self.block))")
    checked = checked_file(
        tmp_path, "checked_seen", SHELL, SHELL_START, change, coupled
    )
    assert checked.findings == ()


def test_a_disturbance_in_no_equation_is_noted(tmp_path: Path) -> None:
    sun = ("    room =", '    sun = Disturbance(unit="W", default=0.0)\n    room =')
    checked = checked_file(tmp_path, "checked_sun", sun)
    assert checked.findings == ()
    assert "disturbance sun: in no equation" in checked.notes


def test_a_plant_that_cannot_be_run_is_unusable(tmp_path: Path) -> None:
    checked = checked_file(
        tmp_path,
        "checked_unusable",
        ("start={self.block: self.temperature}", "start={}"),
    )
    assert checked.exit_code == 2
    assert "state block has no start value" in checked.unusable


def test_the_command_says_it_and_its_exit_code_too(tmp_path: Path) -> None:
    good = run_twinmatch("check-plant", plant_file(tmp_path, "checked_good"))
    assert good.returncode == 0, good.stdout + good.stderr
    assert "no problems found" in good.stdout
    wrong = ('free=("gain", "capacity")', 'free=("gain", "capacity", "loss")')
    with_finding = run_twinmatch(
        "check-plant", plant_file(tmp_path, "checked_found", wrong)
    )
    assert with_finding.returncode == 1
    assert "separately, only their ratios" in with_finding.stdout
    assert "→ remove one of them from `free`" in with_finding.stdout
    broken = run_twinmatch(
        "check-plant",
        plant_file(tmp_path, "checked_broken", ("self.loss *", "self.los *")),
    )
    assert broken.returncode == 2
    assert "did you mean loss?" in broken.stderr
    assert len(broken.stderr.strip().splitlines()) == 1


def unit_findings(plant: type[Plant]) -> list[str]:
    looked = Dimensions(plant)
    for structure in plant.structures.values():
        looked.check(structure.parts)
    return [finding.what for finding in looked.findings.values()]


def test_columns_of_a_recording_are_named_and_mapped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        "clock,plate,duty\n" + "".join(f"{k},30,0\n" for k in range(90)),
        encoding="utf-8",
    )
    asked = ["check-plant", "peltier", "--data", str(log)]
    assert main(asked) == 2
    printed_error = capsys.readouterr().err
    assert (
        "add --map time=COLUMN output=COLUMN input=COLUMN; its columns are 'clock', 'plate', 'duty'"
        in printed_error
    )
    for words in (["--map", "time=clock"], ["--period", "1", "--map"]):
        assert main([*asked, *words, "output=plate", "input=duty"]) == 1
        assert "no window could be matched" in capsys.readouterr().out


@pytest.mark.parametrize(
    "plant", [Lag, Motor, Tank, *PLANTS.values()], ids=lambda plant: plant.name
)
def test_plants_whose_units_are_right_pass(plant: type[Plant]) -> None:
    assert unit_findings(plant) == []


def test_a_file_whose_units_are_right_passes(tmp_path: Path) -> None:
    assert unit_findings(find_plant(str(plant_file(tmp_path, "units_right")))) == []


SINK = "self.loss * (self.block - self.room)"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'gain = Parameter(unit="W/%"',
            'gain = Parameter(unit="V/%"',
            "rate of block: .* added to .* in V",
        ),
        (
            'unit="J/K", default=100',
            'unit="J", default=100',
            "rate of block: .* unit s.*, but needs °C per second",
        ),
        (
            'loss = Parameter(unit="W/K"',
            'loss = Parameter(unit="kW/K"',
            "0.001 times the unit|1000 times the unit",
        ),
        (
            'capacity = Parameter(unit="J/K"',
            'capacity = Parameter(unit="kJ/K"',
            "has 0.001 times the unit °C per",
        ),
        (
            'State(unit="°C"',
            'State(unit="K"',
            "block is in K and room in °C|room is in °C and block in K",
        ),
        (
            "self.block: self.temperature}",
            "self.block: self.temperature**2}",
            "the start of block",
        ),
        (
            "self.gain * self.heater",
            "self.gain * self.room**100000",
            "added to or compared",
        ),
        (
            "output=self.block",
            "output=self.block * self.loss",
            "the output: has the unit W, but needs °C",
        ),
        (SINK, "self.loss * (self.block**4 - self.room**4)", "a power of"),
        (SINK, f"{SINK} * __import__('sympy').exp(self.block)", "has the unit K"),
    ],
)
def test_units_that_are_wrong_are_reported(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    name = f"units_wrong_{crc32(repr((old, new)).encode())}"
    sentences = unit_findings(find_plant(str(plant_file(tmp_path, name, (old, new)))))
    assert any(re.search(message, sentence) for sentence in sentences), sentences


def test_the_size_of_a_high_power_is_not_judged(tmp_path: Path) -> None:
    # (0.01)**100000 underflows
    change = ("self.gain * self.heater", "self.gain * self.heater**100000")
    assert (
        unit_findings(find_plant(str(plant_file(tmp_path, "units_high", change)))) == []
    )


def test_what_a_number_hides_is_not_judged_but_noted(tmp_path: Path) -> None:
    plant = find_plant(
        str(
            plant_file(
                tmp_path, "units_hidden", ("self.loss * (", "0.0123 * self.loss * (")
            )
        )
    )
    looked = Dimensions(plant)
    looked.check(frozenset())
    assert looked.findings == {}
    assert looked.unchecked in ({"0.0123"}, {"-0.0123"})


def test_the_roots_in_a_dead_time_hide_no_unit(tmp_path: Path) -> None:
    name = "units_root"
    change = ("self.loss * (", "sqrt(3) * self.loss * (")
    path = plant_file(tmp_path, name, change)
    path.write_text(
        path.read_text().replace("\nclass", "\nfrom sympy import sqrt\n\nclass", 1)
    )
    looked = Dimensions(find_plant(str(path)))
    looked.check(frozenset())
    assert looked.unchecked == set()


def test_units_that_no_table_knows_are_named() -> None:
    assert Dimensions(Tank).unknown_units == []
    assert Dimensions(Peltier).unknown_units == ["PWM"]


UNITS = ("s", "min", "K", "m", "kg", "V", "A", "W", "1", "%", "J/K", "m²")


@given(st.sampled_from(UNITS), st.sampled_from(UNITS), st.sampled_from(UNITS))
def test_a_lag_whose_units_are_made_to_fit_passes_whatever_they_are(
    y: str, u: str, x: str
) -> None:
    class Any(Plant, name="any_units"):
        out = Output(unit=y, noise=0.1, span=(-1.0, 1.0))
        drive = Drive(unit=u, limits=(-1.0, 1.0), noise=0.1)
        inside = State(unit=x, span=(-1.0, 1.0))
        seen = Parameter(unit=f"({y})/({x})", default=1.0, bounds=(0.1, 10.0))
        gain = Parameter(unit=f"({x})/({u})", default=1.0, bounds=(0.1, 10.0))
        lag = Parameter(unit="s", default=1.0, bounds=(0.1, 10.0))
        structures = {"any": Structure(free=("gain",))}  # noqa: RUF012

        def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
            return Equations(
                rates={self.inside: (self.gain * self.drive - self.inside) / self.lag},
                output=self.seen * self.inside,
                start={self.inside: self.out / self.seen},
            )

    assert unit_findings(Any) == []


def test_plants_with_several_loops_are_checked_signal_by_signal() -> None:
    checked = check_plant(PLANTS["tclab-both"], 1.0)
    assert checked.findings == ()
    assert checked.notes[-1] == (
        "faults that cannot be told apart, even under large steps (a sample every 1 s): "
        "losses (convection to the room) and temperature of the room"
    )

    class Idle(Heaters, name="idle"):
        def equations(self, parts: frozenset[str]) -> Equations:
            whole = super().equations(parts)
            return replace(
                whole,
                rates={s: r.subs(self.second_power, 0) for s, r in whole.rates.items()},
            )

    checked_idle = check_plant(Idle, 2.0)
    sentence = "structures 'all' and 'apart': the drive second_power does not act on the output"
    assert sentence in [finding.what for finding in checked_idle.findings]
    assert "second_gain is free, but does not occur" in checked_idle.unusable
