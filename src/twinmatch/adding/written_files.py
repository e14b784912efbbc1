"""The files of a new plant: the plant, its test, its configuration, and the map of its table."""

from __future__ import annotations

import importlib.util
import json
import keyword
import re
from pathlib import Path
from typing import Any, Final

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from twinmatch.adding.proposal import Proposal, rounded
from twinmatch.adding.several import LaggedOutput, SeveralProposal
from twinmatch.errors import TwinmatchError
from twinmatch.plants import PLANTS
from twinmatch.plants.files import installed_names
from twinmatch.sampling.sources import SignalSource
from twinmatch.units import is_readable

_WIDE: Final = 20.0
"""Bounds of gain and lag are this factor below and above; a first guess is rarely further off."""
_SMOOTH: Final = 0.01
"""Distance from rest within which a power of it is smoothed, as a share of the range."""
_DEAD_ORDER: Final = 2
"""States of the dead time where inputs change by small steps."""
_DEAD_ORDER_SWITCHED: Final = 4
"""States of the dead time where an input switches: two round its corners off, and the loop that switches on
what it sees then has another gain and another lag in their place."""
_DEAD_STARTS: Final = '"acting_0", "acting_1"'
"""States of such a dead time that are fitted at the start of a window: how much of what was switched has not
arrived yet, and when it will. What is taken for heat that nobody gave is in the readings for a time constant."""
_LONGEST: Final = 60
_TAKEN: Final = (
    "Disturbance",
    "Drive",
    "Equations",
    "Output",
    "Parameter",
    "Plant",
    "State",
    "Structure",
)
"""Classes that the file of a plant imports."""
_ABSOLUTE: Final = {"°C": 273.15}


