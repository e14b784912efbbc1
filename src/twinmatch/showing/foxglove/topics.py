"""Topics of a twinmatch graph, and their types."""

from __future__ import annotations

__all__ = ["ELSEWHERE", "TOPICS"]

TOPICS = {
    "plant/description": "twinmatch_msgs/msg/PlantDescription",
    "plant/sample": "twinmatch_msgs/msg/LoopSample",
    "plant/reading": "twinmatch_msgs/msg/PlantReading",
    "plant/command": "twinmatch_msgs/msg/PlantCommand",
    "plant/applied": "twinmatch_msgs/msg/PlantApplied",
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
}
"""Types by name relative to the rig's namespace.

They are advertised from the start, so that a viewer opened before the graph finds them. This also avoids a
race in the SDK, which may refuse a viewer that subscribes to a new topic within a millisecond.
"""

ELSEWHERE = {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/rosout": "rcl_interfaces/msg/Log"}
"""Topics outside the namespace that are also advertised."""
