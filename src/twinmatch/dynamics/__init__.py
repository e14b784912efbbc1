"""From a plant's equations to everything that is computed from them; knows no plant.

A `Plant` declares its quantities and writes its equations in SymPy, and its `Structure`s say which parts
there are and what is unknown. `Plant.model` gives a `Model`, whose compiled code is made from the equations
once and kept on disk. `Parameters` are values for one; everything else takes them: `begin`, `advance`
and `read` step a plant, `simulate_closed_loop`, `simulate_driven` and `simulate_window` run it, `Experiment`
is a recorded window as a function of what is unknown, with exact tangents, `linearised` says how the plant
answers small movements, `Observer` follows the states that no sensor shows, and `foretell` says what the
loop will do from there and how surely. `Pid` is the controller that holds it, `Sensor` what lies between its
output and a reading.
"""

from twinmatch.dynamics.ahead import Foretold, foretell
from twinmatch.dynamics.closing import FILED, Closing, Filed, gains_for, gains_of
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
