"""The Taylor-Green vortex."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsph.effects import DensityDiffusion, ParticleShifting
from jaxsph.fluid import Fluid
from jaxsph.geometry import box, jitter
from jaxsph.kernels import QuinticSpline
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene


def taylor_green(
    particles: int = 50,
    *,
    reynolds: float = 100.0,
    dimension: int = 2,
    sound_speed: float = 10.0,
    disorder: float = 0.0,
    effects: Sequence | None = None,
    density=None,
    dtype=None,
) -> Scene:
    """Vortices that decay by viscosity in the periodic unit square or cube; length, velocity and density are 1.

    In 2D the exact velocity is exp(-8 pi^2 t / Re) (-cos 2 pi x sin 2 pi y, sin 2 pi x cos 2 pi y). In 3D the vortices
    have the same velocity times cos 2 pi z at the start, and break up.

    Args:
        particles: along an edge.
        reynolds: Re = U L / nu.
        dimension: 2 or 3.
        sound_speed: [m/s].
        disorder: by how many spacings the particles of the start are moved at random, at most, along each axis.
        effects: None takes `DensityDiffusion(0.1)` and `ParticleShifting(1.0)`.
        density: calculator; None takes `ContinuityDensity()`.
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for less than 8 particles or another dimension.
    """
    if particles < 8 or dimension not in (2, 3):
        raise ValueError(f"{particles} particles along an edge in {dimension}D; at least 8 are needed, in 2D or 3D")
    spacing, lower, upper = 1.0 / particles, (0.0,) * dimension, (1.0,) * dimension
    k = 2 * np.pi

    def velocity(x):
        depth = np.cos(k * x[:, 2]) if dimension == 3 else 1.0
        u = -np.cos(k * x[:, 0]) * np.sin(k * x[:, 1]) * depth
        v = np.sin(k * x[:, 0]) * np.cos(k * x[:, 1]) * depth
        return np.stack([u, v, np.zeros_like(u)][:dimension], axis=1)

    def pressure(x):
        plane = np.cos(2 * k * x[:, 0]) + np.cos(2 * k * x[:, 1])
        return -0.25 * plane if dimension == 2 else -plane * (np.cos(2 * k * x[:, 2]) + 2) / 16

    lattice = box(lower, upper, spacing, dtype=dtype)
    water = Fluid(
        "water",
        jitter(lattice, disorder, seed=1) if disorder else lattice,
        density=1.0,
        sound_speed=sound_speed,
        viscosity=1.0 / reynolds,
        velocity=velocity,
        pressure=pressure,
    )
    if effects is None:
        effects = [DensityDiffusion(0.1), ParticleShifting(1.0)]
    return Scene(
        water,
        effects=effects,
        density=density,
        kernel=QuinticSpline(),
        smoothing_length=spacing,
        domain=Domain(lower, upper, periodic=True),
    )
