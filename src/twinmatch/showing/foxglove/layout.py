"""The topics of a graph, and the layout of a viewer's window with the plant's names and units."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from twinmatch.comparing import TrustLevel
from twinmatch.description import Description, Loop, Quantity, nth
from twinmatch.showing.serving import ServingError
from twinmatch.showing.style import (
    CLOSED,
    DRIVEN,
    LEVELS,
    PLANT,
    SET_POINT,
    SIDE_BY_SIDE,
)

TOPICS = {
    "plant/description": "twinmatch_msgs/msg/PlantDescription",
    "plant/sample": "twinmatch_msgs/msg/LoopSample",
    "plant/reading": "twinmatch_msgs/msg/PlantReading",
    "plant/command": "twinmatch_msgs/msg/PlantCommand",
    "plant/applied": "twinmatch_msgs/msg/PlantApplied",
    "plant/estimate": "twinmatch_msgs/msg/EstimatedReading",
    "plant/law": "twinmatch_msgs/msg/LawReport",
    "plant/temperature": "sensor_msgs/msg/Temperature",
    "plant/reference": "std_msgs/msg/Float64",
    "plant/uniformity": "std_msgs/msg/Float64",
    "plant/pwm_command": "twinmatch_msgs/msg/PwmCommand",
    "plant/pwm_applied": "twinmatch_msgs/msg/PwmApplied",
    "thermal/image_raw": "sensor_msgs/msg/Image",
    "thermal/image": "sensor_msgs/msg/Image",
    "twin/match_request": "twinmatch_msgs/msg/MatchRequest",
    "twin/match": "twinmatch_msgs/msg/Match",
    "twin/model_score": "twinmatch_msgs/msg/ModelScore",
    "twin/nominal": "twinmatch_msgs/msg/Candidate",
    "twin/leader": "twinmatch_msgs/msg/ForecastScore",
    "twin/forecast": "twinmatch_msgs/msg/Forecast",
    "twin/state": "twinmatch_msgs/msg/TwinState",
    "twin/experiment": "twinmatch_msgs/msg/ExperimentReport",
    "twin/law": "twinmatch_msgs/msg/LawReport",
}
"""Types by name relative to the rig's namespace.

