"""One right-hand side of weakly compressible SPH: pairs per second of `pair_sum`, beside the plain formulation.

The physics is the same for both: pressure, artificial viscosity and continuity, 10 numbers gathered from each
neighbor in 2D. Plain means what one writes first: lists (N, K), fields (N, d), gather all neighbors, `vmap`
over particles and slots, sum over the slots, and JAX's own derivatives. Both get the same list, whose slots are
as many as the most crowded particle has neighbors; only pairs that interact are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from measure import compiled, interleaved, row

import jaxsph
from jaxsph import slots
from jaxsph.neighbors import Domain, neighbor_list
from jaxsph.pair_sum import dot

SUPPORT = {2: 3.0, 3: 2.6}  # support radius in particle spacings: 26 neighbors in 2D, about 80 in 3D
SIDES = {2: (100, 230), 3: (22, 37)}
QUICK_SIDES = {2: (40,), 3: (12,)}
REST_DENSITY, SOUND_SPEED, VISCOSITY = 1000.0, 10.0, 0.05
KERNEL = jaxsph.WendlandC2()
SYMMETRY = {"acceleration": -1, "density_rate": 1}  # of the physics when a and b change places
BOTH_MODES = "jvp by the rule of both modes"
UNSTATED = "gradient, symmetry not stated"
AT_ONCE = "forward, not in tiles"


@dataclass(frozen=True)
class Fluid:
    """A cube of a jittered lattice in cell order. Fields are component first, particle last."""

    fields: dict[str, jax.Array]
    neighbors: Any
    search: Any
    spacing: float
    cutoff: float

    @property
    def smoothing_length(self) -> float:
        return self.cutoff / KERNEL.support

    @property
    def n_particles(self) -> int:
        return self.neighbors.indices.shape[1]

    @property
    def pairs(self) -> int:
        return int(jnp.sum(self.neighbors.count))

    @property
    def resolution(self) -> str:
        slots, n = self.neighbors.indices.shape
        return f"{n:,} particles, {self.pairs / n:.0f} neighbors, {slots} slots"


def fluid(dimension: int, side: int, dtype: str, capacity_multiplier: float = 1.0) -> Fluid:
    """side^dimension particles in the unit cube, each moved by a tenth of the spacing (standard deviation)."""
    random, spacing = np.random.default_rng(0), 1.0 / side
    lattice = np.stack(np.meshgrid(*[(np.arange(side) + 0.5) * spacing] * dimension, indexing="ij")).reshape(
        dimension, -1
    )
    position = jnp.asarray(lattice + random.normal(0, 0.1 * spacing, lattice.shape), dtype)
    cutoff = SUPPORT[dimension] * spacing
    search = neighbor_list(
        Domain((-0.5,) * dimension, (1.5,) * dimension), cutoff, capacity_multiplier=capacity_multiplier
    )
    position = position[:, search.sort(position)]
    fields = {
        "position": position,
        "velocity": jnp.asarray(random.normal(size=lattice.shape), dtype),
        "density": jnp.asarray(REST_DENSITY + random.normal(size=lattice.shape[1]), dtype),
    }
    return Fluid(fields, search.allocate(position), search, spacing, cutoff)


def pair_physics(a, b, *, mass, smoothing_length, viscosity):
    """Acceleration of a and rate of its density, from its neighbor b. Monaghan (1992), artificial viscosity."""
    x_ab, v_ab = a["position"] - b["position"], a["velocity"] - b["velocity"]
    gradient = KERNEL.gradient(x_ab, smoothing_length)
    approach = jnp.minimum(dot(v_ab, x_ab), 0) * smoothing_length / (dot(x_ab, x_ab) + 0.01 * smoothing_length**2)
    friction = -viscosity * SOUND_SPEED * approach / (0.5 * (a["density"] + b["density"]))
    push = a["pressure"] + b["pressure"] + friction
    return {"acceleration": -mass * push * gradient, "density_rate": mass * dot(v_ab, gradient)}


def with_pressure(fields):
    """The fields of a pair: p / rho^2 is computed once for each particle."""
    pressure = SOUND_SPEED**2 * (fields["density"] - REST_DENSITY) / fields["density"] ** 2
    return {**fields, "pressure": pressure}


def ours(case: Fluid, fields, viscosity, neighbors, **options):
    """The right-hand side by `pair_sum`."""
    physics = partial(
        pair_physics,
        mass=REST_DENSITY * case.spacing ** len(fields["position"]),
        smoothing_length=case.smoothing_length,
        viscosity=viscosity,
    )
    ready = with_pressure(fields)
    return jaxsph.pair_sum(physics, ready, ready, neighbors, **options)


def plain(case: Fluid, fields, viscosity, indices, count):
    """The right-hand side over (N, K): fields (N, d) and indices (N, K)."""
    physics = partial(
        pair_physics,
        mass=REST_DENSITY * case.spacing ** fields["position"].shape[1],
        smoothing_length=case.smoothing_length,
        viscosity=viscosity,
    )
    ready = with_pressure(fields)
    gathered = {name: field.at[indices].get(mode="promise_in_bounds") for name, field in ready.items()}
    values = jax.vmap(jax.vmap(physics, (None, 0)))(ready, gathered)
    filled = jnp.arange(indices.shape[1])[None] < count[:, None]

    def total(leaf):
        mask = filled.reshape(filled.shape + (1,) * (leaf.ndim - 2))
        return jnp.sum(jnp.where(mask, leaf, jnp.zeros((), leaf.dtype)), axis=1)

    return jax.tree.map(total, values)


def derivatives(right_hand_side, fields, viscosity, *lists):
    """Forward, jvp and gradient of a right-hand side, with respect to all fields and the viscosity."""

    def loss(fields, viscosity, *lists):
        # Not linear, so that the gradient needs the values too, as that of a run does.
        return sum(0.5 * jnp.sum(leaf**2) for leaf in jax.tree.leaves(right_hand_side(fields, viscosity, *lists)))

    def tangent(fields, viscosity, *lists):
        ones = jax.tree.map(jnp.ones_like, (fields, viscosity))
        return jax.jvp(lambda f, v: right_hand_side(f, v, *lists), (fields, viscosity), ones)

    functions = {"forward": right_hand_side, "jvp": tangent, "gradient": jax.grad(loss, argnums=(0, 1))}
    return {name: (function, (fields, viscosity, *lists)) for name, function in functions.items()}


def calls(case: Fluid) -> dict[tuple[str, str], tuple[Any, float]]:
    """Compiled calls by (peer, figure), in the order in which they take turns."""
    viscosity = jnp.asarray(VISCOSITY, case.fields["position"].dtype)
    arguments = (case.fields, viscosity, case.neighbors)
    usual = derivatives(partial(ours, case, symmetry=SYMMETRY), *arguments)
    # simulate(mode="forward") differentiates the loop itself where it is not in tiles, so that is our jvp.
    forward_mode = derivatives(partial(ours, case, forward_mode=True), *arguments)
    unstated = derivatives(partial(ours, case), *arguments)
    first = {name: field.T for name, field in case.fields.items()}
    lists = jnp.asarray(case.neighbors.indices.T), case.neighbors.count
    obvious = derivatives(partial(plain, case), first, viscosity, *lists)
    found = {
        ("jaxsph", "forward"): usual["forward"],
        ("plain (N, K)", "forward"): obvious["forward"],
        ("jaxsph", "jvp"): forward_mode["jvp"],
        ("plain (N, K)", "jvp"): obvious["jvp"],
        ("jaxsph", BOTH_MODES): usual["jvp"],
        ("jaxsph", "gradient"): usual["gradient"],
        ("plain (N, K)", "gradient"): obvious["gradient"],
        ("jaxsph", UNSTATED): unstated["gradient"],
    }
    calls = {name: compiled(function, *arguments) for name, (function, arguments) in found.items()}
    if case.n_particles > slots.TILE:
        whole, arguments = derivatives(partial(ours, case, symmetry=SYMMETRY), *arguments)["forward"]
        with mock.patch.object(slots, "TILE", case.n_particles):
            calls["jaxsph", AT_ONCE] = compiled(whole, *arguments)
    agree(calls)
    return calls


def agree(calls) -> None:
    """Both formulations give the same forces and gradients, or their times mean nothing.

    Raises AssertionError with the largest difference, relative to the largest value of each field.
    """
    for figure in ("forward", "gradient"):
        results = [calls[peer, figure][0]() for peer in ("jaxsph", "plain (N, K)")]
        for a, b in zip(*map(jax.tree.leaves, results), strict=True):
            difference = float(jnp.max(jnp.abs(a - b.T)) / jnp.max(jnp.abs(a)))
            limit = 500 * float(jnp.finfo(a.dtype).eps)  # a hundred terms of both signs, added in another order
            if not difference < limit:
                raise AssertionError(f"the formulations differ by {difference:.1e} in {figure}, more than {limit:.1e}")


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one size after the other."""
    for dimension, sides in (QUICK_SIDES if quick else SIDES).items():
        for side in sides:
            case = fluid(dimension, side, precision)
            print(f"right-hand side in {dimension}D, {case.resolution}, {precision}", flush=True)
            timings = interleaved(calls(case), budget=0.5 if quick else 8.0)
            yield rows_of(case, dimension, precision, timings)


def rows_of(case: Fluid, dimension: int, precision: str, timings) -> list[dict]:
    """Pairs per second of every figure, and what derivatives cost in forward evaluations."""
    made = []
    about: dict[str, Any] = {
        "identity": f"pair_sum.{dimension}d.{case.n_particles}.{precision}",
        "case": f"right-hand side, {dimension}D",
        "resolution": case.resolution,
        "precision": precision,
    }
    for (peer, figure), timing in timings.items():
        print(timing.line(f"{peer}: {figure}", case.pairs), flush=True)
        speed = case.pairs / timing.seconds / 1e6
        made.append(row(**about, figure=figure, value=speed, unit="M pairs/s", peer=peer, timing=timing))
    for (peer, figure), timing in timings.items():
        if figure != "forward":
            ratio = timing.over(timings[peer, "forward"])
            made.append(row(**about, figure=f"{figure} / forward", value=ratio, unit="times", peer=peer))
    return made
