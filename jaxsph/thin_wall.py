"""What a wall thinner than the support radius lacks, and the kernel gradient that makes up for it.

A fluid is held off a wall because both sides of its kernel are filled. A plate thinner than the support radius H fills
a part: the fluid is pushed towards the plate with the pressure itself, sinks in, and comes out on the other side. Here
the pairs of the fluid with a plate of thickness t get another kernel w~, such that the plate has the effect of a wall
without end. Be w1(z) the integral of W over a plane at distance z. A half-space pushes with w1(z), a plate with
w1(z) - w1(z + t). It pushes as the half-space does if its kernel has the plane integral

    w~1(z) = sum_k w1(z + k t),     k = 0, 1, 2, ...

as the terms cancel one by one. w~ follows from w~1 by Abel's inversion in 2D, by a derivative in 3D. It is W from
H - t on, and grows like log r (1/r in 3D) where a fluid particle is about to touch. It acts along the line between two
particles, so momentum is exchanged to round-off, and both sides of the plate may be wet.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.kernels import Kernel
from jaxsph.pytree import pytree_dataclass, static

SMOOTHNESS, DEGREE, SOFTENING = 4, 7, 0.1
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(60)


@pytree_dataclass
class ThinWall:
    """The slope to add to that of the kernel, (1 - q/reach)^4 times a polynomial in q, over q^d, with q = r/h.

    Attributes:
        coefficients: of the polynomial, highest first.
        reach: beyond which there is nothing to add, in smoothing lengths.
        dimension: 2 or 3.
    """

    coefficients: Any
    reach: float = static()
    dimension: int = static()

    def slope(self, squared, smoothing_length):
        """(w~' - W') / r [1/m^(d+2)] at distances whose squares are given [m^2]; finite where particles meet."""
        d, h = self.dimension, smoothing_length
        softened = squared / h**2 + SOFTENING**2
        q = jnp.sqrt(softened)
        inside = jnp.where(q < self.reach, 1 - q / self.reach, 0.0) ** SMOOTHNESS
        value = jnp.zeros_like(q)
        for coefficient in self.coefficients:
            value = value * q + coefficient
        return inside * value / (softened if d == 2 else softened * q) / h ** (d + 2)


def thin_wall(kernel: Kernel, dimension: int, thickness: float, smoothing_length: float) -> ThinWall | None:
    """For a plate of this thickness [m]; None if it is as thick as the support radius.

    Raises ValueError for a thickness below a fiftieth of the support radius.
    """
    reach = float(np.asarray(kernel.support_radius(1.0)))
    t = thickness / smoothing_length
    if t >= reach:
        return None
    if t < reach / 50:
        raise ValueError(
            f"a thickness of {thickness:.4g} m is less than a fiftieth of the support radius, "
            f"{reach * smoothing_length:.4g} m; take a smaller spacing of the fluid"
        )
    span = reach - t
    q = np.linspace(0.05, span, 400)
    with jax.ensure_compile_time_eval():
        extra = _extra_slope(kernel, dimension, q, t, reach)
    basis = (1 - q / span)[:, None] ** SMOOTHNESS * np.vander(q, DEGREE)
    weight = q  # a particle's share of a plane grows with its distance
    coefficients = np.linalg.lstsq(basis * weight[:, None], extra * q**dimension * weight, rcond=None)[0]
    return ThinWall(tuple(float(c) for c in coefficients), span, dimension)


def _extra_slope(kernel, d, q, t, reach):
    """(w~' - W') / q at distances q for h = 1."""
    copies = [k * t for k in range(1, math.ceil(reach / t) + 1)]

    def added(q):
        """w~ - W."""
        if d == 3:
            # w1' = -2 pi z W
            return sum((q + shift) * np.asarray(kernel.radial(q + shift, 3)) for shift in copies) / q
        length = np.sqrt(reach**2 - q**2)
        way = 0.5 * length[:, None] * (_NODES + 1)
        z = np.sqrt(q[:, None] ** 2 + way**2)
        slopes = sum(_slope_of_line(kernel, z + shift, reach) for shift in copies)
        return -np.sum(slopes / z * _WEIGHTS, axis=1) * 0.5 * length / np.pi

    step = 1e-4
    return (added(q + step) - added(q - step)) / (2 * step) / q


def _slope_of_line(kernel, z, reach):
    """Derivative of the integral of the kernel in 2D over a line at distance z, for h = 1."""
    length = np.sqrt(np.maximum(reach**2 - z**2, 0.0))
    way = 0.5 * length[..., None] * (_NODES + 1)
    distance = np.hypot(z[..., None], way)
    along = np.stack([distance, np.zeros_like(distance)])
    slope = np.asarray(kernel.gradient_factor(along, 1.0))
    return np.sum(slope * _WEIGHTS, axis=-1) * length * z  # both halves of the line
