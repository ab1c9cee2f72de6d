"""Shapes filled with particles.

Each particle carries the volume that it stands for. In a box with `on_surface=True` the outermost particles
lie on the surface and stand for half a cell (a quarter in an edge, an eighth in a corner), so that the box has
the volume, mass and moments of the body itself: the trapezoidal rule. For thin elastic bodies this is what
makes the bending stiffness right: see docs/formulation.md.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.pytree import is_concrete, pytree_dataclass, static


@pytree_dataclass
class Particles:
    """Positions (N, d) [m], volumes (N,) [m^d] and the spacing [m] that they were made with.

    on_surface: whether the outermost ones lie on the surface and stand for the part of their cell that is inside.

    Lists will do, of a mesh or a point cloud of one's own. float64 becomes float32 unless jax has float64 enabled.
    """

    positions: Any
    volumes: Any
    spacing: float = static()
    on_surface: bool = static(default=False)

    def __post_init__(self):
        for name in ("positions", "volumes"):
            value = getattr(self, name)
            if is_concrete(value):  # as jax would: without JAX_ENABLE_X64 numbers are float32
                value = np.asarray(value)
                real = value.dtype if np.issubdtype(value.dtype, np.floating) else np.dtype(float)
                object.__setattr__(self, name, value.astype(jax.dtypes.canonicalize_dtype(real), copy=False))
        n = np.shape(self.positions)[0] if np.ndim(self.positions) == 2 else -1
        if n < 1 or np.shape(self.positions)[1] not in (2, 3):
            raise ValueError(f"positions has shape {np.shape(self.positions)}; it must be (N, 2) or (N, 3) with N >= 1")
        if np.shape(self.volumes) != (n,):
            raise ValueError(f"volumes has shape {np.shape(self.volumes)}; it must be ({n},), one for each position")
        check_spacing(self.spacing)
        if not np.all(np.isfinite(self.positions)):
            first = int(np.argmax(~np.isfinite(self.positions).all(axis=1)))
            raise ValueError(f"positions[{first}] = {self.positions[first]} is not finite")
        if not np.all(np.asarray(self.volumes) > 0):
            first = int(np.argmin(self.volumes))
            raise ValueError(f"volumes[{first}] = {self.volumes[first]} must be positive")

    def __len__(self):
        return self.positions.shape[0]

    def __or__(self, other: Particles) -> Particles:
        """Both sets together; they should not overlap.

        Raises ValueError if their dimensions differ, or their spacings where one of them has particles on its surface:
        what part of a cell these stand for is known for one spacing only.
        """
        if self.positions.shape[1] != other.positions.shape[1]:
            raise ValueError(
                f"particles in {self.positions.shape[1]}D and {other.positions.shape[1]}D cannot be joined"
            )
        unlike = abs(self.spacing - other.spacing) > 1e-6 * self.spacing
        if unlike and (self.on_surface or other.on_surface):
            raise ValueError(
                f"particles with spacings of {self.spacing:g} and {other.spacing:g} m, of which some lie on a surface, "
                "cannot be joined: make them with one spacing, or two systems of them"
            )
        return Particles(
            np.concatenate([self.positions, other.positions]),
            np.concatenate([self.volumes, other.volumes]),
            min(self.spacing, other.spacing),
            self.on_surface or other.on_surface,
        )

    @property
    def cells(self):
        """Volumes (N,) [m^d] of the whole cells around the particles, with which fluids meet them.

        With the half of a cell that a particle on a surface stands for, water of the same spacing would be held off by
        next to nothing. On an edge it is a quarter, in a corner an eighth. Without `on_surface` they are the volumes.
        """
        if not self.on_surface:
            return self.volumes
        halves = jnp.round(jnp.log2(self.spacing ** self.positions.shape[1] / jnp.asarray(self.volumes)))
        return self.volumes * jnp.exp2(jnp.maximum(halves, 0))

    def moved(self, offset) -> Particles:
        """The particles elsewhere, by an offset (d,) [m], in their precision."""
        offset = np.asarray(offset, self.positions.dtype)
        return Particles(self.positions + offset, self.volumes, self.spacing, self.on_surface)

    def where(self, mask) -> Particles:
        """The particles for which mask (N,) is true."""
        mask = np.asarray(mask, bool)
        return Particles(self.positions[mask], self.volumes[mask], self.spacing, self.on_surface)


def check_spacing(spacing: float) -> None:
    """Raise ValueError unless a particle spacing is a positive finite number."""
    if not (isinstance(spacing, (int, float, np.floating)) and math.isfinite(spacing) and spacing > 0):
        raise ValueError(f"particle spacing is {spacing!r}; it must be a positive finite length in meters")


def floating(dtype):
    """The type of positions: that asked for, or jax's default. Raises ValueError for float64 that is not enabled."""
    if dtype is None:
        return jax.dtypes.canonicalize_dtype(np.float64)
    asked = np.dtype(dtype)
    if jax.dtypes.canonicalize_dtype(asked) != asked:
        raise ValueError(
            f"dtype is {asked.name}, which jax has not enabled: set JAX_ENABLE_X64=1, or call "
            'jax.config.update("jax_enable_x64", True) first'
        )
    return asked