They are advertised from the start, so that a viewer opened before the graph finds them. This also avoids a
race in the SDK, which may refuse a viewer that subscribes to a new topic within a millisecond.
"""

OUTSIDE = {
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/rosout": "rcl_interfaces/msg/Log",
}
"""Topics outside the namespace that are also advertised."""

APPLIED: Final = "plant/pwm_applied"
IMAGE: Final = "thermal/image"
_APPLIED_COLOUR: Final = "#E69F00"
_EDGES: Final = ("#F0A868", "#C77B3A")
"""Lower and upper edge of a band: lighter and darker than its mean."""
_STAMP: Final = {"enabled": True, "timestampMethod": "headerStamp"}

_Panel = dict[str, Any]


def layout(
    described: Description, topics: Collection[str] = (), rig: str = ""
) -> dict[str, Any]:
    """The layout, in the format that Lichtblick and Foxglove import.

    Args:
        described: names and units of the plant and its signals.
        topics: relative names of the graph's topics; some panels are included only if theirs is present.
        rig: namespace before the topics, such as `/rig_a`; empty: none.
    """
    loops = described.loops
    panels = {
        **{
            name: panel
            for k in range(len(loops))
            for name, panel in _charts(loops, k, rig, topics).items()
        },
        **({"Image!thermal": _image(rig)} if IMAGE in topics else {}),
        **_verdict(rig),
        **_nodes(),
        "Tab!more": _tabs(len(loops)),
    }
    empty_settings = {
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
    }
    return {
        "configById": panels,
        **empty_settings,
        "layout": _places(len(loops), image=IMAGE in topics),
    }


def write_layout(path: Path, document: Mapping[str, Any]) -> None:
    """Write a layout to a file.

    Raises:
        ServingError: the file cannot be written.
    """
    try:
        path.write_text(
            json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise ServingError(
            f"foxglove: the layout cannot be written to {path}: {error.strerror}"
        ) from error


def _charts(
    loops: Sequence[Loop], k: int, rig: str, topics: Collection[str]
) -> dict[str, _Panel]:
    """The panels of the k-th output and input."""
    _, y, u = loops[k]
    sample, state, forecast = (
        f"{rig}/{name}" for name in ("plant/sample", "twin/state", "twin/forecast")
    )
    inputs = [
        _line(f"{sample}.input[{k}]", "plant", PLANT),
        _line(f"{state}.closed_input[{k}]", "closed-loop twin", CLOSED),
    ]
    if APPLIED in topics:
        inputs.append(
            _line(f"{rig}/{APPLIED}.pwm", "applied by the board", _APPLIED_COLOUR)
        )
    outputs = [
        _line(f"{sample}.reference[{k}]", "set-point", SET_POINT),
        _line(f"{sample}.output[{k}]", "plant", PLANT),
        _line(f"{state}.closed_output[{k}]", "closed-loop twin", CLOSED),
        _line(f"{state}.driven_output[{k}]", "driven twin", DRIVEN),
    ]
    output_off = [
        _line(f"{state}.closed_residual_y[{k}]", "closed-loop twin", CLOSED),
        _line(f"{state}.driven_residual_y[{k}]", "driven twin", DRIVEN),
        _line(f"{state}.driven_rms_y[{k}]", "driven twin, RMS", SET_POINT),
    ]
    input_off = [
        _line(f"{state}.closed_residual_u[{k}]", "closed-loop twin", CLOSED),
        _line(f"{state}.closed_rms_u[{k}]", "closed-loop twin, RMS", SET_POINT),
    ]
    panels = {
        "Plot!output": _plot(_title(y), y.label, outputs),
        "Plot!input": _plot(_title(u), u.label, inputs),
        "Plot!residuals": _plot(f"{y.name}: plant minus twin", y.label, output_off),
        "Plot!input_residuals": _plot(
            f"{u.name}: plant minus twin", u.label, input_off
        ),
    }
    if len(loops) == 1:
        # a message has the values of several signals one after the other: no path takes one
        wanted = _line(f"{forecast}.reference[:]", "set-point", SET_POINT)
        ahead = [wanted, *_band(f"{forecast}.output")]
        panels["Plot!output_ahead"] = _forecast(forecast, y, ahead)
        panels["Plot!input_ahead"] = _forecast(forecast, u, _band(f"{forecast}.input"))
    return {nth(name, k): panel for name, panel in panels.items()}


def _title(quantity: Quantity) -> str:
    """Its name, and its description if it differs from the name."""
    named = quantity.name.replace("_", " ")
    adds_description = quantity.text and quantity.text.lower() != named.lower()
    return f"{named}: {quantity.text}" if adds_description else named


def _line(value: str, label: str, color: str, size: float = 1.5) -> dict[str, Any]:
    return {
        "value": value,
        "label": label,
        "color": color,
        **_STAMP,
        "lineSize": size,
        "showLine": True,
    }


def _band(signal: str) -> list[dict[str, Any]]:
    return [
        _line(f"{signal}[:]", "mean", CLOSED),
        _line(f"{signal}_low[:]", "low", _EDGES[0], 1.0),
        _line(f"{signal}_high[:]", "high", _EDGES[1], 1.0),
    ]


def _titled(title: str, **settings: Any) -> _Panel:
    return {"foxglovePanelTitle": title, "lichtblickPanelTitle": title, **settings}


def _plot(
    title: str, label: str, lines: Sequence[dict[str, Any]], **settings: Any
) -> _Panel:
    shown = (
        "showXAxisLabels",
        "showYAxisLabels",
        "showLegend",
        "showPlotValuesInLegend",
        "isSynced",
    )
    usual = {"xAxisVal": "timestamp", "yAxisLabel": label, **dict.fromkeys(shown, True)}
    usual |= {"legendDisplay": "floating", "sidebarDimension": 240}
    return _titled(title, paths=list(lines), **{**usual, **settings})


def _forecast(
    topic: str, quantity: Quantity, lines: Sequence[dict[str, Any]]
) -> _Panel:
    """The newest forecast, over the seconds ahead rather than the time of its message."""
    axis: dict[str, Any] = {"xAxisVal": "currentCustom", "xAxisLabel": "time ahead / s"}
    axis |= {"xAxisPath": {"value": f"{topic}.time[:]", **_STAMP}}
    still = {"showPlotValuesInLegend": False, "isSynced": False}
    return _plot(f"{quantity.name} forecast", quantity.label, lines, **axis, **still)


def _image(rig: str) -> _Panel:
    mode = {
        "imageTopic": f"{rig}/{IMAGE}",
        "colorMode": "colormap",
        "colorMap": "turbo",
    }
    return _titled(
        "Thermal image / °C", imageMode={**mode, "minValue": 10, "maxValue": 110}
    )


def _verdict(rig: str) -> dict[str, _Panel]:
    """Panels of the verdict: trust level, changes, family, and the messages in full."""
    score = f"{rig}/twin/model_score"
    match = f"{rig}/twin/match"
    changes = {
        "nominal": f"{score}.nominal",
        "leader": f"{rig}/twin/state.leader",
        "level": f"{score}.level_name",
        "fault": f"{score}.fault",
        "order": f"{score}.order",
    }
    whole: dict[str, Any] = {"diffEnabled": False, "showFullMessageForDiff": False}
    whole |= {"diffMethod": "custom", "diffTopicPath": ""}
    return {
        "Indicator!level": _titled(
            "Trust",
            path=f"{score}.level_name",
            style="background",
            fallbackColor=LEVELS[TrustLevel.UNKNOWN],
            fallbackLabel="no verdict yet",
            rules=[
                {
                    "operator": "=",
                    "rawValue": level.value,
                    "color": LEVELS[level],
                    "label": level.value,
                }
                for level in (
                    TrustLevel.TRUSTED,
                    TrustLevel.DOUBTFUL,
                    TrustLevel.FAULT,
                    TrustLevel.UNKNOWN,
                )
            ],
        ),
        "StateTransitions!verdict": _titled(
            "Nominal, leader, level, fault",
            isSynced=True,
            paths=[
                {"value": path, "label": label, **_STAMP}
                for label, path in changes.items()
            ],
        ),
        "Table!family": _titled("Family", topicPath=f"{score}.candidates"),
        "RawMessages!score": _titled("Verdict", topicPath=score, **whole),
        "RawMessages!match": _titled("Newest match", topicPath=match, **whole),
    }


def _nodes() -> dict[str, _Panel]:
    health = {"topicToRender": "/diagnostics"}
    summary = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "sortByLevel": True,
    }
    return {
        "DiagnosticSummary!nodes": _titled("Nodes", **health, **summary),
        "DiagnosticStatusPanel!node": _titled(
            "Node in detail", **health, collapsedSections=[]
        ),
        "RosOut!log": _titled(
            "Log", topicToRender="/rosout", searchTerms=[], minLogLevel=2
        ),
    }


def _tabs(loops: int) -> _Panel:
    shown = {
        **(
            {"Forecast": _split("column", "Plot!output_ahead", "Plot!input_ahead", 60)}
            if loops == 1
            else {}
        ),
        "Verdict": "RawMessages!score",
        "Match": "RawMessages!match",
        "Nodes": _split(
            "column", "DiagnosticSummary!nodes", "DiagnosticStatusPanel!node", 50
        ),
        "Log": "RosOut!log",
    }
    return {
        "activeTabIdx": 0,
        "tabs": [{"title": title, "layout": place} for title, place in shown.items()],
    }


def _places(loops: int, *, image: bool) -> dict[str, Any]:
    """Charts on the left, a column for each of up to four loops; trust, family and tabs on the right."""
    columns = [_column(k) for k in range(loops)]
    rows = [
        _even("row", columns[k : k + SIDE_BY_SIDE])
        for k in range(0, loops, SIDE_BY_SIDE)
    ]
    above = (
        _split("row", "Indicator!level", "Image!thermal", 35)
        if image
        else "Indicator!level"
    )
    family = _split("column", "StateTransitions!verdict", "Table!family", 40)
    verdict = _split("column", family, "Tab!more", 55)
    right = _split("column", above, verdict, 25 if image else 12)
    return _split("row", _even("column", rows), right, 62)


def _column(k: int) -> Any:
    """The charts of one loop below one another."""
    signals = _split("column", nth("Plot!output", k), nth("Plot!input", k), 60)
    residuals = _split(
        "column", nth("Plot!residuals", k), nth("Plot!input_residuals", k), 50
    )
    return _split("column", signals, residuals, 60)


def _even(direction: str, places: Sequence[Any]) -> Any:
    """Places of the same size."""
    first, *further_places = places
    return (
        _split(
            direction, first, _even(direction, further_places), round(100 / len(places))
        )
        if further_places
        else first
    )


def _split(direction: str, first: Any, second: Any, share: int) -> dict[str, Any]:
    return {
        "direction": direction,
        "first": first,
        "second": second,
        "splitPercentage": share,
    }
