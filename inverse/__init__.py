"""inverse: fit the unknowns of any differentiable simulator to what was measured.

`Problem` names the data, the unknowns and three functions (replace, simulate, observe); `fit` finds the
values and says how sure they are; `check` compares the derivatives with finite differences. `coarse_to_fine` gets a
fine model's answer from coarse ones, `calibrations` shows what accuracy costs.
"""

from inverse.coarse_to_fine import CoarseToFine, coarse_to_fine
from inverse.fit import fit
from inverse.gradient_check import GradientCheck, check
from inverse.model import RunFailed
from inverse.observations import Observations
from inverse.problem import Problem
from inverse.report import Fit
from inverse.shooting import multiple_shooting
from inverse.study import Calibration, calibrations
from inverse.tangent_growth import TangentGrowth, tangent_growth
from inverse.transforms import linear, log
from inverse.uncertainty import Uncertainty

__all__ = [
    "Calibration",
    "CoarseToFine",
    "Fit",
    "GradientCheck",
    "Observations",
    "Problem",
    "RunFailed",
    "TangentGrowth",
    "Uncertainty",
    "calibrations",
    "check",
    "coarse_to_fine",
    "fit",
    "linear",
    "log",
    "multiple_shooting",
    "tangent_growth",
]
