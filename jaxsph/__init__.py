"""Differentiable smoothed particle hydrodynamics in JAX."""

from jaxsph.versions import __version__, check_jax_version

check_jax_version()

__all__ = ["__version__"]
