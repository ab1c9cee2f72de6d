r"""Smoothing kernels W and their gradients, in 1D, 2D and 3D.

With H the support radius (`support` times the smoothing length h), R = r / H and d the dimension,

    W = sigma_d / H^d  w(R),          grad W = sigma_d / H^(d+2)  (w'(R) / R)  r_vec.

Every kernel gives w(R) and the slope w'(R) / R in closed form. The slope is finite at R = 0, so the gradient
of two coincident particles is exactly zero and no derivative of W or of its gradient, forward or reverse,
first or second, with respect to r_vec or h, is NaN or infinite.

w(R) and sigma_d of the splines and the Wendland functions are those of W. Dehnen & H. Aly (2012), Mon. Not.
R. Astron. Soc. 425, 1068, table 1, where H stands for the same radius. The support in units of h is that of
D. J. Price (2012), J. Comput. Phys. 231, 759, section 2.2, and 2 h for the Wendland functions.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxsph.pytree import pytree_dataclass


class Kernel(ABC):
    """A smoothing kernel: what all of them share.

    A subclass states `support`, `normalization` (sigma_d for d = 1, 2, 3), `shape` (w) and `slope` (w' / R).
    """

    support: ClassVar[float]
    """Support radius in units of the smoothing length: W(r >= support * h) = 0."""

    normalization: ClassVar[tuple[float, float, float]]
    """sigma_d in 1D, 2D and 3D: makes the integral of W over all space equal to one."""

    @abstractmethod
    def shape(self, ratio: Array, dim: int) -> Array:
        """w(R) for 0 <= R, without its constant; 0 for R >= 1."""

    @abstractmethod
    def slope(self, ratio: Array, dim: int) -> Array:
        """w'(R) / R for 0 <= R, without its constant; finite at 0, and 0 for R >= 1."""

    def support_radius(self, h: Float[ArrayLike, "..."]) -> Float[ArrayLike, "..."]:
        """Radius beyond which W is zero [m], for a smoothing length h [m]."""
        return self.support * h

    def w(self, r_vec: Float[ArrayLike, "d ..."], h: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
        """W(|r_vec|, h) [1/m^d], for r_vec = r_a - r_b [m], shape (d,), and the smoothing length h [m].

        Its derivative is `gradient`, by rule rather than by differentiating the square root: so second
        derivatives are right also at r_vec = 0.

        Raises:
            ValueError: r_vec does not have 1, 2 or 3 components.
        """
        r_vec, h = _same_dtype(r_vec, h)
        return _w(self, r_vec, h)

    def gradient(self, r_vec: Float[ArrayLike, "d ..."], h: Float[ArrayLike, "..."]) -> Float[Array, "d ..."]:
        """grad_a W(|r_a - r_b|, h) [1/m^(d+1)], shape (d,), for r_vec = r_a - r_b [m] and h [m].

        One square root; a division by r only in the outer pieces of the splines.

        Raises:
            ValueError: r_vec does not have 1, 2 or 3 components.
        """
        r_vec, h = _same_dtype(r_vec, h)
        return _gradient_factor(self, r_vec, h) * r_vec

    def gradient_factor(self, r_vec: Float[ArrayLike, "d ..."], h: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
        """F in grad_a W = F (r_a - r_b) [1/m^(d+2)]: x . grad W / x^2, finite also where particles coincide."""
        r_vec, h = _same_dtype(r_vec, h)
        return _gradient_factor(self, r_vec, h)

    def radial(self, q: Float[ArrayLike, "..."], dim: int) -> Float[Array, "..."]:
        """The dimensionless kernel h^d W as a function of q = r / h >= 0, in `dim` dimensions.

        Raises:
            ValueError: dim is not 1, 2 or 3.
        """
        ratio = jnp.asarray(q) / self.support
        return self._constant(dim) / self.support**dim * self.shape(ratio, dim)

    def _constant(self, dim: int) -> float:
        if dim not in (1, 2, 3):
            raise ValueError(f"a smoothing kernel has 1, 2 or 3 dimensions, not {dim}: r_vec is one vector (d,)")
        return self.normalization[dim - 1]


def _same_dtype(r_vec, h):
    """Positions set the precision, jax's default if they are whole numbers; h follows."""
    r_vec = jnp.asarray(r_vec)
    if not jnp.issubdtype(r_vec.dtype, jnp.inexact):
        r_vec = r_vec.astype(float)
    return r_vec, jnp.asarray(h, r_vec.dtype)


def _ratio(r_vec, inverse_support):
    """R = r / H, with derivatives that are zero instead of infinite where the particles coincide.

    The floor is on R^2, so it knows no unit of length. It is so small that no digit of W changes, and large
    enough that the third derivative of the square root does not overflow.
    """
    floor = 1e-14 if r_vec.dtype.itemsize <= 4 else 1e-60
    squared = jnp.sum(r_vec * r_vec, axis=0) * inverse_support**2
    return jnp.sqrt(jnp.maximum(squared, floor))


def _gradient_factor(kernel, r_vec, h):
    """F in grad W = F r_vec."""
    dim = r_vec.shape[0]
    constant = kernel._constant(dim)
    inverse_support = 1.0 / (kernel.support * h)
    return constant * inverse_support ** (dim + 2) * kernel.slope(_ratio(r_vec, inverse_support), dim)


@jax.custom_jvp
def _w(kernel, r_vec, h):
    dim = r_vec.shape[0]
    constant = kernel._constant(dim)
    inverse_support = 1.0 / (kernel.support * h)
    return constant * inverse_support**dim * kernel.shape(_ratio(r_vec, inverse_support), dim)


@_w.defjvp
def _w_jvp(primals, tangents):
    """dW = F r_vec . dr_vec + dW/dh dh; W is sigma h^-d w(r / h), so dW/dh = -(d W + r^2 F) / h."""
    kernel, r_vec, h = primals
    _, r_vec_dot, h_dot = tangents
    value = _w(kernel, r_vec, h)
    factor = _gradient_factor(kernel, r_vec, h)
    wrt_h = -(r_vec.shape[0] * value + jnp.sum(r_vec * r_vec, axis=0) * factor) / h
    return value, factor * jnp.sum(r_vec * r_vec_dot, axis=0) + wrt_h * h_dot


def _positive(x):
    """(x)_+: what makes every truncated power end smoothly at its own radius."""
    return jnp.maximum(x, 0.0)


def _at_least(ratio, knot):
    """R, and the knot below it; at the knot its derivative is 1, not the 1/2 of a maximum: lattices are there."""
    return jnp.where(ratio < knot, knot, ratio)


@pytree_dataclass
class CubicSpline(Kernel):
    """Cubic B-spline M4 (Schoenberg 1946; Monaghan & Lattanzio 1985), support 2 h, twice differentiable."""

    support = 2.0
    normalization = (8 / 3, 80 / (7 * math.pi), 16 / math.pi)

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^3 - 4 (1/2 - R)_+^3."""
        return _positive(1 - ratio) ** 3 - 4 * _positive(0.5 - ratio) ** 3

    def slope(self, ratio: Array, dim: int) -> Array:
        """-6 + 9 R in the inner piece, where the terms in 1/R cancel; -3 (1 - R)_+^2 / R outside it."""
        outer = -3 * _positive(1 - ratio) ** 2 / _at_least(ratio, 0.5)
        return jnp.where(ratio < 0.5, 9 * ratio - 6, outer)


@pytree_dataclass
class QuarticSpline(Kernel):
    """Quartic B-spline M5 (Schoenberg 1946), support 2.5 h, three times differentiable."""

    support = 2.5
    normalization = (5**5 / 768, 3 * 5**6 / (2398 * math.pi), 5**6 / (512 * math.pi))

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^4 - 5 (3/5 - R)_+^4 + 10 (1/5 - R)_+^4."""
        outer = _positive(1 - ratio) ** 4
        return outer - 5 * _positive(0.6 - ratio) ** 4 + 10 * _positive(0.2 - ratio) ** 4

    def slope(self, ratio: Array, dim: int) -> Array:
        """-24/5 + 24 R^2 in the innermost piece; -4 ((1 - R)_+^3 - 5 (3/5 - R)_+^3) / R outside it."""
        pieces = _positive(1 - ratio) ** 3 - 5 * _positive(0.6 - ratio) ** 3
        return jnp.where(ratio < 0.2, 24 * ratio**2 - 4.8, -4 * pieces / _at_least(ratio, 0.2))


@pytree_dataclass
class QuinticSpline(Kernel):
    """Quintic B-spline M6 (Schoenberg 1946; Morris 1996), support 3 h, four times differentiable."""

    support = 3.0
    normalization = (3**5 / 40, 7 * 3**7 / (478 * math.pi), 3**7 / (40 * math.pi))

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^5 - 6 (2/3 - R)_+^5 + 15 (1/3 - R)_+^5."""
        outer = _positive(1 - ratio) ** 5
        return outer - 6 * _positive(2 / 3 - ratio) ** 5 + 15 * _positive(1 / 3 - ratio) ** 5

    def slope(self, ratio: Array, dim: int) -> Array:
        """-40/9 + 40 R^2 - 50 R^3 in the innermost piece; -5 ((1 - R)_+^4 - 6 (2/3 - R)_+^4) / R outside."""
        pieces = _positive(1 - ratio) ** 4 - 6 * _positive(2 / 3 - ratio) ** 4
        inner = (40 - 50 * ratio) * ratio**2 - 40 / 9
        return jnp.where(ratio < 1 / 3, inner, -5 * pieces / _at_least(ratio, 1 / 3))


@pytree_dataclass
class WendlandC2(Kernel):
    """Wendland's C2 function (H. Wendland 1995, Adv. Comput. Math. 4, 389), support 2 h.

    phi_{3,1} in 2D and 3D. In 1D it is phi_{1,1}, the polynomial of lowest degree that is positive definite
    on the line, not the restriction of the one for 3D.
    """

    support = 2.0
    normalization = (5 / 4, 7 / math.pi, 21 / (2 * math.pi))

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^4 (1 + 4 R); 1D: (1 - R)_+^3 (1 + 3 R)."""
        if dim == 1:
            return _positive(1 - ratio) ** 3 * (1 + 3 * ratio)
        return _positive(1 - ratio) ** 4 * (1 + 4 * ratio)

    def slope(self, ratio: Array, dim: int) -> Array:
        """-20 (1 - R)_+^3; 1D: -12 (1 - R)_+^2."""
        return -12 * _positive(1 - ratio) ** 2 if dim == 1 else -20 * _positive(1 - ratio) ** 3


@pytree_dataclass
class WendlandC4(Kernel):
    """Wendland's C4 function, support 2 h: phi_{3,2} in 2D and 3D, phi_{1,2} in 1D (see `WendlandC2`)."""

    support = 2.0
    normalization = (3 / 2, 9 / math.pi, 495 / (32 * math.pi))

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^6 (1 + 6 R + 35/3 R^2); 1D: (1 - R)_+^5 (1 + 5 R + 8 R^2)."""
        if dim == 1:
            return _positive(1 - ratio) ** 5 * (1 + (5 + 8 * ratio) * ratio)
        return _positive(1 - ratio) ** 6 * (1 + (6 + 35 / 3 * ratio) * ratio)

    def slope(self, ratio: Array, dim: int) -> Array:
        """-56/3 (1 - R)_+^5 (1 + 5 R); 1D: -14 (1 - R)_+^4 (1 + 4 R)."""
        if dim == 1:
            return -14 * _positive(1 - ratio) ** 4 * (1 + 4 * ratio)
        return -56 / 3 * _positive(1 - ratio) ** 5 * (1 + 5 * ratio)


@pytree_dataclass
class WendlandC6(Kernel):
    """Wendland's C6 function, support 2 h: phi_{3,3} in 2D and 3D, phi_{1,3} in 1D (see `WendlandC2`)."""

    support = 2.0
    normalization = (55 / 32, 78 / (7 * math.pi), 1365 / (64 * math.pi))

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = (1 - R)_+^8 (1 + 8 R + 25 R^2 + 32 R^3); 1D: (1 - R)_+^7 (1 + 7 R + 19 R^2 + 21 R^3)."""
        if dim == 1:
            return _positive(1 - ratio) ** 7 * (1 + (7 + (19 + 21 * ratio) * ratio) * ratio)
        return _positive(1 - ratio) ** 8 * (1 + (8 + (25 + 32 * ratio) * ratio) * ratio)

    def slope(self, ratio: Array, dim: int) -> Array:
        """-22 (1 - R)_+^7 (1 + 7 R + 16 R^2); 1D: -6 (1 - R)_+^6 (3 + 18 R + 35 R^2)."""
        if dim == 1:
            return -6 * _positive(1 - ratio) ** 6 * (3 + (18 + 35 * ratio) * ratio)
        return -22 * _positive(1 - ratio) ** 7 * (1 + (7 + 16 * ratio) * ratio)


@pytree_dataclass
class Gaussian(Kernel):
    """exp(-r^2 / h^2), cut off at 3 h and normalized to unit integral over what is left.

    W steps from exp(-9) of its central value (1.2e-4) to zero at the support radius; its gradient is the
    derivative on either side of that step.
    """

    support = 3.0
    # The integral of exp(-9 R^2) over the unit ball: the whole Gaussian's less its tail beyond 3 h.
    normalization = (
        3 / (math.sqrt(math.pi) * math.erf(3)),
        9 / (math.pi * (1 - math.exp(-9))),
        27 / (math.pi * (math.sqrt(math.pi) * math.erf(3) - 6 * math.exp(-9))),
    )

    def shape(self, ratio: Array, dim: int) -> Array:
        """w = exp(-9 R^2) for R < 1."""
        return jnp.where(ratio < 1, jnp.exp(-9 * ratio**2), 0.0)

    def slope(self, ratio: Array, dim: int) -> Array:
        """-18 exp(-9 R^2) for R < 1."""
        return -18 * self.shape(ratio, dim)
