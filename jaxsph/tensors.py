"""Algebra of the small tensors of a particle, (d, d, ...), with any axes behind (the particles).

Written out as sums of products, so that every operation is one long vector over the particles. A batched
matrix product of tiny matrices is slower, and wrong on CPU in some versions of jax (issue 39103).
"""

from __future__ import annotations

import jax.numpy as jnp


def multiply(a, b):
    """Matrix product (d, d, ...) x (d, d, ...)."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


def transpose(a):
    """Transpose of the first two axes."""
    return jnp.swapaxes(a, 0, 1)


def identity_like(a):
    """The unit tensor, with ones for the axes behind so that it broadcasts: (d, d, 1, ...)."""
    return jnp.eye(a.shape[0], dtype=a.dtype).reshape(a.shape[:2] + (1,) * (a.ndim - 2))


def upper(a):
    """The numbers (d (d + 1) / 2, ...) of symmetric tensors that are on the diagonal or above, row by row."""
    d = a.shape[0]
    return jnp.stack([a[i, j] for i in range(d) for j in range(i, d)])


def symmetric(numbers):
    """The symmetric tensors (d, d, ...) with these numbers from `upper`."""
    d = {1: 1, 3: 2, 6: 3}[numbers.shape[0]]
    places = [(i, j) for i in range(d) for j in range(i, d)]
    number_at = lambda i, j: numbers[places.index((min(i, j), max(i, j)))]  # noqa: E731
    return jnp.stack([jnp.stack([number_at(i, j) for j in range(d)]) for i in range(d)])


def trace(a):
    """Sum of the diagonal."""
    return sum(a[i, i] for i in range(a.shape[0]))


def determinant(a):
    """Determinant of 1 x 1, 2 x 2 or 3 x 3 tensors."""
    if a.shape[0] == 1:
        return a[0, 0]
    if a.shape[0] == 2:
        return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    return jnp.sum(a[0] * _cofactor(a)[0], axis=0)


def _cofactor(a):
    if a.shape[0] == 1:
        return jnp.ones_like(a)
    if a.shape[0] == 2:
        return jnp.stack([jnp.stack([a[1, 1], -a[1, 0]]), jnp.stack([-a[0, 1], a[0, 0]])])
    rows = [jnp.cross(a[1], a[2], axis=0), jnp.cross(a[2], a[0], axis=0), jnp.cross(a[0], a[1], axis=0)]
    return jnp.stack(rows)


def inverse(a):
    """Inverse of 1 x 1, 2 x 2 or 3 x 3 tensors."""
    return transpose(_cofactor(a)) / determinant(a)
