"""How error and cost go with the resolution: power laws, from a few runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsph.accuracy.results import Number, Row

LOWEST, HIGHEST = 0.05, 8.0
"""Orders of convergence that are looked for."""


@dataclass(frozen=True)
class PowerLaw:
    """value = factor * resolution ** exponent."""

    factor: float
    exponent: float

    def __call__(self, resolution):
        return self.factor * np.asarray(resolution, float) ** self.exponent

    @classmethod
    def through(cls, resolutions, values) -> PowerLaw:
        """By least squares of the logarithms."""
        exponent, constant = np.polyfit(np.log(np.asarray(resolutions, float)), np.log(np.asarray(values, float)), 1)
        return cls(float(np.exp(constant)), float(exponent))


def error_of_differences(resolutions: Sequence[Number], series: Sequence[np.ndarray]) -> PowerLaw | None:
    """The law of the error from how three or more resolutions differ, without a reference (Richardson).

    With o(n) = o + c n^-p, what lies between two resolutions is c (n1^-p - n2^-p); p follows from the last three, and
    the error is relative to the norm of the finest. None if the differences do not fall as a power law.
    """
    from scipy.optimize import brentq

    n = [float(value) for value in resolutions[-3:]]
    a, b, c = series[-3:]
    coarse, fine = np.linalg.norm(np.ravel(a - b)), np.linalg.norm(np.ravel(b - c))
    if not (coarse > 0 and fine > 0):
        return None
    share = lambda p: (n[1] ** -p - n[2] ** -p) / (n[0] ** -p - n[1] ** -p) - fine / coarse  # noqa: E731
    if share(LOWEST) * share(HIGHEST) > 0:
        return None
    order: Any = brentq(share, LOWEST, HIGHEST)
    size = fine / (n[1] ** -order - n[2] ** -order)
    return PowerLaw(float(size / np.linalg.norm(np.ravel(c))), -float(order))


@dataclass(frozen=True)
class CostLaw:
    """Seconds = per_step * steps + per_particle_step * steps * particles, both power laws of the resolution."""

    per_step: float
    per_particle_step: float
    steps: PowerLaw
    particles: PowerLaw

    def __call__(self, resolution):
        steps, particles = self.steps(resolution), self.particles(resolution)
        return steps * (self.per_step + self.per_particle_step * particles)

    @classmethod
    def through(cls, resolutions: Sequence[Number], rows: Sequence[Row]) -> CostLaw:
        """From runs: relative errors of the seconds are the smallest that two positive numbers allow."""
        from scipy.optimize import nnls

        seconds, steps, particles = (
            np.array([getattr(row, name) for row in rows], float) for name in ("seconds", "steps", "n_particles")
        )
        columns = np.stack([steps, steps * particles], axis=1) / seconds[:, None]
        scale = np.max(columns, axis=0)
        found, _ = nnls(columns / scale, np.ones(len(rows)))
        per_step, per_particle_step = (float(price) for price in found / scale)
        power = PowerLaw.through
        return cls(per_step, per_particle_step, power(resolutions, steps), power(resolutions, particles))