def box(corner, size, spacing: float, *, on_surface: bool = False, dtype=None) -> Particles:
    """A box filled with a square lattice, last axis fastest.

    Args:
        corner: lower corner (d,) [m].
        size: edge lengths (d,) [m].
        spacing: distance of particles [m]. The sizes must be multiples of it to within 1 %; the lattice is
            then stretched to fill the box exactly.
        on_surface: False puts particles into the centers of cells, half a spacing inside (fluids, tanks).
            True puts the outermost ones on the surface, with half the volume (elastic bodies).
        dtype: float32 or float64; None takes jax's default.

    Raises:
        ValueError: a size that is not positive or does not fit the spacing.
    """
    check_spacing(spacing)
    corner, size = np.atleast_1d(np.asarray(corner, float)), np.atleast_1d(np.asarray(size, float))
    if corner.shape != size.shape or corner.shape[0] not in (2, 3):
        raise ValueError(f"corner {corner} and size {size} must both have 2 or 3 components")
    axes, weights = [], []
    for k, (start, length) in enumerate(zip(corner, size, strict=True)):
        cells = round(length / spacing)
        if not (length > 0 and cells >= 1 and abs(cells * spacing / length - 1) < 0.01):
            raise ValueError(
                f"size[{k}] = {length} is not a positive multiple of the spacing {spacing}; "
                f"the nearest that fits is {max(cells, 1) * spacing:.6g}"
            )
        step = length / cells
        if on_surface:
            axes.append(start + step * np.arange(cells + 1))
            weight = np.full(cells + 1, step)
            weight[[0, -1]] *= 0.5
        else:
            axes.append(start + step * (np.arange(cells) + 0.5))
            weight = np.full(cells, step)
        weights.append(weight)
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    volumes = np.prod(np.stack(np.meshgrid(*weights, indexing="ij"), axis=-1), axis=-1).ravel()
    real = floating(dtype)
    return Particles(positions.astype(real), volumes.astype(real), float(spacing), on_surface)


def ball(center, radius: float, spacing: float, *, dtype=None) -> Particles:
    """A disk (2D) or ball (3D) cut out of a square lattice around its center, with its exact total volume.

    Raises ValueError for a radius below the spacing, or a center that has not 2 or 3 components.
    """
    check_spacing(spacing)
    center = np.asarray(center, float)
    if center.shape not in ((2,), (3,)):
        raise ValueError(f"center {center} must have 2 or 3 components")
    if not radius >= spacing:
        raise ValueError(f"radius {radius} must be at least the particle spacing {spacing}")
    reach = math.ceil(radius / spacing)
    steps = np.arange(-reach, reach + 1) * spacing
    lattice = np.stack(np.meshgrid(*[steps] * len(center), indexing="ij"), axis=-1).reshape(-1, len(center))
    inside = lattice[np.linalg.norm(lattice, axis=1) <= radius * (1 + 1e-9)]
    volume = math.pi * radius**2 if len(center) == 2 else 4 / 3 * math.pi * radius**3
    real = floating(dtype)
    volumes = np.full(len(inside), volume / len(inside))
    return Particles((center + inside).astype(real), volumes.astype(real), float(spacing))


def jitter(particles: Particles, fraction: float, seed: int) -> Particles:
    """Move every particle at random by up to `fraction` of the spacing along each axis.

    Raises ValueError for a fraction outside of 0 to 1/2, where particles could meet.
    """
    if not 0 <= fraction < 0.5:
        raise ValueError(
            f"fraction = {fraction} of the spacing must be at least 0 and less than 0.5: particles would meet"
        )
    shift = np.random.default_rng(seed).uniform(-1, 1, particles.positions.shape) * fraction * particles.spacing
    return dataclasses.replace(particles, positions=(particles.positions + shift).astype(particles.positions.dtype))
