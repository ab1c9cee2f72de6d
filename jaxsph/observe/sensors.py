"""Pressure sensors in walls."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxsph.observe.fields import LEAST_COVERAGE, over_points, pressure, volumes
from jaxsph.pytree import is_concrete
from jaxsph.walls import Wall

WET = 0.9
"""Share of what is before a sensor from which on it is wet."""

LEAST_SIDE = 1e-3
"""Mean distance of the wall behind a sensor, in support radii, below which it is on all sides; .3 at a plane face."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


def wall_pressure(
    scene,
    state,
    wall_name: str,
    points,
    *,
    width=None,
    normal=None,
    hydrostatic: bool = True,
):
    """Pressure (P,) [Pa] of the fluids on sensors in the surface of a wall.

    The mean over what is before the wall within the support radius, weighted by V_b W_b. Where that is water in part,
    the rest is air, which has no pressure: the reading of a sensor that gets wet rises with the water that comes near,
    not with the first particle of it. Walls and solids take no part; from nine tenths on a sensor is taken as wet,
    since particles in disorder cover no more. A sensor of some width weights by the distance from its face, not from
    its center.

    Args:
        scene, state: one state.
        wall_name: of the wall; sensors move with it.
        points: centers of the sensors at t = 0 (P, d) [m].
        width: of a sensor [m], in 3D its diameter; None is a point.
        normal: of the surface, into the fluid, (d,) or (P, d), any length. None takes the direction away from the
            wall's particles, which in a corner is its bisector.
        hydrostatic: continue each particle's pressure to the sensor, p_b + rho_b (g - a_wall) . (x - x_b), as
            `AdamiExtrapolation` does, with body forces in g. Without, still water above a sensor reads too low by the
            pressure of about a fifth of a support radius.

    Returns: 0 where no fluid is near. Continuous; its derivative jumps as a sensor becomes wet.

    Raises:
        KeyError: no system of this name.
        ValueError: it is not a wall; a point further from it than two spacings, or in the middle of it without a
            normal; a width that is not positive; a normal that points into the wall.
    """
    wall = scene[wall_name]
    if not isinstance(wall, Wall):
        raise ValueError(f"{wall_name!r} is a {type(wall).__name__}; sensors are in a Wall")
    points = jnp.asarray(points, scene.dtype)
    if points.ndim != 2 or points.shape[1] != scene.dimension:
        raise ValueError(f"points has shape {points.shape}; it must be (P, {scene.dimension})")
    if width is not None and is_concrete(width) and not width > 0:
        raise ValueError(f"width = {width} of a sensor must be positive [m]; leave it out for a point")
    if not scene.fluids:
        raise ValueError("the scene has no fluid whose pressure a sensor could feel")
    start = jnp.asarray(wall.particles.positions).T
    _check_near(scene, wall, start, points)
    place, _, acceleration = wall.placed(points.T, state.time)
    here = wall.placed(start, state.time)[0]
    away = over_points(lambda p: _away(scene, here, p), place.T, wall.n_particles)
    normal = away if normal is None else jnp.broadcast_to(jnp.asarray(normal, scene.dtype), points.shape)
    if is_concrete(normal) and not np.all(np.linalg.norm(np.asarray(normal), axis=1) > 0):
        raise ValueError("a normal of a sensor is zero; it has to point out of the wall, into the fluid")
    _check_sides(points, normal, away)
    normal = normal / jnp.linalg.norm(normal, axis=1, keepdims=True)
    for effect in scene.flow_effects:
        if effect.acceleration is not None:
            acceleration = acceleration - effect.acceleration(place, state.time)
    radius = 0.0 if width is None else 0.5 * width
    before = _half(scene, radius)
    parts = [_particles(scene, state, fluid) for fluid in scene.fluids]
    solid = [(_places(state, other), other.particles.cells) for other in scene.boundaries]

    def weights(sensor, position, volume):
        offset = scene.displacement(sensor[0][:, None], position)
        seen = offset if width is None else _from_face(offset, sensor[2], radius)
        return offset, volume * scene.kernel.w(seen, scene.smoothing_length)

    def at_sensor(sensor):
        weight = total = taken = 0.0
        for position, volume, density, pressures in parts:
            offset, near = weights(sensor, position, volume)
            if hydrostatic:
                pull = (jnp.asarray(scene.gravity) - sensor[1])[:, None]
                pressures = pressures + density * jnp.sum(pull * offset, axis=0)
            weight, total = weight + jnp.sum(near), total + jnp.sum(near * pressures)
        for position, volume in solid:
            offset, near = weights(sensor, position, volume)
            taken += jnp.sum(jnp.where(jnp.sum(offset * sensor[2][:, None], axis=0) < 0, near, 0.0))
        wet = WET * jnp.maximum(before - taken, 0.0)
        return total / jnp.maximum(jnp.maximum(weight, wet), LEAST_COVERAGE)

    sensors = [place.T, acceleration.T, normal]
    stacked = jnp.stack(sensors, axis=1)
    return over_points(at_sensor, stacked, sum(s.n_particles for s in (*scene.fluids, *scene.boundaries)))


