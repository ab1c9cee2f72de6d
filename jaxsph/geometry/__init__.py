"""From shapes to particles."""

from jaxsph.geometry.shapes import Particles, ball, box, jitter
from jaxsph.geometry.strip import clamped_strip
from jaxsph.geometry.tank import polygon, tank

__all__ = ["Particles", "ball", "box", "clamped_strip", "jitter", "polygon", "tank"]
