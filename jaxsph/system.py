"""What fluids, structures, rigid bodies and walls have in common."""

from __future__ import annotations

from jaxsph.geometry.shapes import Particles


class System:
    """Particles with a name in a scene."""

    name: str
    particles: Particles

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.particles.positions.shape[1]

    @property
    def n_particles(self) -> int:
        """Number of particles."""
        return self.particles.positions.shape[0]

    @property
    def dtype(self):
        """Precision of its arrays."""
        return self.particles.positions.dtype

    @property
    def moves(self) -> bool:
        """Whether its particles change their places."""
        return True
