"""What a scene may or may not call for, one file each. An effect that a scene does not list is not compiled."""

from jaxsph.effects.damping import Damping
from jaxsph.effects.penalty import PenaltyForce

__all__ = ["Damping", "PenaltyForce"]
