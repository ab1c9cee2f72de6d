"""Rigid bodies: particles that move as one.

What acts on the particles is summed to a force and a moment about the center of mass. Velocities are those of
v = V + W x (x - x_c) with the linear and the angular momentum of the particles, so both are exchanged to round-off; and
positions are turned by exact rotations, so the shape stays.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import checks
from jaxsph.geometry.shapes import Particles
from jaxsph.pair_sum import dot
from jaxsph.pytree import as_real, is_concrete, pytree_dataclass, static
from jaxsph.system import System
from jaxsph.tensors import inverse
from jaxsph.walls import AdamiExtrapolation, WallPressure, check_model


@pytree_dataclass
class RigidBody(System):
    """A body that moves but does not deform, free to turn. One that follows a prescribed motion is a `Wall`.

    Fluids meet it as they meet a `Structure`, other solids and walls through `Contact`.

    Attributes:
        name: how the scene and its results call it.
        particles: positions (N, d) [m] at the start and volumes (N,) [m^d].
        density: [kg/m^3], one number or (N,); with the volumes it gives mass, center of mass and inertia.
        velocity: of the center of mass at the start (d,) [m/s]; None is zero.
        angular_velocity: at the start [rad/s], one number in 2D (counterclockwise), (3,) in 3D; None is zero.
        pressure: model of the pressure with which a fluid meets it, as of a `Wall`.
        no_slip: whether viscous fluids stick to it.
        thickness: of a plate that may be thinner than the support radius of the fluids [m], as of a `Structure`.

    Raises:
        ValueError: a value out of its range, with the limit; a shape that does not fit; particles on one line in 3D.
    """

    name: str = static()
    particles: Particles
    density: Any
    velocity: Any = None
    angular_velocity: Any = None
    pressure: WallPressure = AdamiExtrapolation()
    no_slip: bool = static(default=True)
    thickness: float | None = static(default=None)

    def __post_init__(self):
        d, real = self.dimension, self.dtype
        checks.check_name(self.name, "density")
        check_model(self)
        spin = np.zeros(() if d == 2 else 3)
        object.__setattr__(self, "density", as_real(self.density, real))
        object.__setattr__(self, "velocity", as_real(np.zeros(d) if self.velocity is None else self.velocity, real))
        given = spin if self.angular_velocity is None else self.angular_velocity
        object.__setattr__(self, "angular_velocity", as_real(given, real))
        self.check()
        if is_concrete(self.particles.positions):
            centered = np.asarray(self.particles.positions, np.float64)
            centered = centered - centered.mean(axis=0)
            extent = np.linalg.svd(centered, compute_uv=False)
            if not extent[d - 2] > 1e-6 * self.particles.spacing:
                raise ValueError(f"the particles of {self.name!r} are at one place or on a line: nothing turns there")

    def check(self, prefix: str = "") -> None:
        """Raise ValueError if a number is out of its range or has a shape that does not fit. Traced ones pass."""
        checks.check_positive(f"{prefix}density", self.density, "kg/m^3")
        if np.shape(self.density) not in ((), (self.n_particles,)):
            raise ValueError(
                f"{prefix}density has shape {np.shape(self.density)}; it must be one number or ({self.n_particles},)"
            )
        if self.thickness is not None:
            checks.check_positive(f"{prefix}thickness", self.thickness, "m")
        checks.check_finite(f"{prefix}velocity", self.velocity, (self.dimension,))
        checks.check_finite(f"{prefix}angular_velocity", self.angular_velocity, () if self.dimension == 2 else (3,))

    def initial_velocity(self):
        """Velocities (N, d) [m/s] of the particles at the start."""
        positions = jnp.asarray(self.particles.positions).T
        mass = jnp.broadcast_to(self.density * self.particles.volumes, positions.shape[1:])
        offset = positions - center(mass, positions)[:, None]
        return (jnp.asarray(self.velocity)[:, None] + cross(jnp.asarray(self.angular_velocity), offset)).T


@pytree_dataclass
class RigidReference:
    """A rigid body made ready: positions (d, N) [m] at the start, volumes, those of whole cells and masses (N,).

    In cell order.
    """

    positions: Any
    volume: Any
    cells: Any
    mass: Any
    thin: Any = None

    @property
    def moving(self):
        """All particles follow from forces."""
        return jnp.ones((), self.positions.dtype)


def center(mass, field):
    """Mean (d,) of a field (d, N), weighted with masses (N,)."""
    return jnp.sum(mass * field, axis=1) / jnp.sum(mass)


def cross(spin, offset):
    """W x r (d, N) of an angular velocity, one number in 2D or (3,), and offsets (d, N)."""
    if offset.shape[0] == 2:
        return spin * jnp.stack([-offset[1], offset[0]])
    return jnp.cross(spin[:, None], offset, axis=0)


def moment(mass, offset, field):
    """sum m r x f of a field (d, N): one number in 2D, (3,) in 3D."""
    if offset.shape[0] == 2:
        return jnp.sum(mass * (offset[0] * field[1] - offset[1] * field[0]))
    return jnp.sum(mass * jnp.cross(offset, field, axis=0), axis=1)


def turning(mass, offset, of_moment):
    """The angular velocity that belongs to an angular momentum (or acceleration, to a moment): I^-1 L."""
    if offset.shape[0] == 2:
        return of_moment / jnp.sum(mass * dot(offset, offset))
    unit = jnp.eye(3, dtype=offset.dtype)
    inertia = jnp.sum(mass * dot(offset, offset)) * unit - (mass * offset) @ offset.T
    size = jnp.trace(inertia)  # in float32 the determinant of the inertia of a small body is zero
    return inverse(inertia / size) @ (of_moment / size)


def as_rigid(mass, offset, velocity):
    """V and W with the linear and the angular momentum of velocities (d, N) at offsets from the center of mass."""
    mean = center(mass, velocity)
    return mean, turning(mass, offset, moment(mass, offset, velocity - mean[:, None]))


def rigid_acceleration(ready: RigidReference, fields: dict, acceleration):
    """Accelerations (d, N) [m/s^2] of the particles of a body, by forces per mass (d, N) that act on them.

    A + dW/dt x r + W x (W x r), whose sum and moment are those of the forces.
    """
    mass, offset = ready.mass, _offset(ready, fields)
    _, spin = as_rigid(mass, offset, fields["velocity"])
    pulled = cross(spin, cross(spin, offset))
    linear = center(mass, acceleration)
    turned = turning(mass, offset, moment(mass, offset, acceleration - linear[:, None] - pulled))
    return linear[:, None] + cross(turned, offset) + pulled


def rigid_kick(ready: RigidReference, fields: dict, time_step):
    """Velocities (d, N) [m/s] after an impulse of `acceleration` over a time [s]."""
    offset = _offset(ready, fields)
    velocity = fields["velocity"] + time_step * fields["acceleration"]
    mean, spin = as_rigid(ready.mass, offset, velocity)
    return mean[:, None] + cross(spin, offset)


def rigid_drift(ready: RigidReference, fields: dict, time_step):
    """Increment of the displacement (d, N) [m] in a time [s] without forces, and velocities at its end.

    The angular momentum stays. In 3D the axis does not: the turn is that of the angular velocity in the middle.
    """
    mass, offset, velocity = ready.mass, _offset(ready, fields), fields["velocity"]
    mean = center(mass, velocity)
    kept = moment(mass, offset, velocity - mean[:, None])
    spin = turning(mass, offset, kept)
    if offset.shape[0] == 3:
        spin = turning(mass, offset + turn(0.5 * time_step * spin, offset), kept)
    turned = turn(time_step * spin, offset)
    after = offset + turned
    return time_step * mean[:, None] + turned, mean[:, None] + cross(turning(mass, after, kept), after)


def turn(angle, offset):
    """(R - I) r (d, N) of the rotation by an angle [rad], in 3D about its own direction: Rodrigues' formula."""
    squared = angle**2 if jnp.ndim(angle) == 0 else jnp.sum(angle**2)
    sine, cosine = _sinc(squared), _sinc(0.25 * squared)  # sin a / a, and (1 - cos a) / a^2 = sinc(a / 2)^2 / 2
    first = cross(angle, offset)
    return sine * first + 0.5 * cosine**2 * cross(angle, first)


def _sinc(squared):
    """sin a / a of a^2, with its derivative at zero."""
    small = squared < 1e-4
    a = jnp.sqrt(jnp.where(small, 1.0, squared))
    return jnp.where(small, 1 - squared / 6 * (1 - squared / 20), jnp.sin(a) / a)


def _offset(ready, fields):
    positions = ready.positions + fields["displacement"]
    offset = positions - center(ready.mass, positions)[:, None]
    # Again: the first mean is rounded like the positions, far from the origin coarser than the body asks for.
    return offset - center(ready.mass, offset)[:, None]


def rigid_reference(body: RigidBody, order, thin) -> RigidReference:
    """A rigid body in cell order; differentiable in its density."""
    positions, volume = (jnp.asarray(a)[order] for a in (body.particles.positions, body.particles.volumes))
    mass = jnp.asarray(body.density)
    mass = (mass[order] if jnp.ndim(mass) else mass) * volume
    cells = jnp.asarray(body.particles.cells)[order]
    return RigidReference(positions.T, volume, cells, jax.lax.convert_element_type(mass, positions.dtype), thin)
