"""May a controller be run on a plant that is known only as well as its recordings show?

A `TriedTwin` is a twin with what its recording leaves open. `try_controller` tries a law on every twin and on
draws of its parameters: the eigenvalues of the `WholeLoop` decide, its margins say how far it is from
instability, and the compiled loop with its limits says what happens. `pid_law` makes a linear law of PIDs
with filters and set-point weights, `law_from` a law of a document. `next_experiment` finds the course after
which most is known.
"""

from twinmatch.controllers.answer import (
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    Spread,
    levels_words,
    try_controller,
)
from twinmatch.controllers.courses import ExperimentTerms, Staircase
from twinmatch.controllers.experiment_search import CourseWorth
from twinmatch.controllers.guarantee import Guarantee
from twinmatch.controllers.law_document import (
    gains_from,
    law_from,
    pid_document,
    suited,
)
from twinmatch.controllers.learning_goals import (
    GOALS,
    Contender,
    LearningGoal,
    goal_named,
)
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.next_experiment import (
    NextExperiment,
    bits_by,
    next_experiment,
)
from twinmatch.controllers.responses import CourseFigure
from twinmatch.controllers.retuning import AIMS, Retuned, retune
from twinmatch.controllers.stability import MemberStability
from twinmatch.controllers.track_record import LawComparison, compared, widened
from twinmatch.controllers.trying import TrialAnswer, try_now
from twinmatch.controllers.whole_loop import WholeLoop
from twinmatch.dynamics.pids import FilteredPid, as_linear, pid_law

__all__ = [
    "AIMS",
    "GOALS",
    "Contender",
    "ControllerAnswer",
    "ControllerDecision",
    "ControllerError",
    "ControllerQuestion",
    "CourseFigure",
    "CourseWorth",
    "ExperimentTerms",
    "FilteredPid",
    "Guarantee",
    "Holding",
    "LawComparison",
    "LearningGoal",
    "MemberStability",
    "NextExperiment",
    "Retuned",
    "Spread",
    "Staircase",
    "TrialAnswer",
    "TriedTwin",
    "WholeLoop",
    "as_linear",
    "bits_by",
    "compared",
    "gains_from",
    "goal_named",
    "law_from",
    "levels_words",
    "next_experiment",
    "pid_document",
    "pid_law",
    "retune",
    "suited",
    "try_controller",
    "try_now",
    "widened",
]
