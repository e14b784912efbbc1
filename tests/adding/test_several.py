"""`new-plant` for several outputs and inputs; each command takes what the one before has advised."""

from __future__ import annotations

import re
import runpy
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.literature import (
    Recorded,
    evaporator,
    furnace,
    quadruple_tank,
    three_tanks,
)
from tests.support.plants import Lag
from twinmatch.adding import check_plant, files_of, propose
from twinmatch.adding.data import compare_structures
from twinmatch.adding.proposal import range_of
from twinmatch.adding.several import propose_several
from twinmatch.cli import main
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.importing.column_map import columns_of, of_all_loops, proposed
from twinmatch.importing.table_files import open_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import SignalMap, parse_map
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import TwinSettings


def written(path: Path, columns: dict[str, FloatArray]) -> Path:
    rows = [
        ",".join(f"{value:.6g}" for value in row)
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


def held(levels: list[float], samples: int, each: int) -> FloatArray:
    return np.resize(np.repeat(levels, each), samples).astype(np.float64)


def lagged(steady: FloatArray, lag: float, start: float, seed: int) -> FloatArray:
    """A lag of a steady state, at samples 1 s apart, with noise of 0.05."""
    value = start
    values = []
    for level in steady:
        values.append(value)
        value += (level - value) / lag
    return np.array(values) + 0.05 * np.random.default_rng(seed).standard_normal(
        steady.size
    )


def two_zones(path: Path) -> Path:
    """Two zones, each with a heater that warms the other a little."""
    left = held([0, 60, 20, 80, 40, 0], 1200, 150)
    right = held([30, 0, 70, 10, 50], 1200, 110)
    return written(path, {
        "time (s)": np.arange(1200.0),
        "left (degC)": lagged(20 + 0.5 * left + 0.1 * right, 60.0, 20.0, 1),
        "right (degC)": lagged(20 + 0.1 * left + 0.4 * right, 90.0, 20.0, 2),
        "left_pwm (%)": left,
        "right_pwm (%)": right,
    })  # fmt: skip


def two_relays(path: Path, *, cool_moves: bool = True) -> Path:
    """A tank with one relay that heats, and one that cools, or that moves nothing."""
    random = np.random.default_rng(3)
    heat = np.repeat(random.integers(0, 2, 40), 30).astype(np.float64)
    cool = np.repeat(random.integers(0, 2, 40), 30).astype(np.float64)
    steady = 20 + 40 * heat - 30 * cool * cool_moves
    columns = {"time": np.arange(1200.0), "Temp (degC)": lagged(steady, 100.0, 20.0, 4)}
    return written(path, columns | {"heat": heat, "cool": cool})


ZONES = [
    "time=time",
    "output.1=left",
    "output.2=right",
    "input.1=left_pwm",
    "input.2=right_pwm",
]


def test_gains_and_lags_of_several_loops_are_near_the_truth(tmp_path: Path) -> None:
    proposal = propose_several(
        open_table(two_zones(tmp_path / "zones.csv")), parse_map(ZONES)
    )
    assert [output.signal.name for output in proposal.outputs] == ["left", "right"]
    assert [u.name for u in proposal.inputs] == ["left_pwm", "right_pwm"]
    for output, gains, lag in zip(
        proposal.outputs, [(0.5, 0.1), (0.1, 0.4)], (60.0, 90.0), strict=True
    ):
        # Least squares over blocks: some percent of the largest gain.
        assert output.gains == pytest.approx(gains, abs=0.05)
        assert output.lag == pytest.approx(lag, rel=0.2)
        assert output.signal.unit == "°C"


def two_stores(path: Path) -> Path:
    """Two stores that heaters switch about, and that lose next to nothing: neither shows where it would rest."""
    random = np.random.default_rng(8)
    heats = np.repeat(random.integers(0, 2, (2, 80)), 30, axis=1).astype(np.float64)
    noise = 0.05 * random.standard_normal((2, 2400))
    heated = heats - np.mean(heats, axis=1, keepdims=True)
    readings = np.cumsum(np.array([[0.1], [0.2]]) * heated, axis=1) + noise
    return written(path, {
        "time (s)": 60.0 * np.arange(2400.0),
        "room (degC)": 20.0 + readings[0],
        "water (degC)": 48.0 + readings[1],
        "heating": heats[0],
        "boiler": heats[1],
    })  # fmt: skip


def test_lags_that_the_recording_does_not_show_set_no_period_and_are_not_fitted(
    tmp_path: Path,
) -> None:
    """A house of two such stores got a period of 2000 s by a lag of 130 000 s, and no match with any."""
    words = ["time=time", "output.1=room", "output.2=water"]
    words += ["input.1=heating", "input.2=boiler"]
    proposal = propose_several(
        open_table(two_stores(tmp_path / "house.csv")), parse_map(words)
    )
    assert [output.rests for output in proposal.outputs] == [False, False]
    assert proposal.period == 60.0
    of_water = next(note for note in proposal.notes if "which level water" in note)
    assert "under constant inputs" in of_water
    assert "without `- self.inner_2`" in of_water
    text = files_of("two_stores", proposal)["two_stores.py"]
    free = re.search(r"free=\(([^)]*)\)", text)
    assert free is not None
    assert "gain_2_2" in free[1]
    assert "lag" not in free[1]
    # each heater alone moves its store, by its rate: gain / lag
    for output, number, rate in zip(proposal.outputs, (0, 1), (0.1, 0.2), strict=True):
        assert output.gains[number] / output.lag * 60.0 == pytest.approx(rate, rel=0.1)


def test_a_lag_under_random_steps_is_near_the_truth_with_readings_that_are_noisy(
    tmp_path: Path,
) -> None:
    """Blocks of rows are long where readings are noisy: what an input did in the second of two blocks passed
    for a way back, and a lag of 600 s for 340 s."""
    random = np.random.default_rng(5)
    inputs = np.repeat(random.integers(0, 2, (2, 80)), 30, axis=1).astype(np.float64)
    noise = 0.25 * random.standard_normal(2400)
    columns = {
        "time (s)": np.arange(2400.0),
        "warm (degC)": lagged(20 + 60 * inputs[0], 600.0, 50.0, 1) + noise,
        "cold (degC)": lagged(20 - 60 * inputs[1], 600.0, -10.0, 2) + noise,
        "heater": inputs[0],
        "cooler": inputs[1],
    }
    words = ["time=time", "output.1=warm", "output.2=cold"]
    words += ["input.1=heater", "input.2=cooler"]
    path = written(tmp_path / "both.csv", columns)
    proposal = propose_several(open_table(path), parse_map(words))
    for output in proposal.outputs:
        assert output.rests
        assert output.lag == pytest.approx(600.0, rel=0.15)


def test_a_fitted_lag_is_one_that_the_recording_shows(tmp_path: Path) -> None:
    proposal = propose_several(
        open_table(two_zones(tmp_path / "zones.csv")), parse_map(ZONES)
    )
    assert all(output.rests for output in proposal.outputs)
    text = files_of("two_lags", proposal)["two_lags.py"]
    assert text.count('"lag_') == 2


def test_the_files_of_several_loops_have_no_findings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    proposal = propose_several(
        open_table(two_zones(tmp_path / "zones.csv")), parse_map(ZONES)
    )
    for name, text in files_of("zones_of_two", proposal).items():
        (tmp_path / name).write_text(text)
    assert check_plant(find_plant("zones_of_two.py")).findings == ()
    runpy.run_path("test_zones_of_two.py")["test_its_parameters_are_recovered"]()


@pytest.mark.parametrize("process", [three_tanks, quadruple_tank, evaporator])
def test_files_of_processes_whose_inputs_add_up_have_no_findings(
    process: Callable[[], Recorded], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all inputs at the ends that raise an output, it goes farther than with one of them: `check-plant`
    accused the span that `new-plant` had written."""
    monkeypatch.chdir(tmp_path)
    recorded = process()
    name = f"spans_of_{process.__name__}"
    signal_map = parse_map(recorded.write(tmp_path / "log.csv"))
    proposal = propose_several(open_table(tmp_path / "log.csv"), signal_map)
    for file_name, text in files_of(name, proposal).items():
        (tmp_path / file_name).write_text(text)
    assert check_plant(find_plant(f"{name}.py")).findings == ()


def test_signals_with_short_titles_keep_them(tmp_path: Path) -> None:
    """What is said of `output_1` has to be looked up; h1 has not."""
    recorded = three_tanks(600)
    titles = ["time", "h1", "pH", "T_3", "u", "Q2"]
    columns = [
        2.0 * np.arange(600.0),
        *recorded.outputs.T,
        *recorded.inputs.T,
    ]
    path = written(tmp_path / "tanks.csv", dict(zip(titles, columns, strict=True)))
    roles = ["time", "output.1", "output.2", "output.3", "input.1", "input.2"]
    signal_map = parse_map([f"{r}={t}" for r, t in zip(roles, titles, strict=True)])
    proposal = propose_several(open_table(path), signal_map)
    names = [output.signal.name for output in proposal.outputs]
    assert names == ["h1", "ph", "t_3"]
    assert [u.name for u in proposal.inputs] == ["input_1", "q2"]


@pytest.mark.parametrize(
    ("low", "high", "limits"),
    [
        (91.0, 109.0, (0.0, 255.0)),
        (0.0, 103.0, (0.0, 103.0)),
        (-40.0, 103.0, (-100.0, 103.0)),
        (20.0, 240.0, (0.0, 255.0)),
    ],
)
def test_what_is_never_negative_has_no_negative_limit(
    low: float, high: float, limits: tuple[float, float]
) -> None:
    assert range_of(np.array([low, high])) == limits


def test_inputs_far_from_zero_count_from_their_middles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two reactors and their coolants in kelvin: without centres the rests are far below absolute zero, and no
    window tells them from the gains."""
    monkeypatch.chdir(tmp_path)
    left = held([300, 302, 299, 303, 297], 1200, 150)
    right = held([310, 306, 312, 309], 1200, 110)
    steady = 1.8 * (left - 300.0) + 0.4 * (right - 309.0)
    path = written(tmp_path / "reactors.csv", {
        "time (s)": np.arange(1200.0),
        "Left [K]": lagged(325.0 + steady, 60.0, 325.0, 1),
        "Right [K]": lagged(340.0 + 1.2 * (right - 309.0), 90.0, 340.0, 2),
        "LeftCoolant [K]": left,
        "RightCoolant [K]": right,
    })  # fmt: skip
    named = [
        "time=time",
        "output.1=Left",
        "output.2=Right",
        "input.1=LeftCoolant",
        "input.2=RightCoolant",
    ]
    proposal = propose_several(open_table(path), parse_map(named))
    assert proposal.centres == pytest.approx((300.0, 309.0), abs=3.0)
    for output, rest in zip(proposal.outputs, (325.0, 340.0), strict=True):
        # The centres are up to 3 K from the truth's, and gains up to 1.8.
        assert output.rest == pytest.approx(rest, abs=6.0)
        assert 250.0 < output.signal.low < output.signal.high < 420.0
    for name, text in files_of("reactors", proposal).items():
        (tmp_path / name).write_text(text)
    assert check_plant(find_plant("reactors.py")).findings == ()
    runpy.run_path("test_reactors.py")["test_its_parameters_are_recovered"]()


def test_a_table_of_two_loops_gives_the_map_of_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    two_zones(Path("zones.csv"))
    assert main(["new-plant", "zones_left", "--from", "zones.csv"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = [
        line for line in lines if line.startswith("The table has signals of 2 loops")
    ]
    given_map = shlex.split(line.partition("--map ")[2])
    assert (
        main(["new-plant", "zones_both", "--from", "zones.csv", "--map", *given_map])
        == 0
    )
    assert sorted(find_plant("zones_both.py").outputs) == ["left", "right"]


def guess(path: Path) -> dict[str, str]:
    table = open_table(path)
    return {
        signal: source.text
        for signal, source in proposed(columns_of(table), table).items()
    }


def test_two_relays_are_two_inputs_if_the_output_moves_with_both(
    tmp_path: Path,
) -> None:
    expected = {
        "time": "time",
        "output": "Temp (degC)",
        "input.1": "heat",
        "input.2": "cool",
    }
    assert guess(two_relays(tmp_path / "relays.csv")) == expected
    assert guess(two_relays(tmp_path / "one.csv", cool_moves=False))["input"] == "heat"


def test_of_two_things_the_signals_of_one_are_taken(tmp_path: Path) -> None:
    k = np.arange(600.0)
    bed = held([0, 60, 40], 600, 200)
    nozzle = held([0, 200, 220, 210], 600, 150)
    path = written(tmp_path / "printer.csv", {
        "time (s)": k,
        "bed_target": bed,
        "bed (degC)": lagged(bed, 50.0, 20.0, 1),
        "bed_pwm": bed / 100 + 0.01 * np.sin(k),
        "nozzle_target": nozzle,
        "nozzle (degC)": lagged(nozzle, 20.0, 20.0, 2),
        "nozzle_pwm": nozzle / 300 + 0.01 * np.cos(k),
    })  # fmt: skip
    signals = guess(path)
    thing = signals["output"].split()[0]
    assert signals == {
        "time": "time (s)",
        "output": f"{thing} (degC)",
        "input": f"{thing}_pwm",
        "reference": f"{thing}_target",
    }


@pytest.mark.parametrize(
    ("titles", "pairs"),
    [
        (
            ["TIC1.PV (°C)", "TIC1.SP (°C)", "TIC1.OP (%)", "TIC2.PV (°C)", "TIC2.SP (°C)", "TIC2.OP (%)"],
            ["TIC1.PV (°C)", "TIC1.OP (%)", "TIC2.PV (°C)", "TIC2.OP (%)"],
        ),
        (
            ["Zone1 PV", "Zone1 SP", "Zone1 OUT", "Zone2 PV", "Zone2 SP", "Zone2 OUT"],
            ["Zone1 PV", "Zone1 OUT", "Zone2 PV", "Zone2 OUT"],
        ),
        (
            ["Zone1 (°C)", "SP1 (°C)", "OP1 (%)", "Zone2 (°C)", "SP2 (°C)", "OP2 (%)"],
            ["Zone1 (°C)", "OP1 (%)", "Zone2 (°C)", "OP2 (%)"],
        ),
        (
            ["level_1", "sp_1", "mv_1", "level_2", "sp_2", "mv_2"],
            ["level_1", "mv_1", "level_2", "mv_2"],
        ),
        (  # each input moves both
            ["Level 1 [cm]", "", "Pump 1 [V]", "Level 2 [cm]", "", "Pump 2 [V]"],
            ["Level 1 [cm]", "Pump 1 [V]", "Level 2 [cm]", "Pump 2 [V]"],
        ),
    ],
)  # fmt: skip
def test_loops_of_a_control_system_and_outputs_with_shared_inputs_are_paired(
    tmp_path: Path, titles: list[str], pairs: list[str]
) -> None:
    inputs = [held([20, 60, 40], 600, 100), held([30, 30, 70, 50], 600, 150)]
    outputs = [lagged(inputs[i] + 0.5 * inputs[1 - i], 20.0, 20.0, i) for i in (0, 1)]
    columns = {"time (s)": np.arange(600.0)}
    for loop in (0, 1):
        signals = (outputs[loop], np.full(600, 50.0), inputs[loop])
        for title, signal in zip(titles[3 * loop :], signals, strict=False):
            if title:
                columns[title] = signal
    table = open_table(written(tmp_path / "loops.csv", columns))
    several = of_all_loops(columns_of(table), proposed(columns_of(table), table))
    signals_of_loops = ("output.1", "input.1", "output.2", "input.2")
    assert [several[signal].text for signal in signals_of_loops] == pairs


def test_of_a_cell_the_current_is_the_input(tmp_path: Path) -> None:
    current = held([-30, 20, 0, -10], 800, 100)
    columns = {"Time(s)": np.arange(800.0), "Current(A)": current}
    path = written(
        tmp_path / "cell.csv",
        columns | {"Voltage(V)": lagged(3.5 + 0.01 * current, 30.0, 3.5, 1)},
    )
    assert guess(path) == {
        "time": "Time(s)",
        "output": "Voltage(V)",
        "input": "Current(A)",
    }


@pytest.mark.parametrize(
    "title", ["SetTemp", "T_soll", "target temperature", "SV", "temp set"]
)
def test_a_set_point_is_not_an_input(tmp_path: Path, title: str) -> None:
    wanted = held([20, 40, 30], 600, 200)
    columns = {
        "time": np.arange(600.0),
        "temp": lagged(wanted, 30.0, 20.0, 1),
        title: wanted,
    }
    signals = guess(written(tmp_path / "log.csv", columns))
    assert signals == {"time": "time", "output": "temp", "reference": title}


def one_loop(path: Path, kind: str) -> Path:
    """A heater's log: `limits` reaches 101, `gap` has a pause, `pace` slows down at rest, `fine` is fine."""
    size = 2400 if kind == "fine" else 900
    u = held([0, 60, 101], size, 300)
    y = lagged(20 + 0.5 * u, 120.0, 20.0, 5)
    time = np.arange(float(size))
    kept = np.ones(size, dtype=np.bool_)
    if kind == "gap":
        kept[560:700] = False
    elif kind == "pace":
        kept = (np.arange(size) % 300 < 150) | (np.arange(size) % 20 == 0)
    elif kind == "fine":
        time = time / 10.0
        u = held([0, 60, 20], 2400, 800)
        y = lagged(20 + 0.5 * u, 1200.0, 20.0, 5)
    return written(
        path, {"time (s)": time[kept], "T (degC)": y[kept], "output (%)": u[kept]}
    )


def advised(capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    """The commands of twinmatch that were advised, in words."""
    lines = [
        line.partition(". ")[2].partition("#")[0]
        for line in capsys.readouterr().out.splitlines()
    ]
    return [shlex.split(line)[1:] for line in lines if line.startswith("twinmatch ")]


@pytest.mark.parametrize("kind", ["limits", "gap", "pace", "fine", "relays"])
def test_each_command_takes_what_the_one_before_advises(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kind: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    make = (
        two_relays(Path("log.csv"))
        if kind == "relays"
        else one_loop(Path("log.csv"), kind)
    )
    assert main(["new-plant", f"advised_{kind}", "--from", str(make)]) == 0
    check, imported, replayed = advised(capsys)
    assert ("--bridge" in check) is (kind == "pace")
    assert ("split" in check) is (kind == "gap")
    # findings are for the user, a refusal would be 2
    assert main(check) in (0, 1), capsys.readouterr().err
    assert main(imported) == 0, capsys.readouterr().err
    if kind == "limits":
        assert main(replayed) == 0, capsys.readouterr().err


def test_limits_hold_every_row(tmp_path: Path) -> None:
    """The highest command lies between two samples of the period; resampled, it is lower."""
    path = one_loop(tmp_path / "log.csv", "limits")
    signal_map = parse_map(["time=time", "output=T", "input=output"])
    drive = propose(open_table(path), signal_map).input
    assert (drive.low, drive.high) == (0.0, 101.0)
    coarse = SignalMap(signal_map.sources, period=700.0)
    assert propose(open_table(path), coarse).input.high == 101.0


def test_rows_much_finer_than_the_plant_get_a_period_of_the_plant(
    tmp_path: Path,
) -> None:
    signal_map = parse_map(["time=time", "output=T", "input=output"])
    proposal = propose(open_table(one_loop(tmp_path / "log.csv", "fine")), signal_map)
    assert 60.0 < proposal.lag < 240.0  # 120 s, of rows 0.1 s apart
    assert proposal.period in {1.0, 2.0, 5.0}
    (note,) = proposal.notes
    assert note.startswith(
        "The rows are 0.1 s apart, the plant's time constant is about"
    )


def test_structures_are_compared_where_the_plant_moves() -> None:
    """A quarter of an hour at rest precedes the steps; more than two hours at 1 s are not compared."""
    truth = Lag.model().parameters(gain=3.0, lag=8.0)
    u = np.concatenate([np.zeros(7300), held([4, -2, 6, 0], 900, 60)])
    run = simulate_driven(truth, u, states=begin(truth, 0.0), period=1.0)
    y = run.output + 0.01 * np.random.default_rng(1).standard_normal(u.size)
    window = Window(np.zeros(u.size), y, u, period=1.0)
    compared = compare_structures(
        [window], Lag, TwinSettings.of(Lag, period=1.0, law=None)
    )
    assert compared.notes[0] == "each structure fitted to 7200 of 8200 samples:"
    # What the noise leaves; at rest alone the gain would stay where it begins, at 2.
    gain, lag = (
        float(value)
        for value in re.findall(r"(?:gain|lag) = ([\d.]+)", compared.notes[1])
    )
    assert (gain, lag) == pytest.approx((3.0, 8.0), rel=0.01)


def test_a_short_stretch_is_left_out_with_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    u = held([0, 60, 20, 80, 40], 1100, 200)
    columns = {
        "time (s)": np.arange(1100.0),
        "T (degC)": lagged(20 + 0.5 * u, 60.0, 20.0, 6),
        "heater (%)": u,
    }
    kept = (np.arange(1100) < 900) | (np.arange(1100) >= 1039)
    written(Path("log.csv"), {title: column[kept] for title, column in columns.items()})
    assert main(["new-plant", "with_short_stretch", "--from", "log.csv"]) == 0
    check, *_ = advised(capsys)
    main(check)
    shown = capsys.readouterr().out
    assert (
        "1 stretch is left out of the comparison: 61 samples, fewer than 90 each"
        in shown
    )
    assert "each structure fitted to 900 of 961 samples" in shown


def guessed(path: Path) -> dict[str, str]:
    table = open_table(path)
    sources = proposed(columns_of(table), table)
    return {name: source.text for name, source in sources.items()}


def test_a_number_in_its_name_makes_no_input_of_a_reading(tmp_path: Path) -> None:
    """L2 shares its number with P2, but steam and coolant are what moves in steps."""
    recorded = evaporator()
    titles = ["time (min)", "L2 (m)", "X2 (%)", "P2 (kPa)"]
    titles += ["F2 (kg/min)", "P100 (kPa)", "F200 (kg/min)"]
    columns = [np.arange(600.0), *recorded.outputs.T, *recorded.inputs.T]
    path = written(tmp_path / "log.csv", dict(zip(titles, columns, strict=True)))
    assert guessed(path) == {
        "time": "time (min)",
        "output": "P2 (kPa)",
        "input": "P100 (kPa)",
    }


def test_where_nothing_moves_in_steps_a_temperature_moves_no_other(
    tmp_path: Path,
) -> None:
    recorded = furnace()
    titles = ["time (min)", "Crown1 (degC)", "Crown2 (degC)", "Crown3 (degC)"]
    titles += ["Gas1 (%)", "Gas2 (%)", "Gas3 (%)"]
    columns = [np.arange(1600.0), *recorded.outputs.T, *recorded.inputs.T]
    path = written(tmp_path / "log.csv", dict(zip(titles, columns, strict=True)))
    guess = guessed(path)
    assert guess["output"].startswith("Crown")
    assert guess["input"] == guess["output"].replace("Crown", "Gas").replace(
        "degC", "%"
    )


def test_what_no_input_moves_is_a_disturbance(tmp_path: Path) -> None:
    """The temperature outside varies most, and was taken for what is heated."""
    random = np.random.default_rng(4)
    heating = np.repeat(random.integers(0, 2, 40), 50).astype(np.float64)
    outside = np.round(8.0 + np.cumsum(0.1 * random.standard_normal(2000)), 1)
    path = written(tmp_path / "log.csv", {
        "time (s)": np.arange(2000.0),
        "Temp A (degC)": np.round(lagged(15 + 5 * heating + 0.1 * outside, 90.0, 16.0, 2), 1),
        "Temp B (degC)": outside,
        "heating": heating,
    })  # fmt: skip
    guess = guessed(path)
    assert guess["output"] == "Temp A (degC)"
    assert guess["input"] == "heating"
    assert guess["room"] == "Temp B (degC)"


def test_air_outside_by_the_name_of_building_controls_is_a_disturbance(
    tmp_path: Path,
) -> None:
    u = held([20, 60, 40], 600, 100)
    zone = 15.0 + lagged(u, 20.0, 20.0, 1)
    outside = 10.0 + np.sin(np.arange(600) / 150.0)
    rows = zip(range(600), zone, u, outside, strict=True)
    lines = [f"{t},{y:.2f},{v:g},{a:.1f}" for t, y, v, a in rows]
    path = tmp_path / "zone.csv"
    titles = "time (s),Zone Temp (°C),Htg Valve (%),OAT (°C)"
    path.write_text("\n".join([titles, *lines]) + "\n")
    assert guess(path) == {
        "time": "time (s)",
        "output": "Zone Temp (°C)",
        "input": "Htg Valve (%)",
        "room": "OAT (°C)",
    }


def building(folder: Path, second: str, *, reads_back: bool = False) -> dict[str, str]:
    """The guess at a zone with a heating valve and a second column in per cent, which cools or reads it back."""
    rng = np.random.default_rng(5)
    heat = 50.0 + 40.0 * np.sin(np.arange(900) / 37.0)
    cool = 50.0 + 40.0 * np.sin(np.arange(900) / 23.0)
    zone = 15.0 + lagged(heat, 20.0, 20.0, 1) - lagged(cool, 20.0, 12.0, 1)
    shown = heat + 0.2 * rng.standard_normal(900) if reads_back else cool
    path = folder / "building.csv"
    lines = [f"time (s),Zone Temp (°C),Htg Valve (%),{second}"]
    for row in zip(range(900), zone, heat, shown, strict=True):
        lines.append("{:d},{:.2f},{:.1f},{:.1f}".format(*row))
    path.write_text("\n".join(lines) + "\n")
    return guess(path)


def test_a_second_valve_that_modulates_is_an_input(tmp_path: Path) -> None:
    """Neither holds its values, as those of a relay are held."""
    cooled = building(tmp_path, "Clg Valve (%)")
    assert cooled["input.1"] == "Htg Valve (%)"
    assert cooled["input.2"] == "Clg Valve (%)"
    # of another unit, of another kind, or the first one again
    assert building(tmp_path, "Clg Valve (V)")["input"] == "Htg Valve (%)"
    assert building(tmp_path, "Humidity (%)")["input"] == "Htg Valve (%)"
    again = building(tmp_path, "Htg Valve Fbk (%)", reads_back=True)
    assert again["input"] == "Htg Valve (%)"


def test_what_flows_into_a_plant_is_not_its_output(tmp_path: Path) -> None:
    blower = held([20, 60, 40, 80], 600, 50)
    oxygen = 1.0 + lagged(blower, 20.0, 5.0, 1)
    inflow = 300.0 + 50.0 * np.sin(np.arange(600) / 91.0)
    path = tmp_path / "basin.csv"
    titles = "time (s),DO [mg/L],Blower [%],Inflow [m3/h]"
    rows = zip(range(600), oxygen, blower, inflow, strict=True)
    lines = [f"{t},{y:.2f},{u:g},{q:.0f}" for t, y, u, q in rows]
    path.write_text("\n".join([titles, *lines]) + "\n")
    assert guess(path)["output"] == "DO [mg/L]"
    # where nothing else is left, it is one
    lines = [
        f"{t},{u:g},{y:.2f}"
        for t, y, u, _ in zip(range(600), oxygen, blower, inflow, strict=True)
    ]
    path.write_text("\n".join(["time (s),Valve [%],Inflow [m3/h]", *lines]) + "\n")
    assert guess(path)["output"] == "Inflow [m3/h]"
