"""What can go wrong in a run, each with the numbers and the cure in its message."""

from typing import Any


class SimulationError(RuntimeError):
    """A run that could not go on. `trajectory` holds what was computed until then (or None)."""

    def __init__(self, message: str, trajectory: Any = None):
        super().__init__(message)
        self.trajectory = trajectory


class NeighborOverflow(SimulationError):
    """A particle has more neighbors than its list has slots."""


class SkinExceeded(SimulationError):
    """Particles moved further than the skin of their neighbor list allows."""


class ParticleOutside(SimulationError):
    """A particle left the domain."""


class UnstableTimeStep(SimulationError):
    """The time step is larger than the largest stable one."""


class NotFinite(SimulationError):
    """A field became infinite or not a number."""
