"""Solids that touch each other and walls."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.checks import check_positive
from jaxsph.pair_sum import dot
from jaxsph.pytree import pytree_dataclass

ONSET = 0.1
"""Depth in spacings over which the stiffness rises from zero."""


@pytree_dataclass
class Contact:
    """Pushes particles of different solids, and of solids and walls, apart when they are closer than their spacing.

    With d = 1 - r / r_0 > 0, r_0 the mean of both spacings, and e = .1 the force on a from b is

        C M V_ab / r_0  d^2 / (d + e),     V_ab = 2 V_a V_b / (V_a + V_b):

    between two lattices a pressure that begins with no slope and soon grows like C M d. It acts along the line between
    two particles, without friction or loss: energy, linear and angular momentum are conserved. Its slope is continuous
    where contact begins, its curvature is not; it is not smooth where two particles meet (r = 0). Bodies that start
    closer than r_0, as a plate in its socket, push from where they start. A solid does not touch itself.

    The stiffness, at most C M V_ab / r_0^2, limits the time step (`jaxsph.contact.contact_time_step`). With the default
    it is about that of sound in the fluid. A body is held back before half a spacing while the pressure on it stays
    below .4 C M.

    Attributes:
        coefficient: C, positive.
        modulus: M [Pa]; None takes the largest rho c^2 of the fluids, without fluids the smallest p-wave modulus of
            the elastic structures.
    """

    coefficient: Any = 0.5
    modulus: Any = None

    def __post_init__(self):
        check_positive("Contact.coefficient", self.coefficient, "no unit")
        if self.modulus is not None:
            check_positive("Contact.modulus", self.modulus, "Pa")

    def pair(self, a, b, offset, strength):
        """Force on a [N, in 2D per meter], (d,).

        Args:
            a, b: `volume` [m^d], `spacing` [m], and `reach` [m], beyond which neither pushes.
            offset: x_a - x_b (d,) [m].
            strength: C M [Pa].
        """
        distance, depth, spacing = self._depth(a, b, offset)
        return strength * _volume(a, b) / spacing * depth**2 / (depth + ONSET) / distance * offset

    def pair_energy(self, a, b, offset, strength):
        """Energy of a pair [J, in 2D per meter]; arguments as of `pair`."""
        _, depth, _ = self._depth(a, b, offset)
        return strength * _volume(a, b) * (0.5 * depth**2 - ONSET * depth + ONSET**2 * jnp.log1p(depth / ONSET))

    def _depth(self, a, b, offset):
        """|x_ab| (1 if zero), how far a and b are within their reach in spacings, and r_0."""
        squared = dot(offset, offset)
        distance = jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
        apart = jnp.where(squared > 0, distance, 0.0)
        spacing = 0.5 * (a["spacing"] + b["spacing"])
        reach = jnp.minimum(spacing, jnp.minimum(a["reach"], b["reach"]))
        return distance, jnp.where(apart < reach, (reach - apart) / spacing, 0.0), spacing


def _volume(a, b):
    return 2 * a["volume"] * b["volume"] / (a["volume"] + b["volume"])
