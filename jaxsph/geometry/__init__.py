"""From shapes to particles."""

from jaxsph.geometry.shapes import Particles, ball, box, jitter
from jaxsph.geometry.tank import polygon, tank

__all__ = ["Particles", "ball", "box", "jitter", "polygon", "tank"]
