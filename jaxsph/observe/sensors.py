"""Pressure sensors in walls."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsph.observe.fields import LEAST_COVERAGE, over_points, pressure, volumes
from jaxsph.pytree import is_concrete
from jaxsph.walls import Wall


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

    The mean over the fluid particles within the support radius, weighted by V_b W_b: the kernel sees one side only, and
    is normalized by what it sees. A sensor of some width weights by the distance from its face, not from its center.

    Args:
        scene, state: one state.
        wall_name: of the wall; sensors move with it.
        points: centers of the sensors at t = 0 (P, d) [m].
        width: of a sensor [m], in 3D its diameter; None is a point.
        normal: of the surface, (d,) or (P, d), any length; needed with a width only. None takes the direction away from
            the wall's particles, which in a corner is its bisector.
        hydrostatic: continue each particle's pressure to the sensor, p_b + rho_b (g - a_wall) . (x - x_b), as
            `AdamiExtrapolation` does. Without, still water above a sensor reads too low by the pressure of about
            a third of a support radius.

    Returns: 0 where no fluid is near.

    Raises:
        KeyError: no system of this name.
        ValueError: it is not a wall; a point further from it than two spacings; a width that is not positive.
    """
    wall = scene[wall_name]
    if not isinstance(wall, Wall):
        raise ValueError(f"{wall_name!r} is a {type(wall).__name__}; sensors are in a Wall")
    points = jnp.asarray(points, scene.dtype)
    if points.ndim != 2 or points.shape[1] != scene.dimension:
        raise ValueError(f"points has shape {points.shape}; it must be (P, {scene.dimension})")
    if width is not None and is_concrete(width) and not width > 0:
        raise ValueError(f"width = {width} of a sensor must be positive [m]; leave it out for a point")
    start = jnp.asarray(wall.particles.positions).T
    _check_near(scene, wall, start, points)
    place, _, acceleration = wall.placed(points.T, state.time)
    sensors = [place.T, acceleration.T]
    if width is not None:
        if normal is None:
            here = wall.placed(start, state.time)[0]
            normal = over_points(lambda p: _away(scene, wall, here, p), place.T, wall.n_particles)
        normal = jnp.broadcast_to(jnp.asarray(normal, scene.dtype), points.shape)
        sensors.append(normal / jnp.linalg.norm(normal, axis=1, keepdims=True))
    parts = [_particles(scene, state, fluid) for fluid in scene.fluids]

    def at_sensor(sensor):
        weight = total = 0.0
        for position, volume, density, pressures in parts:
            offset = scene.displacement(sensor[0][:, None], position)
            seen = offset if width is None else _from_face(offset, sensor[2], 0.5 * width)
            weights = volume * scene.kernel.w(seen, scene.smoothing_length)
            if hydrostatic:
                pull = (jnp.asarray(scene.gravity) - sensor[1])[:, None]
                pressures = pressures + density * jnp.sum(pull * offset, axis=0)
            weight, total = weight + jnp.sum(weights), total + jnp.sum(weights * pressures)
        near = weight > LEAST_COVERAGE
        return jnp.where(near, total / jnp.where(near, weight, 1.0), 0.0)

    stacked = jnp.stack(sensors, axis=1)
    return over_points(at_sensor, stacked, sum(fluid.n_particles for fluid in scene.fluids))


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


def _away(scene, wall, position, point):
    """The direction (d,) [m] from the wall's particles to a point of its surface."""
    offset = scene.displacement(point[:, None], position)
    return jnp.sum(scene.kernel.w(offset, scene.smoothing_length) * offset, axis=1)


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
