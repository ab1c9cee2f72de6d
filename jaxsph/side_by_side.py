"""Several numbers side by side in a wide one: two in a complex number, in float32 four in a complex one of 128 bits.

Loops over pairs carry their sums so. For one array XLA makes one pass over the particles, in which what was gathered,
every distance and every sum stays in a register. For several arrays it makes a pass for each of them and for all that
they share, with arrays in between: up to twice as slow (`make bench`, turns). That is so on CPUs; for other devices XLA
makes one pass of several results by itself, and each sum stays an array of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

HALF = 32  # bits


class SideBySide:
    """How arrays of one shape and of these types are put together, and taken apart.

    differentiable: whether derivatives pass through. Then only two numbers go into one: of four the bits are moved
        about, which has no derivative.

    `passes` are the numbers to be calculated together, and apart from others: those in one wide number. In loops over
    tiles XLA then calculates again what several share, which in 3D is faster than arrays in between; in others it sees
    through this and shares it. Derivatives share so much that arrays are better.
    """

    def __init__(self, dtypes: Sequence[Any], *, differentiable: bool):
        at_once = {jnp.dtype(jnp.float32): 2 if differentiable else 4, jnp.dtype(jnp.float64): 2}
        at_once = at_once if jax.default_backend() == "cpu" else {}
        alike: dict[Any, list[int]] = {}
        for place, dtype in enumerate(dtypes):
            alike.setdefault(jnp.dtype(dtype), []).append(place)
        self.n_numbers = len(dtypes)
        self.groups = []
        for dtype, places in alike.items():
            size = at_once.get(dtype, 1)
            self.groups += [places[first : first + size] for first in range(0, len(places), size)]
        apart = bool(at_once) and not differentiable
        self.passes = self.groups if apart else [range(len(dtypes))]

    def types_allowed(self):
        """The context in which this can be done also where types of 64 bits are switched off."""
        return jax.enable_x64(True) if any(len(group) > 2 for group in self.groups) else nullcontext()

    def joined(self, values: Sequence[Any]) -> list:
        """Fewer arrays."""
        return [_joined([values[place] for place in group]) for group in self.groups]

    def apart(self, wide: Sequence[Any]) -> list:
        """The arrays that `joined` has put together."""
        values: list[Any] = [None] * self.n_numbers
        for group, number in zip(self.groups, wide, strict=True):
            for place, value in zip(group, _parts(number, len(group)), strict=True):
                values[place] = value
        return values


def _joined(values):
    if len(values) == 1:
        return values[0]
    if len(values) == 2:
        return jax.lax.complex(*values)
    first, second, third, *fourth = values
    return jax.lax.complex(_in_one(first, second), _in_one(third, *(fourth or [jnp.zeros_like(third)])))


def _parts(number, n):
    if n == 1:
        return [number]
    if n == 2:
        return [number.real, number.imag]
    return [*_halves(number.real), *_halves(number.imag)][:n]


def _in_one(high, low):
    """The bits of two numbers as those of one, with which nothing may be calculated."""
    high, low = (jax.lax.bitcast_convert_type(one, jnp.uint32).astype(jnp.uint64) for one in (high, low))
    return jax.lax.bitcast_convert_type((high << np.uint64(HALF)) | low, jnp.float64)


def _halves(pair):
    bits = jax.lax.bitcast_convert_type(pair, jnp.uint64)
    return [
        jax.lax.bitcast_convert_type(half.astype(jnp.uint32), jnp.float32) for half in (bits >> np.uint64(HALF), bits)
    ]
