"""The numbers of a scene from which everything else follows: speed, length, viscosities, steps, neighborhoods."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.effects import ArtificialViscosity, BodyForce
from jaxsph.explain import arrangement
from jaxsph.materials.elastic import p_wave_speed
from jaxsph.stable_step import fluid_time_step

MOMENTS = 200  # at which the speed of a moving wall is looked at


@dataclass(frozen=True)
class Facts:
    """What is known of a scene before it runs. Lengths in m, times in s.

    Attributes:
        speed, speed_from: characteristic speed U, and what it is the speed of; None if nothing moves.
        length, length_from: characteristic length L.
        gravity: |g|, where it can make fluid fall; 0 along a periodic direction.
        fall: how far fluid, or a structure beside it, can fall.
        viscosity: kinematic, the largest of the fluids; 0 if all are inviscid.
        numerical_viscosity: kinematic, that artificial viscosity acts like.
        open_share: share of fluid particles at a free surface.
        lowest_pressure: of the start [Pa].
        neighbors: mean and largest number within the support radius.
        layers: by wall, how many it has where fluid touches it, and how many a particle there can see.
        across: by structure, particles across it.
        steps: by fluid the largest stable step; by structure the spacing over the p-wave speed, which is about that.
    """

    scene: Any
    speed: float | int | None
    speed_from: str
    length: float | int
    length_from: str
    gravity: float = 0.0
    fall: float = 0.0
    viscosity: float = 0.0
    numerical_viscosity: float = 0.0
    open_share: float = 0.0
    lowest_pressure: float = 0.0
    neighbors: tuple[float, int] = (0.0, 0)
    layers: dict[str, tuple[float, int]] = field(default_factory=dict)
    across: dict[str, int] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    surface_tension: float | int | None = None

    @property
    def is_open(self) -> bool:
        """Whether the fluid has a free surface."""
        return self.open_share > 0.002

    @property
    def sound_speed(self) -> float:
        """The lowest of the fluids [m/s]."""
        return min(float(fluid.sound_speed) for fluid in self.scene.fluids)

    @property
    def density(self) -> float:
        """The highest of the fluids [kg/m^3]."""
        return max(float(fluid.density) for fluid in self.scene.fluids)

    @property
    def smoothing_length(self) -> float:
        """h of the fluids [m]."""
        return float(self.scene.smoothing_length)

    @property
    def reynolds(self) -> float:
        """U L / nu; infinite for inviscid fluids."""
        return self.speed * self.length / self.viscosity if self.viscosity and self.speed else math.inf

    @property
    def mach(self) -> float:
        """U / c."""
        return (self.speed or 0.0) / self.sound_speed

    @property
    def layer(self) -> float:
        """Thickness of the viscous layer at a wall, L / sqrt(Re), at most L [m]."""
        return self.length / math.sqrt(max(self.reynolds, 1.0))


def facts_of(scene, speed=None, length=None, surface_tension=None) -> Facts:
    """Facts of a scene whose numbers are known.

    Args:
        scene: of fluids, structures or both.
        speed: characteristic, U [m/s]; None takes the fastest that start, walls and gravity make likely.
        length: characteristic, L [m]; None takes the height of the fluid, or the smallest extent that is not periodic.
        surface_tension: sigma [N/m], for the Weber and Bond numbers.
    """
    across = {s.name: arrangement.across(s) for s in scene.structures}
    steps = {s.name: s.particles.spacing / float(np.max(_p_wave(s))) for s in scene.structures}
    if not scene.fluids:
        size = max(float(np.max(arrangement.extent(s.particles.positions, 0.0))) for s in scene.systems)
        return Facts(
            scene, speed, "given", size if length is None else length, "largest extent", across=across, steps=steps
        )
    gravity, up, driving = _gravity(scene)
    nu = max(0.0 if f.viscosity is None else float(f.viscosity / f.density) for f in scene.fluids)
    found, said = (float(length), "given") if length is not None else _length(scene, up)
    drops = arrangement.fall_and_depth(scene, up) if gravity else (0.0, 0.0)
    fastest, of = (float(speed), "given") if speed is not None else _speed(scene, gravity, drops, driving, nu, found)
    steps |= {f.name: float(fluid_time_step(scene, f)) for f in scene.fluids}
    effect, h = scene.effect(ArtificialViscosity), float(scene.smoothing_length)
    numerical = 0.0
    if effect is not None:
        fastest_sound = max(float(fluid.sound_speed) for fluid in scene.fluids)
        # alpha h c / 8 in 2D, / 10 in 3D (Monaghan 2005, section 8.1), and half of it: only approaching pairs count
        numerical = 0.5 * float(effect.alpha) * h * fastest_sound / (2 * (scene.dimension + 2))
    pressures = [0.0 if f.pressure is None else float(np.min(f.pressure)) for f in scene.fluids]
    walls = [(wall, arrangement.layers(scene, wall)) for wall in scene.walls]
    return Facts(
        scene,
        fastest,
        of,
        found,
        said,
        gravity=gravity,
        fall=float(drops[0]),
        viscosity=nu,
        numerical_viscosity=numerical,
        open_share=arrangement.open_share(scene),
        lowest_pressure=min(pressures),
        neighbors=arrangement.neighbors(scene),
        layers={w.name: (n, arrangement.layers_needed(scene, w)) for w, n in walls if n is not None},
        across=across,
        steps=steps,
        surface_tension=surface_tension,
    )


def _p_wave(structure):
    return np.asarray(p_wave_speed(structure.youngs_modulus, structure.poisson_ratio, structure.density))


def _gravity(scene):
    """|g| across the periodic directions, the direction against it, and |g| along the periodic ones."""
    g = np.asarray(scene.gravity, float)
    periodic = np.zeros(len(g), bool) if scene.domain is None else np.broadcast_to(scene.domain.periodic, len(g))
    across, along = np.where(periodic, 0.0, g), np.where(periodic, g, 0.0)
    size = float(np.linalg.norm(across))
    return size, -across / size if size else None, float(np.linalg.norm(along))


def _length(scene, up):
    fluid = np.concatenate([np.asarray(f.particles.positions, float) for f in scene.fluids])
    if up is not None:
        return float(np.ptp(fluid @ up)) + scene.spacing, "height of the fluid"
    size = arrangement.extent(fluid, scene.spacing)
    periodic = np.zeros(len(size), bool) if scene.domain is None else np.broadcast_to(scene.domain.periodic, len(size))
    if periodic.all():
        return float(np.min(size)), "smallest period"
    return float(np.min(size[~periodic])), "smallest extent of the fluid"


def _speed(scene, gravity, drops, driving, nu, length):
    """The largest of the speeds that the scene announces, and what it is the speed of."""
    found: list[tuple[float, str]] = []
    for system in scene.systems:
        if getattr(system, "velocity", None) is not None:
            size = float(np.max(np.linalg.norm(np.atleast_2d(np.asarray(system.velocity, float)), axis=1)))
            found.append((size, f"{system.name} at the start"))
    if gravity:
        fall, depth = drops
        found.append((math.sqrt(2 * gravity * fall), f"a fall of {fall:.3g} m"))
        found.append((math.sqrt(gravity * depth), f"long waves on a depth of {depth:.3g} m"))
    if driving and nu:
        found.append((driving * length**2 / (8 * nu), "the channel flow that gravity drives"))
    for effect in scene.effects:
        if isinstance(effect, BodyForce):
            found += [_of_force(effect, fluid, length) for fluid in scene.fluids]
    time = 10 * length / max([value for value, _ in found if value] or [length])
    found += [(_of_motion(scene, wall, time), f"{wall.name}") for wall in scene.walls if wall.motion is not None]
    speed, of = max(found)
    return (speed, of) if speed else (None, "nothing moves")


def _of_force(effect, fluid, length):
    positions = jnp.asarray(fluid.particles.positions).T
    force = np.asarray(effect.acceleration(positions, jnp.zeros((), positions.dtype)))
    return math.sqrt(length * float(np.max(np.linalg.norm(force, axis=0)))), "what a body force drives over the length"


def _of_motion(scene, wall, end):
    """Largest speed of a wall until a time; of one on which fluid slips only that across its surface."""
    met = arrangement.contact(scene, wall)
    places = arrangement.some(wall.particles.positions, 8) if met is None else met[0]
    times = jnp.linspace(0, end, MOMENTS, dtype=wall.dtype)
    velocity = jax.jit(jax.vmap(lambda t: wall.placed(jnp.asarray(places, wall.dtype).T, t)[1]))(times)
    velocity = np.moveaxis(np.asarray(velocity), 1, -1)
    sticking = wall.no_slip and any(fluid.viscosity is not None for fluid in scene.fluids)
    if met is None or sticking:
        return float(np.max(np.linalg.norm(velocity, axis=-1)))
    return float(np.max(np.abs(np.sum(velocity * met[1], axis=-1))))
