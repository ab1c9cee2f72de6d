"""From shapes to particles."""

from jaxsph.geometry.shapes import Particles, ball, box, jitter

__all__ = ["Particles", "ball", "box", "jitter"]
