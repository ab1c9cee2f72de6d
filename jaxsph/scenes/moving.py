"""Scenes that something sets in motion: a wave, a gate, a wall, a fall."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxsph.geometry import box
from jaxsph.pytree import replace
from jaxsph.scene import Scene
from jaxsph.scenes.tank_flow import GRAVITY, column_in_tank, layers_of
from jaxsph.walls import AdamiExtrapolation, Wall


def standing_wave(
    particles: int = 50,
    *,
    depth: float = 1.0,
    wavelength: float = 2.0,
    steepness: float = 0.05,
    reynolds: float | None = None,
    density: float = 1000.0,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """A standing wave of half a length in a tank with free slip: flat at the start, with the velocity of linear theory.

    Kinetic energy decays with the rate 4 nu k^2. P. A. Madsen, H. A. Schaffer (2006) and M. Antuono, A. Colagrossi
    (2013), Wave Motion 50, 197, use it to measure the viscosity of a scheme.

    Args:
        particles: over the depth.
        depth, wavelength: [m]; the tank is half a wavelength long.
        steepness: twice the amplitude over the wavelength.
        reynolds: depth sqrt(g depth) / nu; None is inviscid.
        density: [kg/m^3].
        sound_speed: [m/s]; None takes 10 sqrt(2 g depth).
        effects: None takes those of `column_in_tank`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = depth / particles
    length = round(0.5 * wavelength / spacing) * spacing
    k = math.pi / length
    frequency = math.sqrt(GRAVITY * k * math.tanh(k * depth))
    amplitude = 0.5 * steepness * wavelength
    viscosity = None if reynolds is None else density * depth * math.sqrt(GRAVITY * depth) / reynolds
    scene = column_in_tank(
        (length, depth),
        (length, round(1.3 * particles) * spacing),
        spacing,
        density=density,
        sound_speed=sound_speed,
        viscosity=viscosity,
        effects=effects,
        smoothing=smoothing,
        dtype=dtype,
    )
    x, y = np.asarray(scene["water"].particles.positions, float).T
    # Potential a g / w cosh(k y) / cosh(k d) cos(k x) at the moment when the surface is flat.
    strength = amplitude * GRAVITY * k / (frequency * math.cosh(k * depth))
    u = -strength * np.cosh(k * y) * np.sin(k * x)
    v = strength * np.sinh(k * y) * np.cos(k * x)
    return scene.replace({"water.velocity": np.stack([u, v], axis=1)})


@dataclasses.dataclass(frozen=True)
class _Lift:
    """Vertical displacement of a gate: a polynomial of time until `end`, then at rest."""

    coefficients: tuple[float, ...]
    end: float

    def __call__(self, time, positions):
        t = jnp.minimum(time, self.end)
        rise = sum(c * t ** (k + 1) for k, c in enumerate(self.coefficients))
        return jnp.zeros_like(positions).at[:, -1].set(rise)


