"""What a fit can and can't say: standard errors, correlations, identifiability, signs of model error.

With J the Jacobian of the normalized residuals in internal coordinates z at the optimum, cov(z) =
s^2 (J^T J)^-1, carried to the values by the delta method; s^2 = chi^2 / (data - unknowns) is the reduced
chi-square.
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
    scaled = scale * unit_error * slopes

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

    assumed = np.fmax(scale, floor)
    with np.errstate(divide="ignore"):
        alone = assumed / np.linalg.norm(evaluation.jacobian, axis=0)
    relative = {
        name: problem.relative_errors(z, error)
        for name, error in {
            "scaled": scale * unit_error,
            "verdict": assumed * np.sqrt(np.diag(whole)),
            "alone": alone,
        }.items()
    }
    members = tuple(label for label, inside in zip(model.labels, collinear, strict=True) if inside)
    judgement, reasons = verdict(
        model.labels, relative["verdict"], relative["alone"], collinear, condition, _correlation(whole)
    )
    covariance = scale**2 * unit * np.outer(slopes, slopes)
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