def _places(state, boundary):
    """Positions (d, N) [m] of a wall's or solid's particles."""
    start, fields = jnp.asarray(boundary.particles.positions), state.systems.get(boundary.name, {})
    if isinstance(boundary, Wall):
        return boundary.placed(start.T, state.time)[0]
    return (start + fields["displacement"] if "displacement" in fields else fields["position"]).T


def _half(scene, radius):
    """Integral of the kernel, by the distance from a face of this radius, over the half-space before it."""
    reach = scene.kernel.support_radius(scene.smoothing_length)
    at = 0.5 * reach * (_NODES + 1)
    weight = 0.5 * reach * _WEIGHTS
    along = jnp.zeros((scene.dimension, len(at)), scene.dtype).at[0].set(jnp.asarray(at, scene.dtype))
    value = weight * scene.kernel.w(along, scene.smoothing_length)
    if scene.dimension == 2:
        return 0.5 + 2 * radius * jnp.sum(value)
    return 0.5 + np.pi * radius * (np.pi * jnp.sum(value * at) + radius * jnp.sum(value))


def _particles(scene, state, fluid):
    volume = volumes(scene, state, fluid.name)
    fields = state.systems[fluid.name]
    density = fluid.density + fields["density_deviation"]
    return fields["position"].T, volume, density, pressure(scene, state, fluid.name)


def _from_face(offset, normal, radius):
    """Offsets (d, N) from the nearest point of a face of this radius instead of its center.

    No root is taken of a length that may be zero, whose derivative would not be finite.
    """
    across = jnp.sum(normal[:, None] * offset, axis=0) * normal[:, None]
    along = offset - across
    squared = jnp.sum(along * along, axis=0)
    outside = squared > radius**2
    ratio = radius / jnp.sqrt(jnp.where(outside, squared, 1.0))
    return across + jnp.where(outside, along * (1 - ratio), 0.0)


def _away(scene, position, point):
    """The mean direction (d,) from the wall's particles to a point of its surface, in support radii; short inside."""
    offset = scene.displacement(point[:, None], position)
    weight = scene.kernel.w(offset, scene.smoothing_length)
    total = jnp.sum(weight)
    reach = scene.kernel.support_radius(scene.smoothing_length)
    return jnp.sum(weight * offset, axis=1) / (reach * jnp.where(total > 0, total, 1.0))


def _check_sides(points, normal, away):
    if not is_concrete(normal, away):
        return
    for index, point in enumerate(points):
        side = float(jnp.sum(normal[index] * away[index])) / (float(jnp.linalg.norm(normal[index])) or 1.0)
        if not side > -LEAST_SIDE:
            raise ValueError(
                f"normal = {normal[index]} of points[{index}] = {point} points into the wall, not out of it"
            )
        if normal is away and side < LEAST_SIDE:
            raise ValueError(
                f"points[{index}] = {point} has the wall on all sides, so that it faces none of them; pass normal="
            )


def _check_near(scene, wall, start, points):
    if not is_concrete(start, points):
        return
    for index, point in enumerate(points):
        distance = float(jnp.sqrt(jnp.min(jnp.sum(scene.displacement(point[:, None], start) ** 2, axis=0))))
        if distance > 2 * wall.particles.spacing:
            raise ValueError(
                f"points[{index}] = {point} is {distance:.4g} m from the nearest particle of {wall.name!r}, more than "
                f"two spacings of {wall.particles.spacing:.4g} m; sensors lie in its surface"
            )
