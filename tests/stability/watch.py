"""Run a scene and watch it: whether it reached the end, its energy, the density, who is outside, what alternates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row

import jaxsph

DENSITY_LIMIT = 0.03
ENERGY_LIMIT = 1e-3


@dataclass(frozen=True)
class Watched:
    """What was seen at the saves of a run, the start included.

    Attributes:
        missing: share of the run that it did not reach, 0 for all of it.
        reason: why it stopped, "" if it did not.
        run: its trajectory, as far as it came.
        seen: by name what each measure gave, (T, ...).
    """

    missing: float
    reason: str
    run: Any
    seen: dict[str, np.ndarray]


def watch(scene, t_end: float, saves: int, measures: dict[str, Callable] | None = None, **options) -> Watched:
    """Run a scene and take measures, by name functions of a state; `energy`, `kinetic` and `deviation` come along.

    `energy` is all of it, `deviation` the largest |density - rest density| / rest density of all fluids.
    """
    missing, reason = 0.0, ""
    try:
        run: Any = jaxsph.simulate(scene, t_end, t_end / saves, **options)
    except jaxsph.SimulationError as error:
        run, reason = error.trajectory, f"{type(error).__name__}: {error}"
        missing = 1.0 - float(run.times[-1] - run.times[0]) / t_end
        print(f"  stopped: {reason}", flush=True)
    found = jaxsph.topologies(scene)

    def see(state):
        parts = jaxsph.observe.energies(scene, state, found)
        out = {"energy": parts["total"], "kinetic": parts["kinetic"]}
        if scene.fluids:
            fluids = [(f.density, state.systems[f.name]["density_deviation"]) for f in scene.fluids]
            out["deviation"] = jnp.max(jnp.stack([jnp.max(jnp.abs(value)) / rest for rest, value in fluids]))
        return out | {name: measure(state) for name, measure in (measures or {}).items()}

    seen = jax.jit(lambda states: jax.lax.map(see, states))(run.states)
    return Watched(missing, reason, run, {name: np.asarray(value, float) for name, value in seen.items()})


def rise(energy: np.ndarray) -> float:
    """How far an energy rises above what it was before [J]: the largest over all pairs of moments."""
    return float(np.max(energy - np.minimum.accumulate(energy)))


def rows_of(watched: Watched, where: tuple[str, str], *, energy: float | None) -> list[Row]:
    """The rows that every case has: whether it came to its end, density, energy.

    energy: what can move at most [J], the unit of the rise; None leaves that row out, where something drives the scene.
    """
    rows = [Row("share of the time that was not reached", watched.missing, 0.0, *where)]
    if "deviation" in watched.seen:
        largest = float(np.max(watched.seen["deviation"]))
        rows.append(Row("largest |density / rest density - 1|", largest, DENSITY_LIMIT, *where))
    if energy is not None:
        value = rise(watched.seen["energy"]) / energy
        rows.append(Row("largest rise of the energy / what can move", value, ENERGY_LIMIT, *where))
    return rows


def depth_beyond(name: str, lower, upper, shift: Callable | None = None) -> Callable:
    """Measure: how far each particle of a fluid is beyond the faces of its walls (N,) [m], negative inside.

    lower, upper: of the faces (d,) [m]. shift: displacement (d,) [m] of the walls at a time.
    """

    def depth(state):
        place = state.systems[name]["position"]
        if shift is not None:
            place = place - shift(state.time)
        return jnp.max(jnp.maximum(jnp.asarray(lower) - place, place - jnp.asarray(upper)), axis=1)

    return depth


def outside(watched: Watched, spacing: float, where: tuple[str, str]) -> list[Row]:
    """Rows of particles that came behind the first layer of a wall, which stands half a spacing behind its face."""
    deepest = watched.seen["depth"] / spacing
    most = float((deepest > 0.5).sum(axis=1).max())
    return [
        Row("particles behind the first layer of the wall, most", most, 0.0, *where),
        Row("deepest particle beyond the face of the wall / spacing", float(deepest.max()), None, *where),
    ]


def fastest(name: str) -> Callable:
    """Measure: the largest speed of the particles of a system [m/s]."""
    return lambda state: jnp.sqrt(jnp.max(jnp.sum(state.systems[name]["velocity"] ** 2, axis=1)))


def lowest_determinant(scene, name: str) -> Callable:
    """Measure: the lowest determinant of the deformation gradients of a structure."""
    found = jaxsph.topologies(scene)

    def lowest(state):
        gradient = jaxsph.observe.stresses(scene, state, name, found)["deformation_gradient"]
        return jnp.min(jnp.linalg.det(gradient))

    return lowest


def alternation(structure) -> Callable:
    """Measure: the largest displacement that alternates from particle to particle along an axis [m], of a lattice.

    The sixth difference over 64 is 1 for (-1)^i and (k dx)^6 / 64 for a wave, next to nothing; on axes of 5 or 6 free
    particles the fourth over 16. Shorter ones are left out, as are differences that reach into the clamp, where the
    bending moment begins. ValueError if nothing is left.
    """
    place = np.asarray(structure.particles.positions, float)
    rounded = np.round(place / (1e-3 * structure.particles.spacing)).astype(np.int64)
    # columns along the other axes may be curved, as those of a beam that follows a cylinder
    others = tuple(len(np.unique(rounded[:, axis])) for axis in range(1, place.shape[1]))
    order = np.lexsort([place[:, 0], *rounded.T[:0:-1]])
    order = np.moveaxis(order.reshape(*others, -1), -1, 0)
    free, chosen = ~np.asarray(structure.clamped)[order], []
    for axis, count in enumerate(order.shape):
        for times in (6, 4):
            if count > times:
                windows = np.lib.stride_tricks.sliding_window_view(free, times + 1, axis=axis).all(axis=-1)
                if windows.any():
                    chosen.append((axis, times, windows))
                    break
    if not chosen:
        raise ValueError(f"{structure.name!r} has no row of five free particles: alternation cannot be seen")

    def largest(state):
        moved = state.systems[structure.name]["displacement"][order]
        found = jnp.zeros((), moved.dtype)
        for axis, times, windows in chosen:
            part = jnp.abs(jnp.diff(moved, times, axis=axis)) / 2**times
            found = jnp.maximum(found, jnp.max(jnp.where(windows[..., None], part, 0.0)))
        return found

    return largest


def of_structure(scene, name: str) -> dict[str, Callable]:
    """The measures `determinant` and `alternating` of a structure."""
    return {"determinant": lowest_determinant(scene, name), "alternating": alternation(scene[name])}


def structure_rows(watched: Watched, scene, name: str, where: tuple[str, str]) -> list[Row]:
    """Rows of what `of_structure` saw."""
    alternating = watched.seen["alternating"].max() / scene[name].particles.spacing
    return [
        Row("lowest det F, negated", -float(watched.seen["determinant"].min()), 0.0, *where),
        Row("largest alternating displacement / spacing", float(alternating), 0.01, *where),
    ]
