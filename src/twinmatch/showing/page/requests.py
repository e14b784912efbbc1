"""Requests made on the page, as service calls and messages to the graph."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from twinmatch.forecasting import Moment
from twinmatch.nodes.messages import nanoseconds, record_of
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import RELIABLE
from twinmatch.showing.forecasts import forecast_words
from twinmatch.showing.page.goal import Goal, soonest
from twinmatch.showing.page.state import DashboardState, WhatIfAnswer
from twinmatch.twin import TwinSettings
from twinmatch_msgs.srv import ApplyLaw, Experiment, WhatIf

SOURCE = ("reference_source", "profile.lowest", "profile.highest")
"""Parameters of the controller that show whether it follows a set-point from outside."""
DRIVER = "the node that drives the plant"


def _reached_of(answer: WhatIf.Response) -> Moment:
    """When the level of an answer is first reached."""
    times = (answer.reach, answer.reach_earliest, answer.reach_latest)
    expected, earliest, latest = (None if math.isnan(time) else time for time in times)
    return Moment(expected, earliest, latest)


def _ignored(why: str) -> None:
    """Without an answer nothing is shown: the page says which nodes are missing."""


class Requests:
    """What can be asked for on the page. Callable from any thread; the work is done in the node's own.

    Without `control` there is no publisher or client that could move the rig.
    """

    def __init__(
        self,
        node: TwinmatchNode,
        state: DashboardState,
        later: Callable[[Callable[[], None]], None],
        *,
        control: bool,
        settings: Callable[[], TwinSettings],
    ) -> None:
        """Make clients; `later` queues a function for the node's thread, `settings` returns those in use."""
        self._node = node
        self._state = state
        self._run_in_node = later
        self._settings = settings
        self.control = control
        """Whether the page may set the set-point, clear faults and stop."""
        self._pause = node.create_client(SetBool, "player/pause")
        self._rate = node.create_client(SetParameters, "player/set_parameters")
        self._what_if = node.create_client(WhatIf, "twin/what_if")
        if control:
            self._experiment = node.create_client(Experiment, "twin/experiment")
            self._law = node.create_client(ApplyLaw, "plant/apply_law")
            self._clear = node.create_client(Trigger, "plant/clear_fault")
            self._stop = node.create_client(Trigger, "plant/stop")
            self._course = node.create_client(
                SetParametersAtomically, "controller/set_parameters_atomically"
            )
            self._limits = node.create_client(
                GetParameters, "controller/get_parameters"
            )
            self._reference: Publisher | None = None

    def prepare(self, loops: int) -> None:
        """Get ready to send set-points once a plant with a single loop has been described, or its samples
        have come: without a discriminator nobody describes it.

        Those of several loops travel in another type of message, which this page does not send.
        """
        if self.control and loops == 1 and self._reference is None:
            # Not latched: a restarted controller must not receive an old request.
            quiet = {
                "event_callbacks": PublisherEventCallbacks(use_default_callbacks=False)
            }
            self._reference = self._node.create_publisher(
                Float64, "plant/reference", RELIABLE, **quiet
            )

    def pause(self, paused: bool) -> None:
        """Pause the player of a session, or continue."""
        self._call(
            self._pause, SetBool.Request(data=paused), "the player", self._show_result
        )

    def rate(self, rate: float) -> None:
        """Set the speed of the player in recorded seconds per second; 0: as fast as possible."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=rate)
        request = SetParameters.Request(
            parameters=[Parameter(name="rate", value=value)]
        )
        self._call(self._rate, request, "the player", self._show_rate_result)

    def what_if(self, level: float, hold: float | None) -> None:
        """Ask the discriminator for a forecast with the set-point at a level, and back after a time (s)."""
        question, times, levels = self._state.question(level, hold)
        request = WhatIf.Request(times=times, levels=levels)

        def show(answer: WhatIf.Response) -> None:
            if answer.success:
                forecast = record_of(answer.forecast)
                lines = (*forecast_words(forecast, self._settings()), *forecast.notes)
                self._state.answer(WhatIfAnswer(question, lines, forecast))
            else:
                show_text(answer.message)

        def show_text(why: str) -> None:
            self._state.answer(WhatIfAnswer(question, (why,)))

        show_text("waiting for the forecast")
        self._call(self._what_if, request, "the discriminator", show, show_text)

    def reach(self, goal: Goal) -> None:
        """Ask the discriminator when a goal is reached: if nothing is changed, and by each move that may lead
        there. The newest forecast says whether the loop is known; without one nobody is asked."""
        forecast = self._state.current_forecast
        settings = self._settings()
        if forecast is None or not settings.plant.single:
            return
        moves = goal.moves(settings.plant, closed=forecast.closed)
        questions = [
            goal.held(settings.period),
            *(goal.moved(move, settings.period) for move in moves),
        ]
        answers: dict[int, WhatIf.Response] = {}

        def take(number: int, answer: WhatIf.Response) -> None:
            answers[number] = answer
            if len(answers) < len(questions):
                return
            if not all(answered.success for answered in answers.values()):
                self._state.push_goal(None)
                return
            moments = [_reached_of(answers[k]) for k in range(len(questions))]
            stamp = nanoseconds(answers[0].forecast.header.stamp)
            moved = dict(zip(moves, moments[1:], strict=True))
            self._state.push_goal(soonest(goal, moments[0], moved, stamp))

        for number, question in enumerate(questions):
            request = WhatIf.Request(
                times=list(question.times),
                levels=list(question.levels),
                horizon=question.horizon,
                level=[goal.level],
            )
            self._call(
                self._what_if,
                request,
                "the discriminator",
                partial(take, number),
                _ignored,
            )

    def next_experiment(self, *, run: bool = False, stop: bool = False) -> None:
        """Ask which experiment to do next, have it run, or stop the one that runs."""
        if self.control:
            request = Experiment.Request(run=run, stop=stop)
            self._call(
                self._experiment, request, "the discriminator", self._show_result
            )

    def continue_profile(self) -> None:
        """Have the controller continue its profile, which has waited since an experiment began."""
        if self.control:
            not_followed = ParameterValue(
                type=ParameterType.PARAMETER_BOOL, bool_value=False
            )
            parameters = [Parameter(name="course.followed", value=not_followed)]
            request = SetParametersAtomically.Request(parameters=parameters)
            self._call(self._course, request, "the controller", self._show_profile)

    def law_back(self) -> None:
        """Put the law back that the controller had before the one on trial."""
        if self.control:
            self._call(
                self._law,
                ApplyLaw.Request(back=True),
                "the controller",
                self._show_result,
            )

    def clear_fault(self) -> None:
        """Allow the output to be driven again after a fault."""
        if self.control:
            self._call(self._clear, Trigger.Request(), DRIVER, self._show_result)

    def stop(self) -> None:
        """Hold the output at zero."""
        if self.control:
            self._call(self._stop, Trigger.Request(), DRIVER, self._show_result)

    def set_point(self, level: float) -> None:
        """Send the controller a set-point, once its parameters show that it follows one."""
        if self.control:
            request = GetParameters.Request(names=list(SOURCE))
            send = partial(self._send_set_point, level)
            self._call(self._limits, request, "the controller", send)

    def _send_set_point(self, level: float, answer: Any) -> None:
        values = {
            name: value
            for name, value in zip(SOURCE, answer.values, strict=False)
            if value.type
        }
        if len(values) < len(SOURCE):
            self._show_refusal(
                "the controller does not report which set-points it follows"
            )
            return
        unit = self._state.described.reference.unit
        low = values["profile.lowest"].double_value
        high = values["profile.highest"].double_value
        if values["reference_source"].string_value != "topic":
            why = "the controller follows its own profile; start it with reference_source: topic"
            self._show_refusal(why)
        elif not (math.isfinite(level) and low <= level <= high):
            why = f"{level:g} {unit} not set: the controller allows {low:g} to {high:g} {unit}"
            self._show_refusal(why)
        elif self._reference is None:
            self._show_refusal(
                "not set: neither a sample nor a description of the plant has come yet"
            )
        else:
            self._reference.publish(Float64(data=level))
            confirmation = f"requested {level:g} {unit}; the set-point above follows with the next sample"
            self._state.notify(confirmation, done=True)

    def _call(
        self,
        client: Any,
        request: Any,
        server: str,
        take_answer: Callable[[Any], None],
        show_failure: Callable[[str], None] | None = None,
    ) -> None:
        """Call a service, in the node's thread; `server` names the node that offers it.

        `show_failure` gets the reason if the service is missing; by default it is shown as the result.
        """

        def call() -> None:
            if not client.service_is_ready():
                show = show_failure or self._show_refusal
                show(f"{server} is not running (no service {client.srv_name})")
            else:
                client.call_async(request).add_done_callback(done)

        def done(future: Any) -> None:
            answer = future.result()
            if answer is not None and self._node.entrance.passes(
                client.srv_name, answer
            ):
                take_answer(answer)

        self._run_in_node(call)

    def _show_refusal(self, why: str) -> None:
        self._state.notify(why, done=False)

    def _show_result(self, answer: Any) -> None:
        self._state.notify(answer.message, done=answer.success)

    def _show_profile(self, answer: Any) -> None:
        confirmation = "the controller's profile continues where it was"
        self._state.notify(
            answer.result.reason or confirmation, done=answer.result.successful
        )

    def _show_rate_result(self, answer: Any) -> None:
        for result in answer.results:
            if not result.successful:
                self._show_refusal(result.reason)
