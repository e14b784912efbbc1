"""Dynamics."""

from twinmatch.dynamics.declarations import Declaration, Disturbance, Drive, Output, Parameter, State, Structure
from twinmatch.dynamics.equations import Equations
from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.functions import limited, magnitude, maximum, minimum
from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.pid import Pid, PidGains, PidState, controller_state
from twinmatch.dynamics.plant import Plant
from twinmatch.dynamics.sensor import Sensor, SensorRealisation
from twinmatch.dynamics.model import Model