def dam_break_gate(
    spacing: float = 0.02,
    *,
    sound_speed: float = 28.01,
    effects: Sequence | None = None,
    smoothing: float = 1.75,
    dtype=None,
) -> Scene:
    """Water behind a gate that is pulled up in .1 s; without the elastic plate.

    K. Liao, C. Hu, M. Sueyoshi (2015), Appl. Ocean Res. 50, 57: a column of .2 m x .4 m in a tank of .8 m; the gate's
    displacement is -285.115 t^3 + 72.305 t^2 + .1463 t. It is three layers of particles thick, with a large smoothing
    length as many as the support radius holds.

    Args:
        spacing: [m], a divisor of .2 m.
        sound_speed: [m/s].
        effects: None takes those of `column_in_tank`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    layers = max(3, math.floor(2 * smoothing))
    gate = Wall(
        "gate",
        box((0.2, 0.0), (layers * spacing, round(0.48 / spacing) * spacing), spacing, dtype=dtype),
        AdamiExtrapolation(clip=True),
        no_slip=False,
        motion=_Lift((0.1463, 72.305, -285.115), 0.1),
    )
    return column_in_tank(
        (0.2, 0.4),
        (0.8, 0.8),
        spacing,
        density=997.0,
        sound_speed=sound_speed,
        effects=effects,
        smoothing=smoothing,
        walls=[gate],
        dtype=dtype,
    )


@dataclasses.dataclass(frozen=True)
class _Push:
    """Displacement along x that grows smoothly from rest to a constant speed."""

    speed: float
    start: float

    def __call__(self, time, positions):
        # The integral of speed tanh(t / start), as the logarithm of cosh without its overflow.
        share = time / self.start
        way = self.speed * self.start * (jnp.logaddexp(share, -share) - math.log(2))
        return jnp.zeros_like(positions).at[:, 0].set(way)


def moving_wall(
    particles: int = 20,
    *,
    depth: float = 0.5,
    length: float = 2.0,
    speed: float = 0.5,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """A wall that pushes still water along a tank: a bore runs ahead of it.

    Args:
        particles: over the depth.
        depth, length: of the water [m].
        speed: of the wall, reached within depth / |speed| / 5 [m/s]; below zero it is drawn away.
        sound_speed: [m/s]; None takes 10 sqrt(2 g depth).
        effects: None takes those of `column_in_tank`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for a wall that stands still.
    """
    if not (math.isfinite(speed) and speed):
        raise ValueError(f"speed = {speed} of the wall must be a number other than zero [m/s]")
    spacing, layers = depth / particles, layers_of(smoothing)
    cells, height = round(length / spacing), round(2.5 * particles) * spacing
    wall = Wall(
        "wall",
        box((-layers * spacing, 0.0), (layers * spacing, height), spacing, dtype=dtype),
        AdamiExtrapolation(clip=True),
        no_slip=False,
        motion=_Push(speed, 0.2 * depth / abs(speed)),
    )
    scene = column_in_tank(
        (cells * spacing, depth),
        (cells * spacing, height),
        spacing,
        sound_speed=sound_speed,
        effects=effects,
        smoothing=smoothing,
        walls=[wall],
        dtype=dtype,
    )
    # The wall takes the place of the tank's left side, and slides on its floor.
    basin = scene["tank"]
    keep = ~((basin.particles.positions[:, 0] < 0) & (basin.particles.positions[:, 1] > 0))
    systems = tuple(replace(s, particles=s.particles.where(keep)) if s.name == "tank" else s for s in scene.systems)
    return replace(scene, systems=systems)


def falling_column(
    particles: int = 20,
    *,
    height: float = 0.4,
    width: float = 0.2,
    drop: float = 0.2,
    pool: float = 0.1,
    length: float = 1.0,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """A column of water that falls into a pool.

    Args:
        particles: over the height of the column.
        height, width: of the column [m].
        drop: from its foot to the surface of the pool [m].
        pool, length: depth and length of the pool [m].
        sound_speed: [m/s]; None takes 10 times the speed at the impact of its top.
        effects: None takes those of `column_in_tank`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = height / particles
    fit = lambda x: round(x / spacing) * spacing  # noqa: E731
    top = fit(pool + drop) + height
    scene = column_in_tank(
        (fit(length), fit(pool)),
        (fit(length), fit(1.2 * top)),
        spacing,
        sound_speed=10 * math.sqrt(2 * GRAVITY * (drop + height)) if sound_speed is None else sound_speed,
        effects=effects,
        smoothing=smoothing,
        dtype=dtype,
    )
    water = scene["water"]
    start = (fit(0.5 * (length - width)), fit(pool + drop))
    column = box(start, (fit(width), height), spacing, dtype=dtype)
    pressure = np.concatenate([np.asarray(water.pressure), np.zeros(len(column))])
    both = replace(water, particles=water.particles | column, pressure=pressure.astype(water.dtype))
    return replace(scene, systems=tuple(both if s.name == "water" else s for s in scene.systems))
