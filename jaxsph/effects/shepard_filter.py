"""Smoothing of the density every so many steps."""

from __future__ import annotations

from jaxsph.pytree import pytree_dataclass, static


@pytree_dataclass
class ShepardFilter:
    """Every so many steps the density becomes its mean over the neighbors, the particle itself included.

        rho_a = sum_b m_b W_ab / sum_b V_b W_ab,

    over the particles of its own fluid. Exact for constant densities also at a free surface; there and at walls it
    levels gradients, such as the hydrostatic one, where `DeltaDiffusion` does not. D. Shepard (1968), Proc. 23rd ACM
    Natl. Conf., 517; first order in A. Colagrossi, M. Landrini (2003), J. Comput. Phys. 191, 448. It acts when
    neighbor lists are built; under a transformation that is every 1 to 8 steps, of which it takes the first multiple at
    or after every multiple of `every` steps, with plain numbers too. It needs a density that is integrated in time.

    Attributes:
        every: steps between two filters; 20 to 50 are common.
    """

    every: int = static(default=20)

    def __post_init__(self):
        if isinstance(self.every, bool) or not isinstance(self.every, int) or self.every < 1:
            raise ValueError(f"ShepardFilter.every = {self.every!r} must be a whole number of steps, at least 1")

    def due(self, step, steps_between):
        """Whether a multiple of `every` lies in the steps since the last build; not at the start."""
        return (step > 0) & (step // self.every > (step - steps_between) // self.every)
