"""Free fluids: an oscillating drop, Monaghan's elliptical drop, a rotating square patch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxsph.effects import ArtificialViscosity, BodyForce, DeltaDiffusion, ParticleShifting, TensileControl
from jaxsph.fluid import Fluid
from jaxsph.geometry import Particles, ball, box
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene


@dataclasses.dataclass(frozen=True)
class _TowardsCenter:
    """-frequency^2 x, for `BodyForce`."""

    frequency: float

    def __call__(self, positions, time):
        return -(self.frequency**2) * positions


def oscillating_drop(
    particles: int = 20,
    *,
    radius: float = 1.0,
    rate: float = 0.5,
    frequency: float = 1.0,
    density: float = 1000.0,
    sound_speed: float = 15.0,
    effects: Sequence | None = None,
    smoothing: float = 1.7,
    dtype=None,
) -> Scene:
    """A drop in the force field -frequency^2 x, which stretches along x and y in turn; an ellipse at all times.

    J. J. Monaghan, A. Rafiee (2013), Int. J. Numer. Methods Fluids 71, 537; for frequency 0 Monaghan's drop (1994),
    which stretches for good, J. Comput. Phys. 110, 399, section 5.

    Args:
        particles: along the radius.
        radius: [m].
        rate: A in the initial velocity (A x, -A y) [1/s].
        frequency: [rad/s].
        density, sound_speed: [kg/m^3], [m/s].
        effects: beside the force; None takes `DeltaDiffusion(0.1)`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = radius / particles
    drop = rings((0.0, 0.0), radius, spacing, dtype=dtype)
    # The pressure that keeps an ellipse an ellipse: p = rho (A^2 + w^2) (R^2 - r^2) / 2.
    strength = 0.5 * density * (rate**2 + frequency**2)
    water = Fluid(
        "water",
        drop,
        density=density,
        sound_speed=sound_speed,
        velocity=lambda x: rate * x * np.array([1.0, -1.0]),
        pressure=lambda x: strength * (radius**2 - np.sum(x**2, axis=1)),
    )
    listed: list = [DeltaDiffusion(0.1)] if effects is None else list(effects)
    if frequency:
        listed.append(BodyForce(_TowardsCenter(frequency)))
    reach = 6 * radius
    return Scene(
        water, effects=listed, smoothing_length=smoothing * spacing, domain=Domain((-reach, -reach), (reach, reach))
    )


def rings(center, radius: float, spacing: float, *, dtype=None) -> Particles:
    """A disk filled by rings of particles around its center: a smooth rim, and the same volume for each particle.

    Args:
        center: (2,) [m].
        radius, spacing: [m]; rings are as far from each other as the spacing, to within the rounding of their number.
        dtype: float32 or float64; None takes jax's default.
    """
    count = max(round(radius / spacing), 1)
    step = radius / count
    points = []
    for k in range(count):
        r, n = (k + 0.5) * step, max(round(2 * np.pi * (k + 0.5)), 3)
        angles = 2 * np.pi * (np.arange(n) + 0.5 * (k % 2)) / n
        points.append(r * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    positions = np.concatenate(points) + np.asarray(center, float)
    real = ball((0, 0), 1.0, 1.0, dtype=dtype).positions.dtype
    volume = np.pi * radius**2 / len(positions)
    return Particles(positions.astype(real), np.full(len(positions), volume).astype(real), float(spacing))


def rotating_square(
    particles: int = 50,
    *,
    side: float = 1.0,
    frequency: float = 1.0,
    density: float = 1000.0,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """A square of fluid that rotates as a rigid body at the start: its corners become arms, its middle is torn at.

    A. Colagrossi (2005), PhD thesis, Rome. The initial pressure is the solution of lap p = 2 rho w^2 with p = 0 on the
    edges, by its Fourier series.

    Args:
        particles: along an edge.
        side: [m].
        frequency: w [rad/s].
        density: [kg/m^3].
        sound_speed: [m/s]; None takes 14 w side, twenty times the speed of the corners.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `TensileControl()` and
            `ParticleShifting` with a free surface.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = side / particles
    water = Fluid(
        "water",
        box((-side / 2, -side / 2), (side, side), spacing, dtype=dtype),
        density=density,
        sound_speed=14 * abs(frequency) * side if sound_speed is None else sound_speed,
        velocity=lambda x: frequency * np.stack([x[:, 1], -x[:, 0]], axis=1),
        pressure=lambda x: density * frequency**2 * patch_pressure(x / side + 0.5) * side**2,
    )
    reach = 4 * side
    return Scene(
        water,
        effects=_holding_together(abs(frequency) * side) if effects is None else effects,
        smoothing_length=smoothing * spacing,
        domain=Domain((-reach, -reach), (reach, reach)),
    )


def _holding_together(speed: float) -> list:
    """Effects for a fluid under tension."""
    shifting = ParticleShifting(speed=speed, free_surface=True)
    return [DeltaDiffusion(0.1), ArtificialViscosity(0.02), shifting, TensileControl()]


def patch_pressure(x, terms: int = 101):
    """Pressure of a rotating unit square over rho w^2 side^2, at points (N, 2) between 0 and 1."""
    x = np.asarray(x, float)
    odd = np.arange(1, terms, 2)
    along, across = np.sin(np.pi * np.outer(x[:, 0], odd)), np.sin(np.pi * np.outer(x[:, 1], odd))
    weights = 32 / (np.pi**4 * np.outer(odd, odd) * (odd[:, None] ** 2 + odd[None] ** 2))
    return -np.einsum("ni,nj,ij->n", along, across, weights)
