"""Which model explains the plant best, and how far apart two models are.

`code_length` and `information_gain` measure, in characters, what a model leaves unexplained. `naic`, `bic`
and `mdl` weigh its prediction errors against the number of its parameters. `nu_gap` is the distance between
two models that matters for feedback: it is small where one controller serves both. `stability_margin` gives
the ν-gap up to which a given controller still stabilises: `loop_controller`, the running PID, for one. Both
take a `StateSpace` with any number of inputs and outputs; `best_scaling` finds units of the signals in which
a controller's margin exceeds the ν-gaps of a family by most.

The judgement of a `Family` of candidates is built on these: `twin_response` runs a candidate's twin on its
window, `identify` estimates Box–Jenkins models of the response, and `score` compares them with the measured
window. `plant_gaps` computes the ν-gaps between the candidates' plants, `nominal_of` selects the candidate
nearest to all others, and `judge_uncertainty` gives the uncertainty of all this. A `Verdict` carries the
result, and `statements_of` says what it means for trust and faults.
"""

from twinmatch.comparing.certainty import DECIDED_FROM, judge_uncertainty, nominal_of
from twinmatch.comparing.code_length import (
    code_length,
    information_gain,
    two_part_length,
)
from twinmatch.comparing.criteria import (
    OrderScore,
    akaike_weights,
    bic,
    choose_order,
    common_order,
    mdl,
    naic,
    score,
    score_orders,
)
from twinmatch.comparing.doubts import (
    BASELINES,
    FEW,
    Shortfall,
    doubt_words,
    number_list,
)
from twinmatch.comparing.forecast_score import ForecastScore, SignalScore
from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.margin import loop_controller, stability_margin
from twinmatch.comparing.matrix_gap import matrix_margin, matrix_nu_gap
from twinmatch.comparing.models import (
    Candidate,
    Family,
    SimoModel,
    identify,
    twin_response,
)
from twinmatch.comparing.nu_gap import nu_gap, nu_gap_matrix
from twinmatch.comparing.plant_gap import (
    LoopConditions,
    plant_gap,
    plant_gaps,
    spans_of,
)
from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.comparing.scaling import Scaling, best_scaling
from twinmatch.comparing.state_space import StateSpace
from twinmatch.comparing.statements import (
    ANYWHERE,
    NOWHERE,
    FaultStatement,
    Statements,
    TrustStatement,
    ahead_words,
    fault_of_drive,
    plant_fault,
    statements_of,
)
from twinmatch.comparing.undefined import UndefinedError, having_value
from twinmatch.comparing.verdict import (
    ADMITTED,
    LEVEL_WORDS,
    REFUSED,
    CandidateScore,
    TrustLevel,
    Verdict,
)

__all__ = [
    "ADMITTED",
    "ANYWHERE",
    "BASELINES",
    "DECIDED_FROM",
    "FEW",
    "LEVEL_WORDS",
    "NOWHERE",
    "REFUSED",
    "Candidate",
    "CandidateScore",
    "DiscriminationError",
    "Family",
    "FaultStatement",
    "ForecastScore",
    "GraphSymbol",
    "LoopConditions",
    "OrderScore",
    "Scaling",
    "Shortfall",
    "SignalScore",
    "SimoModel",
    "StateSpace",
    "Statements",
    "TrustLevel",
    "TrustStatement",
    "UndefinedError",
    "Verdict",
    "ahead_words",
    "akaike_weights",
    "best_scaling",
    "bic",
    "choose_order",
    "code_length",
    "common_order",
    "doubt_words",
    "fault_of_drive",
    "having_value",
    "identify",
    "information_gain",
    "judge_uncertainty",
    "loop_controller",
    "matrix_margin",
    "matrix_nu_gap",
    "mdl",
    "naic",
    "nominal_of",
    "nu_gap",
    "nu_gap_matrix",
    "number_list",
    "plant_fault",
    "plant_gap",
    "plant_gaps",
    "score",
    "score_orders",
    "spans_of",
    "stability_margin",
    "statements_of",
    "twin_response",
    "two_part_length",
]
