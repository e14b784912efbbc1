"""What was asked for on the page, as service calls and messages of the graph."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from twinmatch.dashboard.state import Answered, DashboardState
from twinmatch.dynamics import Plant
from twinmatch.nodes.forecast_messages import forecast_from
from twinmatch.nodes.samples import RELIABLE
from twinmatch.views.forecast import forecast_words
from twinmatch_msgs.srv import WhatIf

__all__ = ["Requests"]

SOURCE = ("reference_source", "profile.lowest", "profile.highest")
"""Parameters of the controller that say whether a set-point from outside would be followed."""


class Requests:
    """`Actions` by means of a node. Callable from any thread; the work is left to the node's own.

    Without `control` there is neither publisher nor client for anything that moves the rig.
    """

    def __init__(
        self,
        node: Node,
        state: DashboardState,
        later: Callable[[Callable[[], None]], None],
        *,
        control: bool,
        plant: Callable[[], type[Plant]],
    ) -> None:
        """Make clients; `later` has a function called in the node's thread, `plant` is asked each time."""
        self._node, self._state, self._later, self._plant = node, state, later, plant
        self._control = control
        self._pause = node.create_client(SetBool, "player/pause")
        self._rate = node.create_client(SetParameters, "player/set_parameters")
        self._ahead = node.create_client(WhatIf, "twin/what_if")
        if control:
            self._clear = node.create_client(Trigger, "plant/clear_fault")
            self._stop = node.create_client(Trigger, "plant/stop")
            self._limits = node.create_client(GetParameters, "controller/get_parameters")
            # Not latched: a controller that is started again must not find an old wish of ours.
            quiet = PublisherEventCallbacks(use_default_callbacks=False)
            self._reference = node.create_publisher(
                Float64, "plant/reference", RELIABLE, event_callbacks=quiet
            )

    @property
    def control(self) -> bool:
        """Whether set-point, stop and clearing a fault may be asked for."""
        return self._control

    def pause(self, paused: bool) -> None:
        """Let the player of a session stand still, or go on."""
        self._call(self._pause, SetBool.Request(data=paused), "the player", self._tell_answer)

    def rate(self, rate: float) -> None:
        """Let it play so many recorded seconds per second; 0: as fast as it goes."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=rate)
        request = SetParameters.Request(parameters=[Parameter(name="rate", value=value)])
        self._call(self._rate, request, "the player", self._tell_rate)

    def what_if(self, level: float, hold: float | None) -> None:
        """Ask the discriminator what comes if the set-point goes to a level, and back after a time (s)."""
        said = self._state.described.reference
        question = f"set-point {level:g} {said.unit}" + ("" if hold is None else f" for {hold:g} s")
        request = WhatIf.Request(times=[0.0], levels=[level])
        if hold is not None:
            now = (self._state.plant.newest() or {"reference": level})["reference"]
            request = WhatIf.Request(times=[0.0, hold], levels=[level, now])

        def show(answer: WhatIf.Response) -> None:
            if not answer.success:
                self._state.answer(Answered(question, (answer.message,)))
                return
            forecast = forecast_from(answer.forecast)
            lines = (*forecast_words(forecast, self._plant()), *forecast.notes)
            self._state.answer(Answered(question, lines, forecast))

        def miss(why: str) -> None:
            self._state.answer(Answered(question, (why,)))

        miss("asked")
        self._call(self._ahead, request, "the discriminator", show, miss)

    def clear_fault(self) -> None:
        """Let the output be driven again after a fault."""
        if self._control:
            self._call(self._clear, Trigger.Request(), "what drives the plant", self._tell_answer)

    def stop(self) -> None:
        """Hold the output at zero."""
        if self._control:
            self._call(self._stop, Trigger.Request(), "what drives the plant", self._tell_answer)

    def set_point(self, level: float) -> None:
        """Ask the controller for a set-point, once it has said that it would follow one."""
        if not self._control:
            return

        def ask(answer: Any) -> None:
            self._ask_for(level, answer.values)

        self._call(self._limits, GetParameters.Request(names=list(SOURCE)), "the controller", ask)

    def _ask_for(self, level: float, values: list[Any]) -> None:
        found = {name: value for name, value in zip(SOURCE, values, strict=False) if value.type}
        if len(found) < len(SOURCE):
            self._state.tell(False, "the controller does not say which set-points it follows")
            return
        unit = self._state.described.reference.unit
        low, high = found["profile.lowest"].double_value, found["profile.highest"].double_value
        if found["reference_source"].string_value != "topic":
            self._state.tell(
                False,
                "the controller follows its own profile; it has to be started with reference_source: topic",
            )
        elif not (math.isfinite(level) and low <= level <= high):
            allowed = f"allowed is {low:g} to {high:g} {unit}"
            self._state.tell(False, f"{level:g} {unit} was not asked for: {allowed}")
        else:
            self._reference.publish(Float64(data=level))
            self._state.tell(
                True, f"asked for {level:g} {unit}; the set-point above follows with the next sample"
            )

    def _call(
        self,
        client: Any,
        request: Any,
        whom: str,
        then: Callable[[Any], None],
        otherwise: Callable[[str], None] | None = None,
    ) -> None:
        def call() -> None:
            if not client.service_is_ready():
                miss = otherwise or partial(self._state.tell, False)
                miss(f"{whom} is not there ({client.srv_name})")
                return
            client.call_async(request).add_done_callback(done)

        def done(future: Any) -> None:
            answer = future.result()
            if answer is not None:
                then(answer)

        self._later(call)

    def _tell_answer(self, answer: Any) -> None:
        self._state.tell(answer.success, answer.message)

    def _tell_rate(self, answer: Any) -> None:
        for result in answer.results:
            if not result.successful:
                self._state.tell(False, result.reason)
