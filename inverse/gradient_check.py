"""Do forward mode, reverse mode and central differences give the same derivative?"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from inverse.model import Model
from inverse.problem import Problem

# in internal coordinates: relative changes for logarithmic unknowns
STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
ALL_UNKNOWNS = 8  # beyond this many, random directions instead of one unknown at a time


@dataclasses.dataclass(frozen=True, eq=False)
class GradientCheck:
    """Directional derivatives of the cost 0.5 sum r^2 in internal coordinates, D directions, S step sizes.

    forward, reverse: (D,). differences: (D, S) central differences (S = 0 in float32, where they mean
    nothing).
    best_step: (D,) index of the step whose value changes least against its neighbor: the plateau between
    truncation and rounding, found without looking at the other two columns.
    moved: unknowns that stood nearer to a bound than the largest step, and were moved away from it.
    """

    directions: tuple[str, ...]
    steps: tuple[float, ...]
    forward: np.ndarray
    reverse: np.ndarray
    differences: np.ndarray
    best_step: np.ndarray
    simulation_runs: int
    moved: tuple[str, ...] = ()

    @property
    def central(self) -> np.ndarray:
        """(D,) central differences at the best step."""
        return self.differences[np.arange(len(self.directions)), self.best_step]

    @property
    def forward_against_reverse(self) -> float:
        """Largest |forward - reverse| / |reverse|."""
        return _relative(self.forward, self.reverse)

    @property
    def max_relative_difference(self) -> float:
        """Largest relative difference between any two of the three (of the two, in float32)."""
        pairs = [self.forward_against_reverse]
        if self.steps:
            pairs += [_relative(self.forward, self.central), _relative(self.reverse, self.central)]
        return max(pairs)

    def __str__(self) -> str:
        width = max(len("direction"), *(len(name) for name in self.directions))
        head = f"{'direction':<{width}}  {'forward mode':>16}  {'reverse mode':>16}"
        if self.steps:
            head += f"  {'central diff.':>16}  {'at step':>8}  |AD - FD| / |FD| at steps " + " ".join(
                f"{step:8.0e}" for step in self.steps
            )
        lines = [head]
        for i, name in enumerate(self.directions):
            line = f"{name:<{width}}  {self.forward[i]:16.9e}  {self.reverse[i]:16.9e}"
            if self.steps:
                errors = [_relative(self.forward[i], value) for value in self.differences[i]]
                line += f"  {self.central[i]:16.9e}  {self.steps[self.best_step[i]]:8.0e}  {'':25} " + " ".join(
                    f"{error:8.1e}" for error in errors
                )
            lines.append(line)
        if not self.steps:
            lines.append(
                "central differences not taken: in float32 they are rounding noise; enable "
                "float64 with jax.config.update('jax_enable_x64', True) and build the scene in float64"
            )
        if self.moved:
            lines.append(f"moved away from a bound, to have room for the differences: {', '.join(self.moved)}")
        lines.append(f"largest relative difference {self.max_relative_difference:.1e}, {self.simulation_runs} runs")
        return "\n".join(lines)

    __repr__ = __str__


def check(
    problem: Problem, at: dict[str, Any] | None = None, steps: Sequence[float] | None = None, seed: int = 0
) -> GradientCheck:
    """Compare the derivatives of the cost by forward mode, reverse mode and central differences.

    Args:
        problem: what will be fitted.
        at: {name: value} where to differentiate; the starting values by default. At a perfect fit the
        gradient is
            zero, and relative differences have no meaning. Nearer to a bound than the largest step it is moved.
        steps: of the central differences, in internal coordinates; None takes those of 1e-2 to 1e-7 that fit four
            times between the bounds. In float32 none are taken.
        seed: of the random directions that stand for more than 8 unknowns.

    Returns:
        GradientCheck; print it, or ask for `.max_relative_difference`.

    Raises:
        ValueError: steps that are not positive or do not fit between the bounds, names that are not unknowns, or
        values outside of their bounds. RunFailed: the simulator fails there.

    """
    lower, upper = problem.bounds
    narrowest = float(np.min(upper - lower))
    steps = tuple(s for s in STEPS if 4 * s <= narrowest) if steps is None else tuple(float(step) for step in steps)
    if not all(step > 0 for step in steps):
        raise ValueError(f"steps={steps} must all be > 0")
    room = max(steps, default=0.0)
    if 2 * room > narrowest:
        raise ValueError(
            f"steps={steps}: {room:g} to both sides do not fit between bounds that are {narrowest:.3g} apart internally"
        )
    asked, z = point_of(problem, at or {}, 0.0), point_of(problem, at or {}, room)
    model = Model(problem)
    evaluation = model.evaluate(z)
    weights = np.ones(len(model.data))
    _, gradient, _ = model.cost_and_gradient(z, weights)
    forward = evaluation.jacobian.T @ evaluation.residual
    if len(z) <= ALL_UNKNOWNS:
        directions, names = np.eye(len(z)), tuple(model.labels)
    else:
        directions = np.random.default_rng(seed).standard_normal((ALL_UNKNOWNS, len(z)))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        names = tuple(f"random direction {i}" for i in range(ALL_UNKNOWNS))
    if model.precision > 1e-10:
        steps = ()
    differences = np.empty((len(directions), len(steps)))
    for i, direction in enumerate(directions):
        for j, step in enumerate(steps):
            ahead, behind = (model.residual(z + sign * step * direction) for sign in (1, -1))
            # (|a|^2 - |b|^2) / 2 as (a - b).(a + b) / 2: the difference is taken before the sum, and rounds
            # less
            differences[i, j] = 0.5 * float((ahead - behind) @ (ahead + behind)) / (2 * step)
    if len(steps) > 1:
        best = np.argmin(np.abs(np.diff(differences, axis=1)), axis=1) + 1
    else:
        best = np.zeros(len(directions), dtype=int)
    moved = tuple(label for label, before, now in zip(model.labels, asked, z, strict=True) if before != now)
    both = directions @ forward, directions @ gradient
    return GradientCheck(names, steps, *both, differences, best, model.runs, moved)


def point_of(problem: Problem, at: dict[str, Any], room: float) -> np.ndarray:
    """(n,) internal coordinates of values, the starting ones by default, at least `room` away from the bounds."""
    strange = set(at) - set(problem.unknown)
    if strange:
        raise ValueError(f"at names {', '.join(sorted(strange))}; the unknowns are {', '.join(problem.unknown)}")
    parts = []
    for name, transform in problem.unknown.items():
        value = np.asarray(at.get(name, transform.start), dtype=float)
        if value.shape != transform.shape or np.any(value < transform.lower) or np.any(value > transform.upper):
            raise ValueError(f"at[{name!r}] = {value} must have shape {transform.shape} and lie within the bounds")
        parts.append(transform.internal(value).ravel())
    lower, upper = problem.bounds
    # room for the largest difference step on both sides, so that clipping at a bound does not spoil it
    return np.clip(np.concatenate(parts), lower + room, upper - room)


def _relative(value: Any, reference: Any) -> float:
    return float(np.max(np.abs(value - reference) / np.maximum(np.abs(reference), 1e-300)))
