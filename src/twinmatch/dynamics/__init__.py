"""From a plant's equations to everything that is computed from them, for any plant.

A `Plant` declares its quantities and its equations in SymPy; its `Structure`s say which parts are included
and which parameters are unknown. `Plant.model` gives a `Model`, whose compiled code is generated from the
equations once and kept on disk. `Parameters` are the values for a model, and all functions take them:
`begin`, `advance` and `read` step a plant; `simulate_closed_loop`, `simulate_driven` and `simulate_window`
run it; `Experiment` is a recorded window as a function of the unknowns, with exact tangents; `linearised`
gives the response to small deviations; `Observer` estimates unmeasured states; `foretell` forecasts the loop
from there, with variances. `Pid` is the controller, `Sensor` the model from output to reading.
"""

from twinmatch.dynamics.ahead import Foretold, foretell
from twinmatch.dynamics.closing import FILED, Closing, Filed, gains_for, gains_of
from twinmatch.dynamics.dead_time import DeadTime
from twinmatch.dynamics.declarations import Disturbance, Drive, Output, Parameter, State, Structure
from twinmatch.dynamics.descent import Descended, box_step, descend
from twinmatch.dynamics.elsewhere import Elsewhere
from twinmatch.dynamics.equations import Equations
from twinmatch.dynamics.errors import PlantError, StructureLostError
from twinmatch.dynamics.experiment import Experiment, Known, Tangents
from twinmatch.dynamics.functions import limited, magnitude, maximum, minimum
from twinmatch.dynamics.linear import Linear, Rest, linearised, linearised_at, rest_at
from twinmatch.dynamics.model import Model
from twinmatch.dynamics.noise import noise_scores
from twinmatch.dynamics.observer import Observer, Wander
from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.pid import Pid, PidGains, PidState, controller_state
from twinmatch.dynamics.plant import Plant
from twinmatch.dynamics.sensor import Sensor, SensorRealisation
from twinmatch.dynamics.simulation import (
    SKIPPED,
    Response,
    advance,
    begin,
    begin_window,
    quantities,
    read,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)

__all__ = [
    "FILED",
    "SKIPPED",
    "Closing",
    "DeadTime",
    "Descended",
    "Disturbance",
    "Drive",
    "Elsewhere",
    "Equations",
    "Experiment",
    "Filed",
    "Foretold",
    "Known",
    "Linear",
    "Model",
    "Observer",
    "Output",
    "Parameter",
    "Parameters",
    "Pid",
    "PidGains",
    "PidState",
    "Plant",
    "PlantError",
    "Response",
    "Rest",
    "Sensor",
    "SensorRealisation",
    "State",
    "Structure",
    "StructureLostError",
    "Tangents",
    "Wander",
    "advance",
    "begin",
    "begin_window",
    "box_step",
    "controller_state",
    "descend",
    "foretell",
    "gains_for",
    "gains_of",
    "limited",
    "linearised",
    "linearised_at",
    "magnitude",
    "maximum",
    "minimum",
    "noise_scores",
    "quantities",
    "read",
    "rest_at",
    "simulate_closed_loop",
    "simulate_driven",
    "simulate_window",
]
