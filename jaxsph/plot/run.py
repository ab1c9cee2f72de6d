"""Pictures of a run: a system at one moment, and moving, colored by what is asked for."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxsph.dynamics import topologies
from jaxsph.observe import stresses
from jaxsph.plot.disks import animate, particles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = {
    "von_mises": ("von Mises stress", "Pa"),
    "displacement": ("displacement", "m"),
    "velocity": ("speed", "m/s"),
    "acceleration": ("acceleration", "m/s$^2$"),
}
"""What a picture can show, with its label and unit; of vectors the magnitude."""


def snapshot(trajectory: Any, name: str, index: int = -1, color: str | None = "von_mises", **options: Any) -> Figure:
    """Draw a system of a run at one saved state.

    Args:
        trajectory: from `simulate`.
        name: of the system.
        index: of the saved state, the last by default.
        color: a key of `COLORS`; None draws one color.
        **options: as `particles`.

    Raises:
        KeyError: no system of this name.
        ValueError: a color that is not known, an index beyond the run.
        ImportError: matplotlib is not installed.
    """
    n_saved = len(trajectory.times)
    if not -n_saved <= index < n_saved:
        raise ValueError(f"index {index}: the run has {n_saved} saved states, from 0 to {n_saved - 1}")
    positions, values = _shown(trajectory, name, color, [index % n_saved])
    title = f"{name}   t = {float(trajectory.times[index]):.3f} s"
    options = {**_labels(color), "title": title, "spacing": trajectory.scene[name].particles.spacing, **options}
    return particles(positions[0], None if values is None else values[0], **options)


def animate_trajectory(
    path: str | os.PathLike[str], trajectory: Any, name: str, *, color: str | None = "von_mises", **options: Any
) -> Figure:
    """Write all saved states of a system to a GIF.

    Args:
        path: file to write, `*.gif`.
        trajectory: from `simulate`.
        name: of the system.
        color: a key of `COLORS`; None draws one color.
        **options: as `animate`.

    Returns: the figure of the last frame.

    Raises:
        KeyError: no system of this name.
        ValueError: a color that is not known, a path that is not a GIF.
        ImportError: matplotlib is not installed.
    """
    positions, values = _shown(trajectory, name, color, range(len(trajectory.times)))
    options = {**_labels(color), "title": name, "spacing": trajectory.scene[name].particles.spacing, **options}
    return animate(path, positions, values, np.asarray(trajectory.times), **options)


def _labels(color):
    return {} if color is None else dict(zip(("label", "unit"), COLORS[color], strict=True))


def _shown(trajectory, name, color, indices):
    """Positions (T, N, d) and values (T, N) or (T, N, d) of the saved states with these indices."""
    if color is not None and color not in COLORS:
        raise ValueError(f"color {color!r} is not known; choose one of {sorted(COLORS)}, or None")
    indices = np.asarray(indices)
    fields = trajectory[name]
    positions = trajectory.scene[name].particles.positions + np.asarray(fields["displacement"])[indices]
    if color is None:
        return positions, None
    if color in fields:
        return positions, np.asarray(fields[color])[indices]
    states = jax.tree.map(lambda leaf: leaf[indices], trajectory.states)
    return positions, np.asarray(_von_mises(trajectory.scene, states, topologies(trajectory.scene), name=name))


def _von_mises_of_states(scene, states, found, *, name):
    return jax.lax.map(lambda state: stresses(scene, state, name, found)["von_mises"], states)


_von_mises = jax.jit(_von_mises_of_states, static_argnames="name")
