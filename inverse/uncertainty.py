"""What a fit can and can't say: standard errors, correlations, identifiability, signs of model error.

With J the Jacobian of the normalized residuals in internal coordinates z at the optimum, cov(z) =
s^2 (J^T J)^-1, carried to the values by the delta method; s^2 = chi^2 / (data - unknowns) is the reduced
chi-square. Where no noise is stated and several columns are observed, each has an s of its own:
(J^T J)^-1 (sum_c s_c^2 J_c^T J_c) (J^T J)^-1, which holds whatever their noise (H. White 1980, doi:10.2307/1912934).
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.stats

from inverse.identifiability import ACCURACY, unit_covariance, verdict
from inverse.model import Evaluation, Model

CONFIDENCE = 0.99  # of the interval in which a reduced chi-square is consistent with 1
LAG_ONE_LIMIT = 0.3  # lag-one autocorrelation of the residual from which it counts as systematic ...
LAG_ONE_SIGMAS = 3.0  # ... if it is also that many of its own standard deviations (1 / sqrt(T)) from zero
UNLIKE = 3.0  # ratio of the residuals of two columns from which it is said that they do not weigh alike
NEGLIGIBLE = 0.01  # misfits below this fraction of ACCURACY are as good as none


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Statistics of a fit of n unknowns; arrays (n,) or (n, n) follow `labels`, NaN for unknowns at a bound.

    standard_error: in the unit of the value, scaled by the residual (s). standard_error_absolute: from the
    given standard deviations alone (None if none were given). standard_error_corrected: scaled, and enlarged
    for the effective number of independent samples. relative_error: standard_error as a fraction of the value
    (log) or of the range (linear). correlation: of all unknowns together, those at a bound included. alone:
    relative error if all other unknowns were known. All relative errors of the verdict, `verdict_error`,
    assume a noise of at least ACCURACY times the signal.
    """

    labels: tuple[str, ...]
    at_bound: tuple[str, ...]  # "lower", "upper" or "" per unknown
    standard_error: np.ndarray
    standard_error_absolute: np.ndarray | None
    standard_error_corrected: np.ndarray
    relative_error: np.ndarray
    covariance: np.ndarray
    correlation: np.ndarray
    condition_number: float
    verdict_error: np.ndarray
    alone: np.ndarray
    collinear: tuple[str, ...]
    verdict: str
    degrees_of_freedom: int
    reduced_chi_square: float
    chi_square_interval: tuple[float, float] | None
    lag_one: np.ndarray  # (m,) lag-one autocorrelation of the residual per observed column
    durbin_watson: np.ndarray  # (m,) 2 without autocorrelation, 0 with full
    effective_samples: float
    messages: tuple[str, ...]


