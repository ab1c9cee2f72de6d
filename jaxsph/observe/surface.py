"""Where a fluid ends: the front that it sends forward, and its free surface."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp

from jaxsph.observe.fields import coverage, volumes
from jaxsph.pytree import is_concrete

CANDIDATES = 128
"""Foremost particles that may be the front, or spray."""


def surge_front(scene, state, name: str, axis: int = 0, *, backward: bool = False, spray=0.2, blur=None):
    """Furthest coordinate [m] that the bulk of a fluid reaches along an axis: its foremost particle and half a spacing.

    Spray does not count: particles around which the sum of V W over the others is less than a share `spray` of what
    it is in the bulk. One particle alone has 0, one at the end of a row of particles .14 to .2, in a corner .4 to .45,
    by smoothing length. Only the 128 foremost are looked at; if all of them are spray, the one that is least so counts.

    Args:
        scene, state: one state.
        name: of the fluid.
        axis: coordinate.
        backward: the smallest coordinate instead of the largest.
        spray: the share, 0 to count every particle.
        blur: None is the exact maximum, whose derivative is that of one particle. A length [m] takes the mean of the
            coordinates weighted by exp(x / blur) instead: smooth, behind the exact one by the order of `blur`.

    Raises:
        KeyError: no system of this name.
        ValueError: it is not a fluid; no such axis; a share that is not below one; a blur that is not positive.
    """
    _check_axis("axis", axis, scene.dimension)
    if is_concrete(spray) and not 0 <= spray < 1:
        raise ValueError(f"spray = {spray} must be a share of what is in the bulk, at least 0 and below 1")
    if blur is not None and is_concrete(blur) and not blur > 0:
        raise ValueError(f"blur = {blur} must be a positive length [m]; None takes the exact maximum")
    volume = volumes(scene, state, name)
    position = state.systems[name]["position"]
    ahead = -position[:, axis] if backward else position[:, axis]
    _, first = jax.lax.top_k(jax.lax.stop_gradient(ahead), min(CANDIDATES, len(ahead)))
    foremost, x = position[first], ahead[first]
    alone = volume[first] * scene.kernel.w(jnp.zeros((scene.dimension, 1), x.dtype), scene.smoothing_length)
    share = (coverage(scene, state, name, foremost) - alone) / (1 - alone)
    share = jax.lax.stop_gradient(share)
    bulk = (share >= spray) | (share >= jnp.max(jnp.where(share >= spray, jnp.inf, share)))
    if blur is None:
        front = jnp.max(jnp.where(bulk, x, -jnp.inf))
    else:
        # the mean is of the distances behind the first, which keeps digits in float32
        lead = jax.lax.stop_gradient(jnp.max(jnp.where(bulk, x, -jnp.inf)))
        behind = jnp.where(bulk, x - lead, 0.0)
        weight = jnp.where(bulk, jnp.exp(behind / blur), 0.0)
        front = lead + jnp.sum(weight * behind) / jnp.sum(weight)
    front = front + 0.5 * scene[name].particles.spacing
    return -front if backward else front


def free_surface_height(scene, state, name: str, at, *, up: int = -1, bottom=0.0, sides=None):
    """Height of the free surface (P,) [m] over places in the ground: the volume of the column of fluid over them.

    height = bottom + sum_b V_b W(x - x_b), with the kernel of the horizontal coordinates, in one dimension less. The
    sum is the depth of the fluid averaged over the kernel. It counts fluid wherever it is in the column: spray adds
    what it holds, air below an overturning wave is left out. Continuous in time, differentiable, without a threshold.

    Args:
        scene, state: one state.
        name: of the fluid.
        at: horizontal coordinates [m], (P,) in 2D, (P, 2) in 3D.
        up: the vertical axis.
        bottom: height of the ground [m].
        sides: of a basin, (low, high) of each horizontal axis [m], in 2D one pair: fluid is mirrored there, else
            a place less than a support radius from a side reads too low, half at the side itself. None has no sides.

    Raises:
        KeyError: no system of this name.
        ValueError: it is not a fluid; no such axis; places or sides of another shape.
    """
    d = scene.dimension
    _check_axis("up", up, d)
    horizontal = [axis for axis in range(d) if axis != up % d]
    at = jnp.asarray(at, scene.dtype)
    at = at[:, None] if d == 2 and at.ndim == 1 else at
    if at.ndim != 2 or at.shape[1] != d - 1:
        raise ValueError(
            f"at has shape {at.shape}; it must be {'(P,)' if d == 2 else '(P, 2)'}, horizontal coordinates"
        )
    if sides is not None and len(sides) == 2 and d == 2 and not hasattr(sides[0], "__len__"):
        sides = [sides]
    if sides is not None and (len(sides) != d - 1 or any(len(side) != 2 for side in sides)):
        raise ValueError(f"sides = {sides} must be (low, high) of each of the {d - 1} horizontal axes")
    volume, position = volumes(scene, state, name), state.systems[name]["position"]

    def depth(place):
        offsets = [
            _images(scene, axis, place[k], position[:, axis], None if sides is None else sides[k])
            for k, axis in enumerate(horizontal)
        ]
        return sum(
            jnp.sum(volume * scene.kernel.w(jnp.stack(offset), scene.smoothing_length))
            for offset in itertools.product(*offsets)
        )

    return bottom + jax.vmap(depth)(at)


def _check_axis(name: str, axis: int, dimension: int) -> None:
    if not -dimension <= axis < dimension:
        raise ValueError(f"{name} = {axis} is not an axis of a scene in {dimension}D, which has 0 to {dimension - 1}")


def _images(scene, axis, place, x, sides):
    """Offsets of a place from the particles and from their mirror images, along one axis."""
    apart = (lambda a, b: a - b) if scene.domain is None else lambda a, b: scene.domain.component(axis, a, b)
    if sides is None:
        return [apart(place, x)]
    low, high = sides
    return [place - x, place - (2 * low - x), place - (2 * high - x)]
