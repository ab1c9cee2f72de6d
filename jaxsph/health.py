"""Failure as a value: what went wrong inside a compiled run, and the sentences that it becomes."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxsph.errors import (
    NeighborOverflow,
    NotFinite,
    ParticleOutside,
    SimulationError,
    SkinExceeded,
    UnstableTimeStep,
)
from jaxsph.pytree import pytree_dataclass

GOOD, NOT_FINITE, UNSTABLE, GAVE_UP, OVERFLOW, OUTSIDE, BEYOND_SKIN, OUTGROWN = 0, 1, 2, 3, 4, 5, 6, 7

CURES = {
    NOT_FINITE: "a field became infinite or not a number; take a smaller time_step (bodies that stretch by much: "
    "stable_time_step(scene, state=...)), check velocities and moduli, or add a PenaltyForce if particles alternate",
    UNSTABLE: "the time step is larger than the largest stable one; pass a smaller time_step (in a fit: the one for "
    "the upper end of the bounds)",
    GAVE_UP: "the error-controlled solver did not reach the end; allow more max_steps, loosen the tolerances, or check "
    "velocities and moduli",
    OVERFLOW: "a particle got more neighbors than the neighbor list has slots, or more candidates than a row of its "
    "cells has room for, or more particles came near another system than it has rows; allocate it from a state in "
    "which particles are as close as they will be, jaxsph.topologies(scene, state), or with a larger "
    "capacity_multiplier",
    OUTSIDE: "a particle left the domain; widen the scene's domain, or close the wall where it got through",
    BEYOND_SKIN: "particles moved further between two builds of the neighbor lists than their skin allows; state a "
    "larger max_speed, or take a smaller time_step, or make topologies_of_scene for the largest smoothing length",
    OUTGROWN: "the support radius of a structure is larger than that for which its neighbors were found; make "
    "topologies_of_scene for the largest smoothing length",
}


@pytree_dataclass
class Health:
    """The first thing that went wrong.

    Attributes:
        reason: 0 for nothing, else a key of `CURES`.
        step: at or before which it was seen, -1 for nothing.
        number: the number that broke the limit, such as the time step [s].
        limit: the limit that was broken.
    """

    reason: Any
    step: Any
    number: Any
    limit: Any

    @classmethod
    def good(cls, dtype) -> Health:
        """Nothing went wrong."""
        return cls(jnp.int32(GOOD), jnp.int32(-1), jnp.zeros((), dtype), jnp.zeros((), dtype))

    def note(self, wrong, reason: int, step, number: Any = 0.0, limit: Any = 0.0) -> Health:
        """Remember a failure if there is one and none came before it."""
        first = wrong & (self.reason == GOOD)
        dtype = self.number.dtype
        return Health(
            jnp.where(first, jnp.int32(reason), self.reason),
            jnp.where(first, jnp.asarray(step, jnp.int32), self.step),
            jnp.where(first, jnp.asarray(number, dtype), self.number),
            jnp.where(first, jnp.asarray(limit, dtype), self.limit),
        )


def all_finite(columns) -> Any:
    """Whether every field of every system is finite."""
    finite = jnp.bool_(True)
    for fields in columns.values():
        for value in fields.values():
            finite = finite & jnp.all(jnp.isfinite(value))
    return finite


def raise_if_failed(state, trajectory=None, domain=None) -> None:
    """Raise what the health of a state says, naming the first particle that is not finite or outside.

    Outside jit only.

    Args:
        state: with fields particle first.
        trajectory: what was computed before, handed on with the error.
        domain: `Domain` that particles may have left.
    """
    health = state.health
    reason, step = int(health.reason), int(health.step)
    if reason == GOOD:
        return
    if reason == UNSTABLE:
        raise UnstableTimeStep(
            f"time step {float(health.number):.4g} s is larger than the largest stable one, "
            f"{float(health.limit):.4g} s. Pass time_step=None, or a smaller one (in a fit: the one for the upper end "
            "of the bounds)",
            trajectory,
        )
    time = f"t = {float(state.time):.6g} s"
    numbers = f"({float(health.number):.6g}, limit {float(health.limit):.6g})"
    if reason == OUTSIDE:
        raise ParticleOutside(
            f"stopped at or before step {step} ({time}){_who_left(state, domain)}: {CURES[OUTSIDE]}", trajectory
        )
    for kind, error in ((OVERFLOW, NeighborOverflow), (BEYOND_SKIN, SkinExceeded)):
        if reason == kind:
            raise error(f"stopped at or before step {step} ({time}) {numbers}: {CURES[kind]}", trajectory)
    if reason == GAVE_UP:
        raise SimulationError(f"stopped after step {step}, before {time}: {CURES[reason]}", trajectory)
    where = ""
    for name, fields in state.systems.items():
        for field, value in fields.items():
            bad = ~np.isfinite(np.asarray(value)).reshape(len(value), -1).all(axis=1)
            if bad.any() and not where:
                where = f": {field} of particle {int(np.argmax(bad))} of {name!r} ({int(bad.sum())} particles in all)"
    raise NotFinite(f"not finite at or before step {step} ({time}){where}; {CURES[reason]}", trajectory)


def _who_left(state, domain) -> str:
    """The first particle of a state that is outside a domain, if it still is."""
    if domain is None:
        return ""
    for name, fields in state.systems.items():
        if "position" not in fields:
            continue
        position = np.asarray(fields["position"])
        beyond = ~np.asarray(domain.contains(position.T))
        if beyond.any():
            first = int(np.argmax(beyond))
            place = ", ".join(f"{x:.6g}" for x in position[first])
            return (
                f": particle {first} of {name!r} is at ({place}) m ({int(beyond.sum())} of its particles in all), "
                f"the domain reaches from {domain.lower} to {domain.upper} m"
            )
    return ""