def files_of(name: str, proposal: Proposal | SeveralProposal) -> dict[str, str]:
    """The texts of the files by file name."""
    _require_name(name)
    # The output is Python and YAML, which need no HTML escaping.
    pages = Environment(  # noqa: S701
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    pages.filters["text"] = _quote
    table = re.sub(r"[^\w .()+-]", "_", proposal.table)  # stands in comments
    words = {"name": name, "table": table}
    if isinstance(proposal, SeveralProposal):
        words |= _several(name, proposal)
        plant_text = pages.get_template("plants.jinja").render(words)
        test_text = pages.get_template("tests.jinja").render(
            words | _test_of_several(proposal)
        )
    else:
        words |= _plant(name, proposal)
        plant_text = pages.get_template("plant.jinja").render(words)
        test_text = pages.get_template("test.jinja").render(words | _test(proposal))
    files = {
        f"{name}.py": plant_text,
        f"test_{name}.py": test_text,
        f"{name}.yaml": pages.get_template("config.jinja").render(
            name=name, period=proposal.period
        ),
    }
    if proposal.sources:
        sources = [
            (_key(signal), written_source(source))
            for signal, source in proposal.sources.items()
        ]
        files[f"{name}_map.yaml"] = pages.get_template("map.jinja").render(
            words, period=proposal.period, sources=sources
        )
    return files


def _require_name(name: str) -> None:
    problem = ""
    if (
        not re.fullmatch(r"[a-z][a-z0-9_]*", name)
        or len(name) > _LONGEST
        or keyword.iskeyword(name)
    ):
        problem = "not a valid name"
    elif name in {*PLANTS, *installed_names()}:
        problem = "there is a plant of this name"
    elif (spec := importlib.util.find_spec(name)) and Path(
        spec.origin or ""
    ).parent != Path.cwd():
        problem = (
            "there is a Python module of this name, which the plant's file would hide"
        )
    if problem:
        todo = f"use up to {_LONGEST} small letters, digits and _, starting with a letter, such as my_tank"
        raise AddingError(f"new-plant {name[:80]!r}: {problem}; {todo}")


def _plant(name: str, proposal: Proposal) -> dict[str, Any]:
    y = proposal.output
    u = proposal.input
    around = proposal.around
    free = ["gain", "lag", "load" if around else "rest"]
    low, high = sorted((proposal.gain / _WIDE, proposal.gain * _WIDE))
    middles = [
        d._asdict() | {"middle": rounded((d.low + d.high) / 2, 4)}
        for d in proposal.disturbances
    ]
    return {
        "y": y,
        "u": u,
        "noise": proposal.noise,
        "gain": proposal.gain,
        "lag": proposal.lag,
        "assumed": proposal.assumed,
        "half_range": rounded((y.high - y.low) / 2),
        "smooth": rounded(_SMOOTH * (y.high - y.low)),
        "bend_unit": _per("1", "K"),
        "rest": proposal.rest,
        "centre": proposal.centre,
        "title": _title(name),
        "absolute": _ABSOLUTE.get(y.unit),
        "drive_rest": min(max(0.0, u.low), u.high),
        "drive_noise": rounded((u.high - u.low) / 100),
        "disturbances": middles,
        "gain_unit": _per(y.unit, u.unit),
        "gain_low": rounded(low),
        "gain_high": rounded(high),
        "lag_low": rounded(proposal.lag / _WIDE),
        "lag_high": rounded(proposal.lag * _WIDE),
        "rest_scale": rounded((y.high - y.low) / 10),
        "load_most": rounded(y.high - y.low),
        "sensor_lag": rounded(proposal.lag / 10),
        "sensor_low": rounded(proposal.lag / 500),
        "dead_order": _DEAD_ORDER_SWITCHED if proposal.switched else _DEAD_ORDER,
        "dead_starts": _DEAD_STARTS if proposal.switched else "",
        "dead_low": rounded(proposal.lag / 50),
        "free": ", ".join(f'"{name}"' for name in free),
        "around": around.name if around else "rest",
    }


def _title(name: str) -> str:
    """The name of the plant's class."""
    title = "".join(part.capitalize() for part in name.split("_"))
    return f"{title}Plant" if title in _TAKEN else title


def _several(name: str, proposal: SeveralProposal) -> dict[str, Any]:
    inputs = []
    for u in proposal.inputs:
        at_rest = min(max(0.0, u.low), u.high)
        inputs.append(
            u._asdict() | {"noise": rounded((u.high - u.low) / 100), "rest": at_rest}
        )
    outputs = [
        _output(number, output, proposal)
        for number, output in enumerate(proposal.outputs, 1)
    ]
    free = []
    for number, output in enumerate(outputs, 1):
        free += [
            # what the whole recording does not show, no window of it determines
            *([f"lag_{number}"] if output["rests"] else []),
            f"rest_{number}",
            *(gain["name"] for gain in output["gains"]),
        ]
    middles = [
        d._asdict() | {"middle": rounded((d.low + d.high) / 2, 4)}
        for d in proposal.disturbances
    ]
    return {
        "title": _title(name),
        "outputs": outputs,
        "inputs": inputs,
        "disturbances": middles,
        "free": free,
    }


def _output(
    number: int, output: LaggedOutput, proposal: SeveralProposal
) -> dict[str, Any]:
    """What the file says of one output and its lag."""
    y = output.signal
    reach = y.high - y.low
    gains = []
    for input_number, (gain, u, centre) in enumerate(
        zip(output.gains, proposal.inputs, proposal.centres, strict=True), 1
    ):
        most = rounded(reach / (u.high - u.low))
        gains.append(
            {
                "name": f"gain_{number}_{input_number}",
                "unit": _per(y.unit, u.unit),
                "default": min(max(gain, -most), most),
                "most": most,
                "scale": rounded(most / 10),
                "input": u.name,
                "centre": centre,
            }
        )
    low, high = (-reach, reach) if output.around else (y.low, y.high)
    # without inputs it may rest beyond what their limits allow
    low = min(low, output.rest - reach / 10)
    high = max(high, output.rest + reach / 10)
    return {
        "number": number,
        "y": y,
        "noise": output.noise,
        "absolute": _ABSOLUTE.get(y.unit),
        "lag": output.lag,
        "rests": output.rests,
        "lag_low": rounded(output.lag / _WIDE),
        "lag_high": rounded(output.lag * _WIDE),
        "rest": output.rest,
        "rest_low": rounded(low, 4),
        "rest_high": rounded(high, 4),
        "rest_scale": rounded(reach / 10),
        "gains": gains,
        "centred": any(proposal.centres),
        "around": output.around.name if output.around else "",
    }


def _test_of_several(proposal: SeveralProposal) -> dict[str, Any]:
    measured = [rounded((d.low + d.high) / 2, 4) for d in proposal.disturbances]
    begin = []
    for output in proposal.outputs:
        level = (
            measured[proposal.disturbances.index(output.around)]
            if output.around
            else 0.0
        )
        begin.append(rounded(level + output.rest, 4))
    return {
        "period": rounded(min(output.lag for output in proposal.outputs) / 15),
        "measured": measured,
        "begin": begin,
    }


def _test(proposal: Proposal) -> dict[str, Any]:
    low = proposal.input.low
    high = proposal.input.high
    around = proposal.around
    measured = [rounded((d.low + d.high) / 2, 4) for d in proposal.disturbances]
    return {
        "period": rounded(proposal.lag / 15),
        "levels": [
            rounded(low + part * (high - low), 4) for part in (0.0, 0.6, 0.2, 0.8, 0.4)
        ],
        "measured": measured,
        "begin": measured[proposal.disturbances.index(around)]
        if around
        else proposal.rest,
    }


def _key(signal: str) -> str:
    """A name as a key in YAML, where `on` would be a truth value."""
    return signal if yaml.safe_load(signal) == signal else _quote(signal)


def _quote(value: Any) -> str:
    """A text, or a list or table of texts, as Python, JSON and YAML write it."""
    text = json.dumps(value, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in text)


def written_source(source: SignalSource) -> str:
    """A source as YAML, in one line."""
    columns: Any = list(source.places) if len(source.places) > 1 else source.places[0]
    entry: dict[str, Any] = {"column": columns}
    optional_entries = {
        "unit": (source.unit, ""),
        "scale": (source.scale, 1.0),
        "offset": (source.offset, 0.0),
        "missing": (list(source.missing), []),
        "interval": (source.interval, "after"),
        "turn": (source.turn, 0.0),
        "words": (dict(source.words), {}),
    }
    entry |= {
        name: value
        for name, (value, usual) in optional_entries.items()
        if value != usual
    }
    return _quote(entry if len(entry) > 1 else columns)


def _per(above: str, below: str) -> str:
    """The unit of a ratio; none if plant files may not have it."""
    above = "K" if above in {"°C", "°F"} else above or "1"
    if not below:
        return above
    ratio = f"{above}/({below})" if re.search(r"[ /·]", below) else f"{above}/{below}"
    return ratio if is_readable(ratio) else ""


class AddingError(TwinmatchError):
    """The name is not valid for a plant, or a file exists already."""
