"""Fields of a fluid: of its particles, and at points between them."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxsph import flow
from jaxsph.dynamics import topologies
from jaxsph.fluid import Fluid
from jaxsph.neighbors import search_of
from jaxsph.pair_sum import pair_sum
from jaxsph.tensors import determinant, identity_like, inverse

CHUNK = 2**20
"""Pairs of a point and a particle that are summed at a time."""

LEAST_COVERAGE = 1e-4
"""Sum of V W below which a point is taken as far from the fluid."""

LEAST_SPREAD = 1e-3
"""Determinant of the neighbors' spread, relative to an equal spread along all axes, for a first-order correction."""


def density(scene, state, name: str):
    """Density (N,) [kg/m^3] of a fluid's particles."""
    return _fluid(scene, name).density + state.systems[name]["density_deviation"]


def pressure(scene, state, name: str):
    """Pressure (N,) [Pa] of a fluid's particles."""
    return flow.pressure(_fluid(scene, name), state.systems[name])


def volumes(scene, state, name: str):
    """Volumes m / rho (N,) [m^d] of a fluid's particles."""
    return scene[name].mass() / density(scene, state, name)


def interpolate(scene, state, name: str, field: str, points, *, order: int = 0):
    """A field of a fluid at points, by kernel interpolation over its particles.

    Order 0 is Shepard's: sum f_b V_b W_b / sum V_b W_b, a mean of the particles within the support radius, exact for
    constant fields. Order 1 is the moving least squares fit of an affine field with the same weights V_b W_b, exact for
    affine fields also at a surface. It can overshoot; where the particles in reach lie on a line, order 0 stands in.

    Args:
        scene, state: one state.
        name: of the fluid.
        field: "pressure" [Pa], "density" [kg/m^3], or a field of the state, such as "velocity".
        points: (P, d) [m].
        order: 0 or 1.

    Returns: (P,) or (P, d). Where no particle is near (`coverage` below 1e-4) the value is 0, and so are its
    derivatives: tell such points from others by `coverage`.

    Raises:
        KeyError: no system of this name.
        ValueError: it is not a fluid, a field that it does not have, points of another shape, another order.
    """
    if order not in (0, 1):
        raise ValueError(f"order = {order} must be 0 (Shepard) or 1 (moving least squares)")
    values = _field(scene, state, name, field)
    flat = values.reshape(len(values), -1).T
    volume, h = volumes(scene, state, name), scene.smoothing_length

    def at_point(point):
        offset, weight = _weights(scene, state, name, volume, point)
        total = jnp.sum(weight)
        near = total > LEAST_COVERAGE
        share = weight / jnp.where(near, total, 1.0)
        mean = jnp.sum(share * flat, axis=1)
        if order == 1:
            mean = mean - _correction(share, offset / h, flat, mean)
        return jnp.where(near, mean, 0.0)

    found = over_points(at_point, _points(scene, points), len(values))
    return found.reshape(found.shape[:1] + values.shape[1:])


def coverage(scene, state, name: str, points):
    """sum V_b W_b (P,) at points (P, d): 1 inside of a fluid, about 1/2 at its surface, 0 beyond its kernels' reach."""
    volume = volumes(scene, state, name)
    of_point = lambda point: jnp.sum(_weights(scene, state, name, volume, point)[1])  # noqa: E731
    return over_points(of_point, _points(scene, points), len(volume))


def vorticity(scene, state, name: str, found=None):
    """Vorticity of a fluid's particles [1/s], (N,) in 2D, (N, 3) in 3D: curl v by corrected kernel gradients.

    The sum runs over neighbors within the fluid.

    Args:
        scene, state: one state.
        name: of the fluid.
        found: from `topologies(scene, state)`, if it is at hand; needed inside of a transformation. If its lists are
            too small for this state, the result is NaN.
    """
    _fluid(scene, name)
    found = topologies(scene, state) if found is None else found
    order, template = found[name], found[f"{name}-{name}"]
    position, velocity = (state.systems[name][field][order.order].T for field in ("position", "velocity"))
    neighbors = search_of(template).update(jax.lax.stop_gradient(position), template)
    fields = {"position": position, "velocity": velocity, "volume": volumes(scene, state, name)[order.order]}

    def of_pair(a, b):
        offset = scene.displacement(a["position"], b["position"])
        gradient = b["volume"] * scene.kernel.gradient(offset, scene.smoothing_length)
        moment = -gradient[:, None] * offset[None, :]
        return {"moment": moment, "slopes": (b["velocity"] - a["velocity"])[:, None] * gradient[None, :]}

    sums = pair_sum(of_pair, fields, fields, neighbors)
    slope = jnp.stack([flow.corrected(sums["moment"], row) for row in sums["slopes"]])
    if scene.dimension == 2:
        curl = slope[1, 0] - slope[0, 1]
    else:
        curl = jnp.stack([slope[2, 1] - slope[1, 2], slope[0, 2] - slope[2, 0], slope[1, 0] - slope[0, 1]])
    curl = jnp.where(neighbors.did_buffer_overflow, jnp.nan, curl)
    return jnp.moveaxis(curl, -1, 0)[order.rank]


def over_points(of_point, points, n_particles: int):
    """of_point for each of the points (P, d), some at a time so that no more than `CHUNK` pairs are in memory."""
    at_once = max(1, CHUNK // n_particles)
    if len(points) <= at_once:
        return jax.vmap(of_point)(points)
    return jax.lax.map(jax.checkpoint(of_point), points, batch_size=at_once)


def _weights(scene, state, name, volume, point):
    """Offsets to a point (d,) from all particles of a fluid (d, N), and V W (N,)."""
    offset = scene.displacement(point[:, None], state.systems[name]["position"].T)
    return offset, volume * scene.kernel.w(offset, scene.smoothing_length)


def _correction(share, offset, values, mean):
    """What order 1 takes off the mean (C,) of values (C, N) whose particles are at -offset (d, N) from the point."""
    center = jnp.sum(share * offset, axis=1)
    centered = offset - center[:, None]
    spread = jnp.sum(share * centered[:, None] * centered[None, :], axis=2)
    d = len(center)
    size = sum(spread[i, i] for i in range(d)) / d
    enough = (size > LEAST_SPREAD) & (determinant(spread) > LEAST_SPREAD * size**d)
    inverted = inverse(jnp.where(enough, spread, identity_like(spread)))
    slopes = jnp.sum(share * (values - mean[:, None])[:, None] * centered[None, :], axis=2)
    direction = jnp.sum(inverted * center[None, :], axis=1)
    return jnp.where(enough, jnp.sum(slopes * direction[None, :], axis=1), 0.0)


def _fluid(scene, name) -> Fluid:
    system = scene[name]
    if not isinstance(system, Fluid):
        raise ValueError(f"{name!r} is a {type(system).__name__}; this is observed of a Fluid")
    return system


def _field(scene, state, name, field):
    _fluid(scene, name)
    if field in ("pressure", "density"):
        return {"pressure": pressure, "density": density}[field](scene, state, name)
    known = state.systems[name]
    if field not in known:
        raise ValueError(f"{name!r} has no field {field!r}; there are {sorted([*known, 'density', 'pressure'])}")
    return known[field]


def _points(scene, points):
    points = jnp.asarray(points, scene.dtype)
    if points.ndim != 2 or points.shape[1] != scene.dimension:
        raise ValueError(f"points has shape {points.shape}; it must be (P, {scene.dimension})")
    return points
