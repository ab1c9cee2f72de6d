"""Settings for a scene of one's own, from a few short runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsph.accuracy.laws import CostLaw, PowerLaw, error_of_differences
from jaxsph.accuracy.results import Number, Results, Value
from jaxsph.accuracy.study import Study, line

FAR = 4.0
"""Times the finest resolution that was run, beyond which an extrapolation is called far."""


@dataclass(frozen=True, eq=False)
class Recommendation:
    """Settings to take.

    Attributes:
        settings: {name: value}, the resolution among them.
        error, seconds: that are expected, of the whole run, without compiling.
        order: of convergence: the error goes as resolution^-order.
        growth: the cost goes as resolution^growth at the one that is recommended.
        runs: that this rests on.
        messages: what to be careful about.
    """

    settings: dict[str, Value]
    error: float
    seconds: float
    order: float
    growth: float
    runs: Results
    messages: tuple[str, ...] = ()

    def __str__(self) -> str:
        about = ", ".join(f"{name} = {value}" for name, value in self.settings.items() if value is not None)
        lines = [
            f"take {about}",
            f"  expected: error {self.error:.2g}, {_duration(self.seconds)} without compiling",
            f"  from {len(self.runs)} runs: error ~ resolution^-{self.order:.2f}, time ~ resolution^{self.growth:.2f}",
        ]
        return "\n".join(lines + [f"! {message}" for message in self.messages])


def recommend(
    study: Study,
    tolerance: Number | None = None,
    seconds: Number | None = None,
    *,
    resolutions: Sequence[Number],
    settings: Mapping[str, Value] | None = None,
    error: str | None = None,
    confirm: bool = True,
    show: bool = True,
) -> Recommendation:
    """The resolution for an error, or for a time, by extrapolating a few coarse runs; printed.

    The order of convergence comes from the errors of these runs; of a study that only observes, without a reference,
    from how they differ from each other, which needs three. The time comes from steps and particles, each with its
    price.

    Args:
        study: of the scene.
        tolerance: error to reach.
        seconds: or the time that there is, without compiling.
        resolutions: to run, from coarse to fine, such as (10, 14, 20): at least two, without a reference three.
        settings: the others, for all runs.
        error: which one; None is the first.
        confirm: run the settings that are recommended to the first save and take the time from there. Not for a
            tolerance that makes them a guess: such a scene may be larger than any machine.
        show: print the runs and the recommendation.

    Raises:
        ValueError: neither or both of tolerance and seconds; too few resolutions; runs that fail; errors that do not
            fall with the resolution: another setting limits them.
    """
    if (tolerance is None) == (seconds is None):
        raise ValueError("recommend for a tolerance= or for seconds=: one of the two")
    if study.resolution is None:
        raise ValueError("the study names no resolution= to refine")
    fixed, n = dict(settings or {}), sorted(resolutions)
    blind = study.observe is not None and study.reference is None
    if len(set(n)) < (3 if blind else 2):
        raise ValueError(f"{len(set(n))} resolutions; without a reference three are needed, with one two")
    rows, seen, messages = [], [], []
    for one in n:
        row, observed = study.measure({study.resolution: one, **fixed})
        if row.failure:
            raise ValueError(f"the run at {study.resolution} = {one} failed: {row.failure}")
        rows.append(row)
        seen.append(observed)
        if show:
            print(line(row), flush=True)
    runs = Results(tuple(rows), study.resolution, study.title)
    if blind:
        law = error_of_differences(n, seen)
        if law is None:
            raise ValueError(
                f"the runs at {study.resolution} = {n} do not approach each other as a power of the resolution: take "
                "finer ones, or observe a quantity that is not chaotic"
            )
    else:
        law = PowerLaw.through(n, np.maximum(runs[runs.error_name(error)], 1e-300))
        apart = np.abs(np.log(law(n) / runs[runs.error_name(error)]))
        if len(n) > 2 and np.max(apart) > math.log(1.5):
            messages.append("the errors scatter around a power law by more than a factor 1.5: take finer runs")
    order = -law.exponent
    if not order > 0:
        raise ValueError(
            f"the error does not fall with {study.resolution} (order {order:.2f}): another setting limits it; vary "
            "kernel, neighbors, step_fraction or effects"
        )
    cost = CostLaw.through(n, rows)
    chosen = _resolution(law, cost, tolerance, seconds, whole=all(float(one).is_integer() for one in n))
    far = chosen > FAR * n[-1]
    if far:
        messages.append(f"{chosen:.4g} is more than {FAR:g} times the finest run: a guess; run something in between")
    if chosen < n[0]:
        messages.append(f"{chosen:.4g} is coarser than all that was run")
    expected, taken = float(cost(chosen)), {study.resolution: chosen, **fixed}
    if confirm and (not far or seconds is not None) and study.save_every is not None and study.save_every < study.t_end:
        expected, note = _confirmed(study, taken, expected)
        messages += [note] if note else []
    growth = float(np.log(cost(1.01 * chosen) / cost(chosen)) / math.log(1.01))
    found = Recommendation(taken, float(law(chosen)), expected, order, growth, runs, tuple(messages))
    if show:
        print(found, flush=True)
    return found


def _resolution(law: PowerLaw, cost: CostLaw, tolerance, seconds, whole: bool):
    if tolerance is not None:
        wanted = (law.factor / tolerance) ** (-1 / law.exponent)
        return math.ceil(wanted - 1e-9) if whole else wanted
    from scipy.optimize import brentq

    apart = lambda log_n: math.log(float(cost(math.exp(log_n))) / seconds)  # noqa: E731
    low, high = 0.0, 30.0
    if apart(low) > 0:
        raise ValueError(f"{seconds:.3g} s are too few for any resolution")
    wanted = math.exp(float(brentq(apart, low, high)))  # type: ignore[arg-type]
    return math.floor(wanted + 1e-9) if whole else wanted


def _confirmed(study: Study, settings, expected: float) -> tuple[float, str]:
    """Seconds of the whole run from those to its first save; what is to be said of it."""
    assert study.save_every is not None
    short = replace(study, t_end=study.save_every, error_of=lambda run: math.nan, observe=None, reference=None)
    row, _ = short.measure(settings)
    if row.failure:
        return expected, f"the start of such a run failed: {row.failure}"
    found = row.seconds * study.t_end / study.save_every
    if not 0.5 < found / expected < 2:
        return found, f"coarse runs promised {_duration(expected)}, the start of such a run {_duration(found)}"
    return found, ""


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.2g} min" if seconds < 6000 else f"{seconds / 3600:.2g} h"
