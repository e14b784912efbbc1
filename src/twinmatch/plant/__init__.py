"""What the rig is: a Peltier plate on a heat sink, its driver, its camera and its controller.

`RigParameters` are the numbers that tell one rig from another. `simulate_closed_loop` runs plate, camera
and PID over a reference, `simulate_driven` runs the plate under a given PWM, and `advance` moves it by one
tick; all three share the same compiled arithmetic, so that a twin stepped live and a simulation of the
whole run agree to the last bit. On a sink held at constant temperature a tick is exact, with the current
limiter's switching found in closed form; a sink with mass and a Seebeck coefficient that depends on
temperature are integrated by Runge–Kutta. The camera may see the plate through a lag, and the module may
feel the switching of its bridge. `Pid` is the rig's controller and `controller_state` recovers its memory
from a window that starts in mid-session.
Signals are in °C, the temperatures of the plant in kelvin; positive PWM heats the plate.
"""

from twinmatch.plant.camera import Camera, CameraRealisation
from twinmatch.plant.driver import Driver
from twinmatch.plant.parameters import (
    PARAMETER_NAMES,
    SEEBECK_REFERENCE,
    PlantError,
    PlantState,
    RigParameters,
)
from twinmatch.plant.pid import Pid, PidGains, PidState, controller_state
from twinmatch.plant.rig import (
    HeatFlows,
    Response,
    advance,
    heat_flows,
    noise_sensitivity,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)

__all__ = [
    "PARAMETER_NAMES",
    "SEEBECK_REFERENCE",
    "Camera",
    "CameraRealisation",
    "Driver",
    "HeatFlows",
    "Pid",
    "PidGains",
    "PidState",
    "PlantError",
    "PlantState",
    "Response",
    "RigParameters",
    "advance",
    "controller_state",
    "heat_flows",
    "noise_sensitivity",
    "simulate_closed_loop",
    "simulate_driven",
    "simulate_window",
]
