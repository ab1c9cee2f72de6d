"""inverse: fit the unknowns of any differentiable simulator to what was measured.

`Problem` names the data, the unknowns and three functions (replace, simulate, observe); `fit` finds the
values and says how sure they are; `check` compares the derivatives with finite differences.
"""

from inverse.fit import fit
from inverse.gradient_check import GradientCheck, check
from inverse.model import RunFailed
from inverse.observations import Observations
from inverse.problem import Problem
from inverse.report import Fit
from inverse.transforms import linear, log
from inverse.uncertainty import Uncertainty

__all__ = [
    "Fit",
    "GradientCheck",
    "Observations",
    "Problem",
    "RunFailed",
    "Uncertainty",
    "check",
    "fit",
    "linear",
    "log",
]
