"""Ready-made scenes with parameters, one file each."""

from jaxsph.scenes.beam import cantilever, turek_hron_beam

__all__ = ["cantilever", "turek_hron_beam"]
