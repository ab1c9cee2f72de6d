"""Particles moved until they are evenly spread, so that a run starts quietly."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import checks
from jaxsph.geometry.shapes import Particles
from jaxsph.kernels import Kernel, WendlandC2
from jaxsph.neighbors import Domain, neighbor_list, raise_if_wrong
from jaxsph.pair_sum import pair_sum

STRIDE = 0.1
"""Of the spacing: the longest way of a particle in one iteration."""

RATE = 0.15
"""Step of the descent in squares of the smoothing length."""

BETWEEN_BUILDS = 5
"""Iterations between two builds of the neighbor lists, whose skin is wide enough for that."""


class Packed(NamedTuple):
    """Evenly spread particles, and how evenly."""

    particles: Particles
    """With the volumes that they had."""
    residuals: np.ndarray
    """Root mean square of |sum_b V_b grad W| times the spacing over all particles that move, before the first iteration
    and after every `BETWEEN_BUILDS` of them; 0 is an even spread."""


def relax(
    particles: Particles,
    *,
    walls: Particles | None = None,
    domain: Domain | None = None,
    distance: Callable | None = None,
    fixed=None,
    kernel: Kernel | None = None,
    smoothing_length: float | None = None,
    iterations: int = 200,
) -> Packed:
    """Move particles down the gradient of their crowding, sum_b V_b grad W, until they are evenly spread.

    As P.-N. Sun and others shift them during a run (see `ParticleShifting`), here without a flow; packing a start so is
    the idea of A. Colagrossi, B. Bouscasse, M. Antuono, S. Marrone (2012), Comput. Phys. Commun. 183, 1641. Outside of
    jit; not differentiable.

    What keeps particles in their shape, any of: `walls`, whose particles push; a periodic `domain`; the signed
    `distance`, at whose surface every particle meets mirror images, and to which none comes nearer than half a spacing;
    `fixed` particles.
    Without any of them they would spread for ever, which is refused.

    Args:
        particles: to spread; a lattice, or one with `jitter`.
        walls: particles that push and stay.
        domain: with periodic directions.
        distance: signed distance from the surface of the shape [m], negative inside, distance(x (d,)) -> (), written
            with jax.numpy.
        fixed: (N,) true for particles that stay, such as the outer ones, in layers as thick as the support radius.
        kernel: None takes `WendlandC2()`.
        smoothing_length: [m]; None takes 1.5 spacings.
        iterations: rounded up to a multiple of `BETWEEN_BUILDS`.

    Raises:
        ValueError: nothing keeps the particles, arguments of the wrong shape, or particles that start outside.
        ParticleOutside: a particle outside of the domain.
    """
    kernel = WendlandC2() if kernel is None else kernel
    smoothing_length = 1.5 * particles.spacing if smoothing_length is None else float(smoothing_length)
    checks.check_positive("smoothing_length", smoothing_length, "m")
    if iterations < 1:
        raise ValueError(f"iterations = {iterations} must be at least 1")
    fixed = np.zeros(len(particles), bool) if fixed is None else np.asarray(fixed, bool)
    if fixed.shape != (len(particles),):
        raise ValueError(f"fixed has shape {fixed.shape}; it must be ({len(particles)},), one for each particle")
    if walls is None and distance is None and not fixed.any() and (domain is None or not all(domain.periodic)):
        raise ValueError("nothing keeps the particles: give walls, a periodic domain, a distance, or fixed particles")
    if distance is not None:
        furthest = float(jnp.max(jax.vmap(distance)(jnp.asarray(particles.positions))))
        if furthest > 1e-6 * particles.spacing:
            raise ValueError(f"a particle starts {furthest:.4g} m outside of the shape; take those inside alone")
    return _relaxed(particles, walls, domain, distance, fixed, kernel, smoothing_length, iterations)


def _relaxed(particles, walls: Any, domain, distance: Any, fixed, kernel, h, iterations):
    spacing, start = particles.spacing, np.asarray(particles.positions).T
    cutoff = float(kernel.support_radius(np.asarray(h)))
    sets = [start] if walls is None else [start, np.asarray(walls.positions).T.astype(start.dtype)]
    if domain is None:
        domain = Domain.around(np.concatenate(sets, axis=1), 3 * cutoff + float(np.max(np.ptp(start, axis=1))))
    # Both particles of a pair may go a stride in every iteration; mirror images as far as what they mirror.
    search = neighbor_list(domain, cutoff, 2.01 * STRIDE * BETWEEN_BUILDS * spacing, 2.0)
    volume, moving = jnp.asarray(particles.volumes), jnp.asarray(~fixed, start.dtype)
    near_limit = 0.5 * spacing  # on the surface a particle would meet its own image, which does not push there

    def normal(x):
        slope = jax.grad(distance)(x)
        # in the middle of a ball it has none; any direction leads far out of reach
        return jnp.where(jnp.all(jnp.isfinite(slope)), slope, jnp.zeros_like(x).at[0].set(1.0))

    def image(x):
        return x - 2 * distance(x) * normal(x)

    images = lambda x: jax.vmap(image, -1, -1)(x)  # noqa: E731

    def term(a, b):
        return b["volume"] * kernel.gradient(domain.displacement(a["x"], b["x"]), h)

    others: dict[str, Any] = {"own": None}
    if walls is not None:
        others["walls"] = jnp.asarray(sets[1])
    if distance is not None:
        others["images"] = images(jnp.asarray(start))
    lists = {name: search.allocate(jnp.asarray(start), x) for name, x in others.items()}

    def crowding(x, lists):
        own = {"x": x, "volume": volume}
        total = pair_sum(term, own, own, lists["own"])
        if "walls" in others:
            wall = {"x": others["walls"], "volume": jnp.asarray(walls.volumes)}  # pyright: ignore
            total = total + pair_sum(term, own, wall, lists["walls"])
        if "images" in others:
            total = total + pair_sum(term, own, {"x": images(x), "volume": volume}, lists["images"])
        return moving * total

    def iterate(x, lists):
        step = -RATE * h**2 * crowding(x, lists)
        squared, limit = jnp.sum(step**2, axis=0), STRIDE * spacing
        x = x + step * (limit / jnp.sqrt(jnp.where(squared > limit**2, squared, limit**2)))
        if distance is not None:

            def inside(p):
                return p - jnp.maximum(distance(p) + near_limit, 0.0) * normal(p)  # pyright: ignore

            x = jnp.where(moving > 0, jax.vmap(inside, -1, -1)(x), x)
        return x

    @jax.jit
    def some(x, templates):
        senders = {"own": None, "walls": others.get("walls"), "images": images(x) if "images" in others else None}
        lists = {name: search.update(x, template, senders[name]) for name, template in templates.items()}
        before = crowding(x, lists)
        residual = jnp.sqrt(jnp.sum(before**2) / jnp.maximum(jnp.sum(moving), 1.0)) * spacing
        x, _ = jax.lax.scan(lambda x, _: (iterate(x, lists), None), x, length=BETWEEN_BUILDS)
        return domain.wrap(x), residual, lists

    x, residuals = jnp.asarray(start), []
    for _ in range(-(-iterations // BETWEEN_BUILDS) + 1):
        before = x
        x, residual, found = some(before, lists)
        for name, neighbors in found.items():
            raise_if_wrong(neighbors, name=name)
        residuals.append(float(residual))
    return Packed(dataclasses.replace(particles, positions=np.asarray(before.T)), np.array(residuals))
