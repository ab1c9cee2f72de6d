"""X05, X06: elastic and rigid spheres that fall into water. Momentum, penetration, both precisions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from rows import Case, Row, precision
from scipy.spatial import KDTree

import jaxsph

T_END, SAVES = 2.0, 200


def fall(make: Callable[..., jaxsph.Scene], quick: bool) -> Iterator[list[Row]]:
    """Both precisions at the given spacing."""
    for dtype in (np.float32, np.float64):
        scene = make(0.05 if quick else SPACING, dtype=dtype)
        run = jaxsph.simulate(scene, T_END, T_END / SAVES)
        where = f"spacing {scene.spacing:g} m", precision(dtype)
        share = exchange_error(scene, run)
        yield [
            Row(
                "momentum of all by one step less gravity and walls / momentum exchanged", share, LIMITS[dtype], *where
            ),
            Row("penetration of walls and bodies [spacings]", penetration(run), 0.5, *where),
            Row("number of values that are not finite", not_finite(run), 0.0, *where),
        ]


SPACING = 0.025
LIMITS = {np.float32: 1e-5, np.float64: 1e-13}
"""Of a sum over some thousand particles, each with a rounding of 6e-8 or 1e-16 of forces that nearly cancel."""


def exchange_error(scene: jaxsph.Scene, run: jaxsph.Trajectory) -> float:
    """Largest error of the balance of forces at the saved states: of water on spheres, and spheres on water.

    Without tank and gravity nothing acts from outside: the forces of a state on water and spheres must add up
    to zero. Relative to the sum of their magnitudes.
    """
    free = jaxsph.Scene(
        *scene.fluids, *scene.solids, effects=scene.effects, smoothing_length=scene.smoothing_length,
        kernel=scene.kernel, domain=scene.domain, density=scene.density,
    )  # fmt: skip
    found = jaxsph.topologies(free, run.final, capacity_multiplier=2.0)
    states = jax.tree.map(lambda leaf: leaf[:: SAVES // 20], run.states)
    total, size = momentum_rates(free, states, found)
    assert np.all(np.isfinite(total))
    return float(np.max(np.linalg.norm(total, axis=1) / size))


def momentum_rates(scene: jaxsph.Scene, states: Any, found: dict) -> tuple[np.ndarray, np.ndarray]:
    """Sum of all forces (T, d) [N], and of the magnitudes of those between systems (T,), for every state."""
    from jaxsph.dynamics import accelerations, place_boundaries, positions_of, prepare
    from jaxsph.state import to_columns
    from jaxsph.surroundings import rebuild

    @jax.jit
    def of_state(state):
        references = prepare(scene, found)
        systems = {name: state.systems[name] for name in (system.name for system in scene.systems)}
        columns = to_columns(systems, found)
        placed = place_boundaries(scene, references, columns, state.time)
        lists = rebuild(scene, found, positions_of(scene, columns, placed))
        rates = accelerations(scene, references, columns, state.time, lists, placed)
        total, size = 0.0, 0.0
        for system in scene.systems:
            force = references[system.name].mass * rates[system.name]["acceleration"]
            total = total + force.sum(axis=1)
            size = size + abs(force).sum()
        return total, size

    found_rates = [of_state(jax.tree.map(lambda leaf, k=k: leaf[k], states)) for k in range(len(states.time))]
    return np.array([np.asarray(t) for t, _ in found_rates]), np.array([float(s) for _, s in found_rates])


def penetration(run: jaxsph.Trajectory) -> float:
    """How much closer than a spacing a particle gets to those of walls and other solids at a saved state [spacings].

    Of water to walls and spheres, of spheres to walls and to each other. Half a spacing: in the middle between the
    outermost particle and where its neighbor outside belongs.
    """
    scene, closest = run.scene, np.inf
    moving, barriers = [*scene.fluids, *scene.solids], [*scene.walls, *scene.solids]
    places = {system.name: np.asarray(run.positions(system.name), float) for system in scene.systems}
    for k in range(len(run.times)):
        trees = {barrier.name: KDTree(places[barrier.name][k]) for barrier in barriers}
        for system in moving:
            for barrier in barriers:
                if barrier is not system:
                    closest = min(closest, float(trees[barrier.name].query(places[system.name][k])[0].min()))
    return max(0.0, 1 - closest / scene.spacing)


def not_finite(run: jaxsph.Trajectory) -> float:
    """How many numbers of the run are not finite."""
    return float(sum(np.sum(~np.isfinite(np.asarray(leaf))) for leaf in jax.tree.leaves(run.states.systems)))


CASES = [
    Case("X05", "Elastic spheres that fall into water, 2 s", lambda quick: fall(jaxsph.scenes.falling_spheres, quick)),
    Case(
        "X06", "Rigid spheres that fall into water, 2 s", lambda quick: fall(jaxsph.scenes.falling_rigid_spheres, quick)
    ),
]
