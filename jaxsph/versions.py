"""The version of jaxsph, and the versions of jax that it refuses."""

import importlib.metadata

__version__ = "0.1.0"

EXCLUDED_JAX_VERSIONS = ("0.10.2", "0.11.0", "0.11.1")
"""Versions of jax and jaxlib that compute wrong numbers on CPU, silently: a vmapped matrix-vector product
followed by a sum, in 3D, from 16,385 particles in float64 and 32,769 in float32 (jax issue 39103). That
pattern is total-Lagrangian SPH. `tests/test_jax_version.py` guards it for whatever version is installed."""


def check_jax_version(version: str | None = None) -> None:
    """Refuse a version of jax or jaxlib that is known to compute wrong numbers.

    Args:
        version: version to judge; None judges the installed jax and jaxlib (the compiler is in jaxlib).

    Raises:
        ImportError: a version is one of `EXCLUDED_JAX_VERSIONS`.
    """
    if version is None:
        versions = {package: importlib.metadata.version(package) for package in ("jax", "jaxlib")}
    else:
        versions = {"jax": version}
    for package, found in versions.items():
        if found in EXCLUDED_JAX_VERSIONS:
            raise ImportError(
                f"{package} {found} computes wrong numbers on CPU without a message (jax issue 39103), so "
                f"jaxsph does not run with it. Excluded: {', '.join(EXCLUDED_JAX_VERSIONS)}. "
                "Cure: pip install 'jax>=0.9,!=0.10.2,!=0.11.0,!=0.11.1' (0.10.1 on Python 3.11)."
            )
