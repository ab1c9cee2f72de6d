"""Pictures of a run: a system or the whole scene at one moment, and moving, colored by what is asked for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import observe
from jaxsph.dynamics import topologies
from jaxsph.fluid import Fluid
from jaxsph.plot.figure import LIGHT_GRAY
from jaxsph.plot.layers import Layer, both_signs, draw, film, time_text
from jaxsph.rigid_body import RigidBody
from jaxsph.structure import Structure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRUCTURE_COLORS = {
    "von_mises": ("von Mises stress", "Pa"),
    "pk1": ("PK1 stress |P|", "Pa"),
    "displacement": ("displacement", "m"),
    "velocity": ("speed", "m/s"),
    "acceleration": ("acceleration", "m/s$^2$"),
}
BODY_COLORS = {key: STRUCTURE_COLORS[key] for key in ("velocity", "displacement", "acceleration")}
FLUID_COLORS = {
    "pressure": ("pressure", "Pa"),
    "velocity": ("speed", "m/s"),
    "density": ("density", "kg/m$^3$"),
    "vorticity": ("vorticity", "1/s"),
    "acceleration": ("acceleration", "m/s$^2$"),
}
"""What a picture can show, with its label and unit; of vectors and tensors the magnitude. Walls are gray."""

AUTOMATIC = "automatic"
"""Structures by von Mises stress, fluids by pressure; rigid bodies are of one color."""

TAIL = 0.5
"""Per cent of a fluid's numbers at either end that its color scale leaves out: a few particles in an impact would take
all colors for themselves."""

SEQUENTIAL = ("viridis", "inferno", "cividis")
"""Color maps of the quantities of a picture, in turn."""

TRACE = 0.25
"""Share of the other sign from which zero is the middle of the scale: a little suction is none."""


def snapshot(
    trajectory: Any,
    name: str | Sequence[str] | None = None,
    index: int = -1,
    color: str | None = AUTOMATIC,
    *,
    title: str | None = None,
    limits: tuple | None = None,
    color_map: str | None = None,
    axes: Any = None,
) -> Figure:
    """Draw a system of a run, or all of them, at one saved state.

    Args:
        trajectory: from `simulate`.
        name: of the system, or several of them; None draws all in one picture.
        index: of the saved state, the last by default.
        color: a key of `FLUID_COLORS` or `STRUCTURE_COLORS`; None draws one color. In a picture of all, systems that do
            not have it are colored as by default: fluids by pressure, structures by von Mises stress.
        title: None takes the name and the time.
        limits: ends of the color scale of `color`; by default all numbers, of a fluid but for half a per cent at either
            end.
        color_map: matplotlib name, for `color`; see `particles`.
        axes: draw here instead of in a new figure.

    Raises:
        KeyError: no system of this name.
        ValueError: a color that is not known, an index beyond the run.
        ImportError: matplotlib is not installed.
    """
    n_saved = len(trajectory.times)
    if not -n_saved <= index < n_saved:
        raise ValueError(f"index {index}: the run has {n_saved} saved states, from 0 to {n_saved - 1}")
    layers = layers_of(trajectory, name, color, [index % n_saved], limits, color_map)
    if title is None:
        title = f"{_title(name)}   {time_text(np.asarray(trajectory.times), index)}".strip()
    return draw(layers, title=title, axes=axes)


def animate_trajectory(
    path: str | os.PathLike[str],
    trajectory: Any,
    name: str | Sequence[str] | None = None,
    *,
    color: str | None = AUTOMATIC,
    title: str | None = None,
    limits: tuple | None = None,
    color_map: str | None = None,
    frames_per_second: float = 20.0,
    resolution: int = 100,
) -> Figure:
    """Write all saved states of a system, or of all systems, to a GIF. Scales are those of the whole run.

    Args:
        path: file to write, `*.gif`.
        trajectory: from `simulate`.
        name: of the system, or several of them; None draws all in one picture.
        color, limits, color_map: as `snapshot`.
        title: before the time; None takes the name.
        frames_per_second: speed of the GIF.
        resolution: dots per inch of a figure some 7 inches wide.

    Returns: the figure of the last frame.

    Raises:
        KeyError: no system of this name.
        ValueError: a color that is not known, a path that is not a GIF, a speed or resolution that is not positive.
        ImportError: matplotlib is not installed.
    """
    layers = layers_of(trajectory, name, color, range(len(trajectory.times)), limits, color_map)
    title = _title(name) if title is None else title
    times = np.asarray(trajectory.times)
    return film(path, layers, times, title=title, frames_per_second=frames_per_second, resolution=resolution)


def layers_of(trajectory, name, color, indices, limits, color_map, view=None) -> list[Layer]:
    """Layers of some systems, or of all: walls below, then fluids, then solids; `view` turns positions (T, N, 3)."""
    scene, indices = trajectory.scene, np.asarray(indices)
    systems = [*scene.walls, *scene.fluids, *scene.solids]
    if name is not None:
        systems = [scene[each] for each in ([name] if isinstance(name, str) else name)]
    known = {key for system in systems for key in _colors(system)}
    if color not in (None, AUTOMATIC, *known):
        raise ValueError(f"color {color!r} is not known; choose one of {sorted(known)}, or None")
    states = jax.tree.map(lambda leaf: leaf[indices], trajectory.states)
    shown, groups = [], {}
    for system in systems:
        key = _key(system, color)
        values = None if key is None else _values(scene, system, states, key)
        label, unit = ("", "") if key is None else _colors(system)[key]
        positions = np.asarray(trajectory.positions(system.name))[indices]
        positions = positions if view is None else view(positions)
        shown.append((system, positions, values, label, unit))
        if values is not None:
            groups.setdefault(label, []).append(_range(system, values))
    named = _asked(systems, color)
    layers = []
    for system, positions, values, label, unit in shown:
        own = limits if label == named else None
        if own is None and values is not None:
            own = _joined(groups[label])
        options: dict[str, Any] = {"face": LIGHT_GRAY} if not _colors(system) else {}
        if values is not None:
            chosen = color_map if label == named else None
            diverging = both_signs(np.asarray(own, float), TRACE)
            one_sided = SEQUENTIAL[list(groups).index(label) % len(SEQUENTIAL)]
            options |= {"limits": own, "color_map": chosen or ("coolwarm" if diverging else one_sided)}
        layers.append(Layer.of(positions, values, system.particles.spacing, label, unit, **options))
    return layers


def _title(name) -> str:
    return name if isinstance(name, str) else ", ".join(name or ())


def _colors(system) -> dict:
    if isinstance(system, Structure):
        return STRUCTURE_COLORS
    if isinstance(system, RigidBody):
        return BODY_COLORS
    return FLUID_COLORS if isinstance(system, Fluid) else {}


def _key(system, color) -> str | None:
    """What colors a system."""
    known = _colors(system)
    if color is None or not known or (isinstance(system, RigidBody) and color not in known):
        return None
    return color if color in known else next(iter(known))


def _asked(systems, color) -> str | None:
    """Label of the scale that limits and a color map are meant for: the one asked for, else that of the first."""
    keys = [(_colors(system), _key(system, color)) for system in systems]
    labels = [known[key][0] for known, key in keys if key is not None and color in (AUTOMATIC, key)]
    return labels[0] if labels else None


def _values(scene, system, states, key) -> np.ndarray:
    """Numbers (T, N) or vectors (T, N, d) of some saved states."""
    fields, name = states.systems[system.name], system.name
    if key in fields:
        return np.asarray(fields[key])
    if key in ("pressure", "density"):
        of_state = observe.pressure if key == "pressure" else observe.density
        return np.asarray(jax.vmap(lambda state: of_state(scene, state, name))(states))
    if key in ("von_mises", "pk1"):
        return np.asarray(_stress(scene, states, topologies(scene), name=name, key=key))
    room, last = 2.0, jax.tree.map(lambda leaf: leaf[-1], states)
    while True:
        found = np.asarray(_vorticity(scene, states, topologies(scene, last, capacity_multiplier=room), name=name))
        if np.all(np.isfinite(found)) or room > 8 or not np.all(np.isfinite(fields["velocity"])):
            return found
        room *= 2


def _stress_of_states(scene, states, found, *, name, key):
    """Von Mises stress, or the norm sqrt(P : P) of the PK1 stress (T, N) [Pa]."""

    def size(state):
        stress = observe.stresses(scene, state, name, found)[key]
        return stress if key == "von_mises" else jnp.sqrt(jnp.sum(stress**2, axis=(-2, -1)))

    return jax.lax.map(size, states)


def _vorticity_of_states(scene, states, found, *, name):
    return jax.lax.map(lambda state: observe.vorticity(scene, state, name, found), states)


_stress = jax.jit(_stress_of_states, static_argnames=("name", "key"))
_vorticity = jax.jit(_vorticity_of_states, static_argnames="name")


def _range(system, values) -> tuple[float, float]:
    """Ends of a scale, without the tails of a fluid's numbers."""
    numbers = np.linalg.norm(values, axis=-1) if values.ndim == 3 else values
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return 0.0, 1.0
    ends = (TAIL, 100 - TAIL) if isinstance(system, Fluid) else (0, 100)
    low, high = np.percentile(numbers, ends)
    return float(low), float(high)


def _joined(ranges) -> tuple[float, float]:
    low, high = min(r[0] for r in ranges), max(r[1] for r in ranges)
    if both_signs(np.array([low, high]), TRACE):
        high = max(-low, high)
        return -high, high
    return (low, high) if low < high else (low - 0.5, high + 0.5)
