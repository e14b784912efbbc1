"""The files of a new plant: the plant, its test, its configuration, and the map of its table."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from twinmatch.adding.errors import AddingError
from twinmatch.adding.proposal import Proposal
from twinmatch.sessions.column_map import Source

__all__ = ["files_of"]

_WIDE: Final = 20.0
"""Bounds of gain and lag are this factor below and above; a first guess is rarely further off."""
_ABSOLUTE: Final = {"°C": 273.15}


def files_of(name: str, held: Proposal) -> dict[str, str]:
    """The texts of the files by file name.

    Raises:
        AddingError: the name is not valid for a plant.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        msg = f"new-plant {name!r}: not a valid name; use small letters, digits and _, starting with a letter"
        raise AddingError(msg)
    # The output is Python and YAML, which need no HTML escaping.
    pages = Environment(  # noqa: S701
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined, keep_trailing_newline=True
    )
    words = {"name": name, "table": held.table, **_plant(name, held)}
    files = {
        f"{name}.py": pages.get_template("plant.jinja").render(words),
        f"test_{name}.py": pages.get_template("test.jinja").render(words | _test(held)),
        f"{name}.yaml": pages.get_template("config.jinja").render(name=name, period=held.period),
    }
    if held.sources:
        sources = [(signal, _source(source)) for signal, source in held.sources.items()]
        files[f"{name}_map.yaml"] = pages.get_template("map.jinja").render(
            words, period=held.period, sources=sources
        )
    return files


def _plant(name: str, held: Proposal) -> dict[str, Any]:
    y, u = held.output, held.input
    measured = held.disturbances[0].name if held.disturbances else "rest"
    free = ["gain", "lag", *([] if held.disturbances else ["rest"])]
    low, high = sorted((held.gain / _WIDE, held.gain * _WIDE))
    return {
        "title": "".join(part.capitalize() for part in name.split("_")),
        "y": y,
        "u": u,
        "noise": held.noise,
        "absolute": _ABSOLUTE.get(y.unit),
        "drive_noise": _short((u.high - u.low) / 100),
        "disturbances": [
            d._asdict() | {"middle": _short((d.low + d.high) / 2, 4)} for d in held.disturbances
        ],
        "gain_unit": _per(y.unit, u.unit),
        "gain": held.gain,
        "gain_low": _short(low),
        "gain_high": _short(high),
        "lag": held.lag,
        "lag_low": _short(held.lag / _WIDE),
        "lag_high": _short(held.lag * _WIDE),
        "rest": held.rest,
        "rest_scale": _short((y.high - y.low) / 10),
        "sensor_lag": _short(held.lag / 10),
        "sensor_low": _short(held.lag / 500),
        "free": ", ".join(f'"{name}"' for name in free),
        "around": f"self.{measured}",
    }


def _test(held: Proposal) -> dict[str, Any]:
    low, high = held.input.low, held.input.high
    measured = [_short((d.low + d.high) / 2, 4) for d in held.disturbances]
    return {
        "period": _short(held.lag / 15),
        "levels": [_short(low + part * (high - low), 4) for part in (0.0, 0.6, 0.2, 0.8, 0.4)],
        "measured": measured,
        "begin": measured[0] if measured else held.rest,
    }


def _source(source: Source) -> str:
    """A source as JSON, which is valid YAML."""
    columns: Any = list(source.columns) if len(source.columns) > 1 else source.columns[0]
    entry: dict[str, Any] = {"column": columns}
    entry |= {"unit": source.unit} if source.unit else {}
    entry |= {"scale": source.scale} if source.scale != 1.0 else {}
    entry |= {"offset": source.offset} if source.offset else {}
    return json.dumps(entry if len(entry) > 1 else columns, ensure_ascii=False)


def _per(above: str, below: str) -> str:
    above = "K" if above in {"°C", "°F"} else above or "1"
    if not below:
        return above
    return f"{above}/({below})" if re.search(r"[ /·]", below) else f"{above}/{below}"


def _short(value: float, digits: int = 2) -> float:
    return float(f"{value:.{digits}g}")
