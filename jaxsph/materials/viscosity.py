"""Laws of viscosity: the shear force between two particles of a Newtonian fluid."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import jax.numpy as jnp

from jaxsph.pytree import pytree_dataclass


class ViscosityLaw(ABC):
    """The force of a pair by viscosity.

    The published laws have x . grad W / (x^2 + .01 h^2), whose second term weakens the viscosity by .7 % at h = dx.
    Here grad W = F x with a finite F, so nothing need be added to x^2.
    """

    @abstractmethod
    def force(self, a, b, pair) -> Any:
        """Force on a from b [N, in 2D per meter], (d,).

        Args:
            a, b: fields `velocity` (d,) [m/s], `volume` [m^d], `viscosity` [Pa s].
            pair: geometry of the pair, see `jaxsph.flow.Pair`.
        """


@pytree_dataclass
class MorrisViscosity(ViscosityLaw):
    """V_a V_b (mu_a + mu_b) F_ab v_ab, where grad W = F_ab x_ab.

    J. P. Morris, P. J. Fox, Y. Zhu (1997), J. Comput. Phys. 136, 214, eq. (22). Conserves linear momentum.
    """

    def force(self, a, b, pair):
        """[N]."""
        strength = a["volume"] * b["volume"] * pair.slope * (a["viscosity"] + b["viscosity"])
        return strength * (a["velocity"] - b["velocity"])


@pytree_dataclass
class AdamiViscosity(ViscosityLaw):
    """(V_a^2 + V_b^2) 2 mu_a mu_b / (mu_a + mu_b) F_ab v_ab, where grad W = F_ab x_ab.

    S. Adami, X. Y. Hu, N. A. Adams (2012), J. Comput. Phys. 231, 7057, eq. (14): the harmonic mean lets shear stress be
    continuous between fluids of different viscosity.
    """

    def force(self, a, b, pair):
        """[N]."""
        both = a["viscosity"] + b["viscosity"]
        mean = 2 * a["viscosity"] * b["viscosity"] / jnp.where(both > 0, both, 1.0)
        volumes = a["volume"] ** 2 + b["volume"] ** 2
        return volumes * pair.slope * mean * (a["velocity"] - b["velocity"])


@pytree_dataclass
class MonaghanViscosity(ViscosityLaw):
    """(d + 2) V_a V_b (mu_a + mu_b) (v_ab . x_ab) / x_ab^2 grad W: along the line between the particles.

    J. J. Monaghan, R. A. Gingold (1983), J. Comput. Phys. 52, 374, without their switch; the factor is that of
    A. Colagrossi, M. Antuono, A. Souto-Iglesias, D. Le Touze (2011), Phys. Rev. E 84, 026705. The right one at a free
    surface: it dissipates 2 mu D : D, where the other laws dissipate mu |grad v|^2, which for a wave is half of it.
    Conserves angular momentum too. Less exact than the others where particles are disordered.
    """

    def force(self, a, b, pair):
        """[N]."""
        approach = jnp.sum((a["velocity"] - b["velocity"]) * pair.offset)
        strength = a["volume"] * b["volume"] * pair.slope * (a["viscosity"] + b["viscosity"])
        along = approach / jnp.where(pair.squared > 0, pair.squared, 1.0)
        return (pair.offset.shape[0] + 2) * strength * along * pair.offset
