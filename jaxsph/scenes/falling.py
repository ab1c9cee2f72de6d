"""Bodies that fall into water, and water that falls on a beam."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsph.effects import ArtificialViscosity, Contact, DeltaDiffusion, PenaltyForce, WallRepulsion
from jaxsph.fluid import Fluid
from jaxsph.geometry import ball, box, clamped_strip, tank
from jaxsph.geometry.strip import spacing_across
from jaxsph.materials import MonaghanViscosity, NeoHookean, StVenantKirchhoff
from jaxsph.neighbors import Domain
from jaxsph.rigid_body import RigidBody
from jaxsph.scene import Scene
from jaxsph.scenes.tank_flow import GRAVITY, layers_of
from jaxsph.structure import Structure
from jaxsph.walls import AdamiExtrapolation, BernoulliExtrapolation, Wall

PENALTY = 0.1
SPHERES = {2: (((0.5, 1.6), 0.3, 500.0, 7e4), ((1.5, 1.6), 0.2, 1100.0, 1e5)), 3: (((0.5, 0.5, 1.6), 0.3, 500.0, 7e4),)}
"""Centers [m], radii [m], densities [kg/m^3] and Young's moduli [Pa] of the spheres that fall in 2D and in 3D."""
IN_WATER = (DeltaDiffusion(0.1), ArtificialViscosity(0.02), WallRepulsion(1.0, solids=True))
"""Effects of what falls into water, without contact."""


def falling_spheres(
    spacing: float = 0.02,
    *,
    dimension: int = 2,
    spheres: Sequence[tuple] | None = None,
    poisson_ratio: float = 0.0,
    depth: float = 0.9,
    inside: Sequence[float] | None = None,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    smoothing: float = 1.5,
    effects: Sequence | None = None,
    law: Any = None,
    dtype=None,
) -> Scene:
    """Elastic spheres that fall into a tank of water; they touch each other and the walls.

    In 2D a light one of .3 m radius and a heavy one of .2 m, in 3D one. They are soft: the impact stresses them by the
    order of their Young's modulus, under which St. Venant and Kirchhoff's law would collapse.

    Args:
        spacing: of all particles [m].
        dimension: 2 or 3.
        spheres: center (d,), radius, density and Young's modulus of each, called "sphere_1" on; None takes `SPHERES`.
        poisson_ratio: of the spheres.
        depth: of the water [m].
        inside: of the tank (d,) [m]; None takes 2 m x 2 m, in 3D 1 m x 1 m x 1.6 m. Water must not spill over.
        density, sound_speed, viscosity: of the water; a sound speed of None is ten times the larger of sqrt(g depth)
            and the speed of the fastest sphere at the surface.
        smoothing: smoothing length in spacings.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(0.1)`, `Contact()` and,
            since single particles of spray sink into spheres and walls without it, `WallRepulsion(1.0, solids=True)`.
        law: elastic law; None takes `NeoHookean()`.
        dtype: float32 or float64; None takes jax's default.
    """

    def body(name, center, radius, density, modulus):
        return Structure(
            name,
            ball(center, radius, spacing, dtype=dtype),
            density=density,
            youngs_modulus=modulus,
            poisson_ratio=poisson_ratio,
            law=NeoHookean() if law is None else law,
            pressure=BernoulliExtrapolation(clip=True),
        )

    given = SPHERES[dimension] if spheres is None else spheres
    solids = [body(f"sphere_{number}", *sphere) for number, sphere in enumerate(given, 1)]
    common = [*IN_WATER, Contact(), PenaltyForce(PENALTY)]
    water = {"density": density, "sound_speed": sound_speed, "viscosity": viscosity}
    effects = common if effects is None else effects
    return _into_water(solids, spacing, depth, inside, dimension, effects, smoothing, dtype, water)


def falling_rigid_spheres(
    spacing: float = 0.02,
    *,
    dimension: int = 2,
    spheres: Sequence[tuple] | None = None,
    depth: float = 0.9,
    inside: Sequence[float] | None = None,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    smoothing: float = 1.5,
    effects: Sequence | None = None,
    dtype=None,
) -> Scene:
    """The scene of `falling_spheres` with rigid bodies.

    Args:
        spheres: center (d,), radius and density of each; None takes those of `SPHERES`.
        spacing, dimension, depth, inside, density, sound_speed, viscosity, smoothing, dtype: as `falling_spheres`.
        effects: None takes those of `falling_spheres` without the penalty force, and `Contact(1.0)`: rigid bodies do
            not give, and with the softer default the heavy one comes to the floor by more than half a spacing.
    """
    given = [sphere[:3] for sphere in SPHERES[dimension]] if spheres is None else spheres
    solids = [
        RigidBody(
            f"sphere_{number}",
            ball(center, radius, spacing, dtype=dtype),
            density=rho,
            pressure=BernoulliExtrapolation(clip=True),
        )
        for number, (center, radius, rho) in enumerate(given, 1)
    ]
    common = [*IN_WATER, Contact(1.0)]
    water = {"density": density, "sound_speed": sound_speed, "viscosity": viscosity}
    effects = common if effects is None else effects
    return _into_water(solids, spacing, depth, inside, dimension, effects, smoothing, dtype, water)