def estimate(model: Model, evaluation: Evaluation) -> Uncertainty:
    """Statistics at the optimum `evaluation` (with a Jacobian)."""
    problem, z, residual = model.problem, evaluation.z, evaluation.residual
    lower, upper = problem.bounds
    near = 1e-6 * (upper - lower)
    at_bound = tuple(
        "lower" if a else "upper" if b else "" for a, b in zip(z <= lower + near, z >= upper - near, strict=True)
    )
    free = np.array([side == "" for side in at_bound])
    degrees = len(residual) - problem.empty_rows - int(np.sum(free))
    chi_square = float(residual @ residual)
    variance = chi_square / degrees if degrees > 0 else np.nan
    given = problem.data.standard_deviations is not None

    unit, _, _ = unit_covariance(evaluation.jacobian, free)
    # What the data can tell is a matter of all unknowns: one that ran into its bound may have done so because
    # nothing held it, and the others' errors are then those at that bound only.
    whole, condition, collinear = unit_covariance(evaluation.jacobian, np.full(len(z), True))
    unit_error = np.sqrt(np.diag(unit))
    by_column = np.sqrt(np.mean(residual.reshape(-1, model.width) ** 2, axis=0))
    slopes = problem.slopes(z)
    messages = [
        f"{label} is at its {side} bound {value:g}: the bound was met, not the data; widen it if you can"
        for label, side, value in zip(model.labels, at_bound, problem.vector(z), strict=True)
        if side
    ]

    interval = None
    if degrees <= 0:
        messages.append(
            f"{len(residual)} data for {int(np.sum(free))} unknowns leave nothing to estimate the noise "
            "from" + ("" if given else "; give standard deviations")
        )
        variance = 1.0 if given else np.nan
    elif given:
        tail = 0.5 * (1 - CONFIDENCE)
        low, high = (float(scipy.stats.chi2.ppf(q, degrees)) / degrees for q in (tail, 1 - tail))
        interval = (low, high)
        if variance > high:
            messages.append(
                f"model error: the residual is {np.sqrt(variance):.3g} times the stated noise (reduced "
                f"chi-square {variance:.3g}, consistent with 1 within {low:.2f}-{high:.2f})"
            )
        elif variance < low:
            messages.append(
                f"the residual is only {np.sqrt(variance):.3g} times the stated noise (reduced chi-square "
                f"{variance:.3g}): the standard deviations look too large"
            )
    scale = np.sqrt(variance)
    internal = variance * unit
    if not given and model.width > 1 and degrees > 0:
        internal = _of_unlike_columns(evaluation.jacobian, unit, free, by_column**2 * len(residual) / degrees)
    error = np.sqrt(np.diag(internal))
    scaled = error * slopes

    lag_one, durbin_watson, fraction = _autocorrelation(residual.reshape(-1, model.width))
    corrected = scaled / np.sqrt(fraction)
    strong = (lag_one > LAG_ONE_LIMIT) & (lag_one * np.sqrt(len(problem.data)) > LAG_ONE_SIGMAS)
    # the rest that a finished iteration leaves of a perfect fit is correlated too, and no one's concern
    floor = ACCURACY * float(np.max(problem.data.amplitude)) / float(np.sqrt(np.mean(model.deviation**2)))
    visible = np.sqrt(np.mean(residual**2)) > NEGLIGIBLE * floor
    if np.any(strong) and visible:
        worst = int(np.argmax(np.abs(lag_one)))
        messages.append(
            f"model error: the residual of {problem.data.columns[worst]} is systematic (lag-one "
            f"autocorrelation {lag_one[worst]:.2f}, Durbin-Watson {durbin_watson[worst]:.2f}): the "
            f"standard error understates; {fraction * len(residual):.0f} of {len(residual)} samples are "
            "independent, see the corrected one"
        )

    if not given and model.width > 1 and visible and by_column.max() > UNLIKE * by_column.min():
        sizes = ", ".join(
            f"{size:.2g} of {name}"
            for size, name in zip(by_column * model.deviation[0], problem.data.columns, strict=True)
        )
        messages.append(
            f"without stated noise all columns weigh alike, and those with small residuals hardly count (rms {sizes}); "
            "give noise= of each"
        )

    # noise of at least ACCURACY of its own amplitude in every column
    size = np.tile(ACCURACY * np.ravel(problem.data.amplitude), len(problem.data)) / model.deviation
    weighed = evaluation.jacobian / np.fmax(scale, np.fmax(size, np.finfo(float).tiny))[:, None]
    assumed, _, _ = unit_covariance(weighed, np.full(len(z), True))
    with np.errstate(divide="ignore"):
        alone = 1 / np.linalg.norm(weighed, axis=0)
    relative = {
        name: problem.relative_errors(z, error)
        for name, error in {
            "scaled": error,
            "verdict": np.sqrt(np.diag(assumed)),
            "alone": alone,
        }.items()
    }
    members = tuple(label for label, inside in zip(model.labels, collinear, strict=True) if inside)
    judgement, reasons = verdict(
        model.labels, relative["verdict"], relative["alone"], collinear, condition, _correlation(whole)
    )
    covariance = internal * np.outer(slopes, slopes)
    return Uncertainty(
        labels=tuple(model.labels),
        at_bound=at_bound,
        standard_error=scaled,
        standard_error_absolute=unit_error * slopes if given else None,
        standard_error_corrected=corrected,
        relative_error=relative["scaled"],
        covariance=covariance,
        correlation=_correlation(whole),
        condition_number=condition,
        verdict_error=relative["verdict"],
        alone=relative["alone"],
        collinear=members,
        verdict=judgement,
        degrees_of_freedom=degrees,
        reduced_chi_square=variance if degrees > 0 else np.nan,
        chi_square_interval=interval,
        lag_one=lag_one,
        durbin_watson=durbin_watson,
        effective_samples=fraction * len(residual),
        messages=tuple(reasons + messages),
    )


def _of_unlike_columns(jacobian: np.ndarray, unit: np.ndarray, free: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Covariance of the unknowns, NaN for those that are not free, if every column (m,) has its own variance."""
    used = free & np.isfinite(np.diag(unit))  # not those without any influence
    inverse, rows = unit[np.ix_(used, used)], np.tile(variances, len(jacobian) // len(variances))
    found = unit.copy()
    spread = (jacobian[:, used] * rows[:, None]).T @ jacobian[:, used]
    found[np.ix_(used, used)] = inverse @ spread @ inverse
    return found


def _correlation(covariance: np.ndarray) -> np.ndarray:
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        correlation = np.clip(covariance / np.outer(errors, errors), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _autocorrelation(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Lag-one autocorrelation and Durbin-Watson per column (T, m), and the fraction of independent samples.

    A first-order autoregressive residual has T (1 - rho) / (1 + rho) independent samples (Bayley & Hammersley
    1946, doi:10.2307/2983560). The model's mean offset is part of the error, so the mean is not taken out.
    """
    power = np.sum(residual**2, axis=0)
    power = np.where(power > 0, power, 1.0)
    lag_one = np.sum(residual[1:] * residual[:-1], axis=0) / power
    durbin_watson = np.sum(np.diff(residual, axis=0) ** 2, axis=0) / power
    rho = np.clip(lag_one, 0.0, 1 - 1 / max(len(residual), 2))
    weight = power / np.sum(power)
    return lag_one, durbin_watson, float(1 / np.sum(weight * (1 + rho) / (1 - rho)))
