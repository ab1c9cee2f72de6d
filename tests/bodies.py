"""Small bodies that several tests use."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsph as sph
from jaxsph.dynamics import accelerations, prepare
from jaxsph.pytree import replace
from jaxsph.state import to_columns

SPACING = 0.1
SIZES = {2: (0.6, 0.6), 3: (0.4, 0.4, 0.4)}


def block(d=2, kind: Any = np.float64, disorder=0.2, on_surface=False, **changes: Any) -> sph.Structure:
    """A free block around the origin, of disordered particles, whose neighborhoods are wide enough for the disorder."""
    corner = -0.5 * np.array(SIZES[d])
    particles = sph.box(corner, SIZES[d], SPACING, on_surface=on_surface, dtype=kind)
    particles = sph.jitter(particles, disorder, seed=7)
    about: dict[str, Any] = {
        "density": 1000.0,
        "youngs_modulus": 1e6,
        "poisson_ratio": 0.3,
        "smoothing_length": 1.3 * SPACING,
    }
    return sph.Structure("block", particles, **{**about, **changes})


def with_particles(structure: sph.Structure, **changes) -> sph.Structure:
    """A copy of a structure with other positions or volumes."""
    return replace(structure, particles=replace(structure.particles, **changes))


def beam(kind: Any = np.float64, **changes: Any) -> sph.Scene:
    """A cantilever of 3 particles across and 42 in all that swings under its weight."""
    about: dict[str, Any] = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3, "gravity": (0.0, -5.0)}
    return sph.scenes.cantilever(0.1, 0.02, 3, dtype=kind, **{**about, **changes})


def in_columns(rows, topology):
    """(N, d) in the user's order to (d, N) in cell order."""
    return rows[topology.order].T


def in_rows(columns, topology):
    """(..., N) in cell order to (N, ...) in the user's order."""
    return np.moveaxis(np.asarray(columns), -1, 0)[topology.rank]


@partial(jax.jit, static_argnames=("n_steps", "field"))
def peak(scene, found, time_step, n_steps, field):
    """Largest value of a field of a block in so many steps of any length, which `simulate` would refuse to take."""
    references = prepare(scene, found)
    columns = to_columns(sph.initial_state(scene).systems, found)
    rates = accelerations(scene, references, columns, 0.0)
    columns = {name: {**fields, **rates[name]} for name, fields in columns.items()}

    def step(columns, _):
        moved = sph.KickDriftKick().step(scene, references, columns, None, 0.0, time_step, forward_mode=True)
        return moved, jnp.max(jnp.abs(moved["block"][field]))

    return jnp.max(jax.lax.scan(step, columns, length=n_steps)[1])
