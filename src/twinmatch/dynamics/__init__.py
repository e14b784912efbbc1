"""From a plant's equations to everything that is computed from them, for any plant.

A `Plant` declares its quantities and its equations in SymPy; its `Structure`s say which parts are included
and which parameters are unknown. `Plant.model` gives a `Model`, whose compiled code is generated from the
equations once and kept on disk. `Parameters` are the values for a model, and all functions take them:
`begin`, `advance` and `read` step a plant; `simulate_closed_loop`, `simulate_driven` and `simulate_window`
run it; `Experiment` is a recorded window as a function of the unknowns, with exact tangents; `linearised`
gives the response to small deviations; `Observer` estimates unmeasured states; `Foresight` forecasts
the loop from there, with variances. `PidGains`, `TwoLevel`, `LinearLaw` and `PidLoops` are
controllers, and `Sensor` is the model from output to reading.
"""

from twinmatch.dynamics.declarations import (
    Disturbance,
    Drive,
    ExternalEquations,
    Output,
    Parameter,
    PlantError,
    State,
    Structure,
    StructureLostError,
)
from twinmatch.dynamics.definition import Equations
from twinmatch.dynamics.descent import Descended, box_step, descend
from twinmatch.dynamics.experiment import Experiment, Known, sensitivities
from twinmatch.dynamics.forecasts import Foresight, LoopForecast, noise_scores
from twinmatch.dynamics.laws import LawCode, commands_of
from twinmatch.dynamics.linear import (
    Linear,
    Rest,
    largest_eigenvalue,
    linearised,
    linearised_at,
    loop_matrix,
    rest_at,
)
from twinmatch.dynamics.loop import (
    Controller,
    Law,
    LinearLaw,
    PidGains,
    PidState,
    TwoLevel,
    controller_state,
)
from twinmatch.dynamics.observer import Observer, ObserverBank, RandomWalk
from twinmatch.dynamics.pids import PidLoops, pids_of
from twinmatch.dynamics.plant import Model, Parameters, Plant, channel, channels
from twinmatch.dynamics.runs import Tangents
from twinmatch.dynamics.sensor import Sensor, SensorRealisation
from twinmatch.dynamics.simulation import (
    FROM_PLANT_FILE,
    SKIPPED,
    FromPlantFile,
    LoopLaw,
    Response,
    advance,
    advance_long,
    advance_side_by_side,
    begin,
    begin_window,
    law_for,
    law_of,
    pid_of,
    quantities,
    read,
    readings,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)
from twinmatch.dynamics.terms import (
    DeadTime,
    dead_times_of,
    dead_zone,
    dry_friction,
    limited,
    magnitude,
    maximum,
    minimum,
)

__all__ = [
    "FROM_PLANT_FILE",
    "SKIPPED",
    "Controller",
    "DeadTime",
    "Descended",
    "Disturbance",
    "Drive",
    "Equations",
    "Experiment",
    "ExternalEquations",
    "Foresight",
    "FromPlantFile",
    "Known",
    "Law",
    "LawCode",
    "Linear",
    "LinearLaw",
    "LoopForecast",
    "LoopLaw",
    "Model",
    "Observer",
    "ObserverBank",
    "Output",
    "Parameter",
    "Parameters",
    "PidGains",
    "PidLoops",
    "PidState",
    "Plant",
    "PlantError",
    "RandomWalk",
    "Response",
    "Rest",
    "Sensor",
    "SensorRealisation",
    "State",
    "Structure",
    "StructureLostError",
    "Tangents",
    "TwoLevel",
    "advance",
    "advance_long",
    "advance_side_by_side",
    "begin",
    "begin_window",
    "box_step",
    "channel",
    "channels",
    "commands_of",
    "controller_state",
    "dead_times_of",
    "dead_zone",
    "descend",
    "dry_friction",
    "largest_eigenvalue",
    "law_for",
    "law_of",
    "limited",
    "linearised",
    "linearised_at",
    "loop_matrix",
    "magnitude",
    "maximum",
    "minimum",
    "noise_scores",
    "pid_of",
    "pids_of",
    "quantities",
    "read",
    "readings",
    "rest_at",
    "sensitivities",
    "simulate_closed_loop",
    "simulate_driven",
    "simulate_window",
]