def _into_water(solids, spacing, depth, inside, dimension, effects, smoothing, dtype, water):
    if inside is None:
        inside = (2.0, 2.0) if dimension == 2 else (1.0, 1.0, 1.6)
    layers = layers_of(smoothing, least=1)
    if not solids:
        raise ValueError("spheres is empty; falling bodies need at least one, still_water is without")
    corner, size = np.zeros(dimension), np.asarray(inside, float)
    fall = max(float(np.min(solid.particles.positions[:, -1])) for solid in solids) - 0.5 * spacing - depth
    sound_speed = (
        10 * math.sqrt(GRAVITY * max(depth, 2 * fall)) if water["sound_speed"] is None else water["sound_speed"]
    )
    pool = Fluid(
        "water",
        box(corner, (*size[:-1], depth), spacing, dtype=dtype),
        **{**water, "sound_speed": sound_speed},
        viscosity_law=MonaghanViscosity(),
        pressure=lambda x: water["density"] * GRAVITY * (depth - x[:, -1]),
    )
    basin = Wall("tank", tank(corner, size, spacing, layers, dtype=dtype), AdamiExtrapolation(clip=True), no_slip=False)
    gravity = np.zeros(dimension)
    gravity[-1] = -GRAVITY
    return Scene(
        pool,
        basin,
        *solids,
        gravity=gravity,
        effects=effects,
        smoothing_length=smoothing * spacing,
        domain=Domain(-2 * size, 4 * size),
    )


def falling_column_on_beam(
    particles: int = 10,
    across: int = 5,
    *,
    youngs_modulus: float = 1.4e6,
    poisson_ratio: float = 0.4,
    beam_density: float = 1000.0,
    length: float = 0.35,
    thickness: float = 0.02,
    width: float = 0.1,
    height: float = 0.2,
    place: float = 0.2,
    drop: float = 0.05,
    density: float = 1000.0,
    sound_speed: float | None = None,
    smoothing: float = 1.75,
    effects: Sequence | None = None,
    law: Any = None,
    dtype=None,
) -> Scene:
    """A column of water that arrives on a cantilever, the beam of Turek and Hron, in the side of a tank.

    Args:
        particles: over the width of the column.
        across: particles over the thickness of the beam, the outermost on its surfaces.
        youngs_modulus, poisson_ratio, beam_density, length, thickness: of the beam.
        width, height: of the column [m]; multiples of width / particles.
        place: of its middle along the beam [m].
        drop: from which it has fallen when it arrives at t = 0 [m].
        density, sound_speed: of the water; None takes ten times the speed with which its top reaches the floor.
        smoothing: smoothing length in spacings.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(1)`.
        law: elastic law; None takes `StVenantKirchhoff()`.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing, fine = width / particles, spacing_across(thickness, across)
    layers = layers_of(smoothing)
    root = layers * spacing
    strip = clamped_strip(length, thickness, across, math.ceil(root / fine), dtype)
    below = strip.positions - np.array([0.0, 0.5 * thickness])  # its upper side at y = 0
    body = dataclasses.replace(strip, positions=below.astype(strip.positions.dtype))
    beam = Structure(
        "beam",
        body,
        density=beam_density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=lambda x: x[:, 0] < fine,
        law=StVenantKirchhoff() if law is None else law,
        pressure=AdamiExtrapolation(clip=True),
        thickness=thickness,
    )
    floor, size = round(-1.6 * length / spacing) * spacing, round(2 * length / spacing) * spacing
    walls = tank((0, floor), (size, size), spacing, layers, dtype=dtype)
    low, high = np.min(body.positions, axis=0), np.max(body.positions, axis=0)
    socket = np.all((walls.positions > low - 0.1 * fine) & (walls.positions < high + 0.1 * fine), axis=1)
    basin = Wall("tank", walls.where(~socket), AdamiExtrapolation(clip=True), no_slip=False)
    water = Fluid(
        "water",
        # where the cells of the outermost particles of the beam end
        box((place - 0.5 * width, 0.5 * fine), (width, height), spacing, dtype=dtype),
        density=density,
        sound_speed=10 * math.sqrt(2 * GRAVITY * (drop + height - floor)) if sound_speed is None else sound_speed,
        velocity=(0.0, -math.sqrt(2 * GRAVITY * drop)),
    )
    common = [DeltaDiffusion(0.1), ArtificialViscosity(0.02), PenaltyForce(1.0)]
    return Scene(
        water,
        basin,
        beam,
        gravity=(0.0, -GRAVITY),
        effects=common if effects is None else effects,
        smoothing_length=smoothing * spacing,
        domain=Domain((-size, floor - size), (2 * size, floor + 3 * size)),
    )
