"""The installed jax computes what it is asked to (jax issue 39103), and known bad versions are refused."""

import importlib.metadata
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import USUAL

from jaxsph.versions import EXCLUDED_JAX_VERSIONS, check_jax_version

# The smallest sizes at which the CPU backend of an excluded version goes wrong, and a size well beyond.
SIZES = [("float64", 16_385), ("float32", 32_769), ("float64", 50_000), ("float32", 50_000)]


def squared_length_of_product(matrix, vector):
    return jnp.sum((matrix @ vector) ** 2)


@pytest.mark.parametrize(("dtype", "particles"), SIZES)
def test_one_matrix_for_all_particles(dtype, particles):
    """The reproducer of the issue: the last rows of the compiled result were those of earlier ones."""
    index = np.arange(particles, dtype=dtype)
    vectors = np.stack([index, np.zeros_like(index), np.zeros_like(index)], axis=1)
    identity = np.eye(3, dtype=dtype)
    compiled = jax.jit(jax.vmap(squared_length_of_product, in_axes=(None, 0)), compiler_options=USUAL)(
        identity, vectors
    )
    # One product by 1, two by 0: every result is a single rounded square, so the two agree exactly.
    np.testing.assert_array_equal(np.asarray(compiled), index**2)


@pytest.mark.parametrize(("dtype", "particles"), SIZES)
def test_one_matrix_per_particle(dtype, particles):
    """The form that total-Lagrangian SPH has: each particle applies its own matrix, then a sum."""
    random = np.random.default_rng(0)
    matrices = random.normal(size=(particles, 3, 3)).astype(dtype)
    vectors = random.normal(size=(particles, 3)).astype(dtype)
    expected = np.sum(np.einsum("nij,nj->ni", matrices, vectors) ** 2, axis=1)
    mapped = jax.vmap(squared_length_of_product)
    # About ten roundings each, of products whose sum may cancel: 100 eps of the largest result.
    tolerance = 100 * np.finfo(dtype).eps * expected.max()
    np.testing.assert_allclose(
        jax.jit(mapped, compiler_options=USUAL)(matrices, vectors), expected, rtol=0, atol=tolerance
    )
    np.testing.assert_allclose(mapped(matrices, vectors), expected, rtol=0, atol=tolerance)


def test_installed_version_is_not_excluded():
    assert importlib.metadata.version("jax") not in EXCLUDED_JAX_VERSIONS
    assert importlib.metadata.version("jaxlib") not in EXCLUDED_JAX_VERSIONS
    check_jax_version()


@pytest.mark.parametrize("version", EXCLUDED_JAX_VERSIONS)
def test_excluded_version_is_refused_with_the_cure(version):
    with pytest.raises(ImportError, match=rf"jax {version} computes wrong numbers.*pip install"):
        check_jax_version(version)


def test_metadata_excludes_the_same_versions():
    """pip must never choose what the import then refuses."""
    pattern = re.compile(r"jax\s*[<>=!~]")
    (requirement,) = filter(pattern.match, importlib.metadata.requires("jaxsph") or [])
    for version in EXCLUDED_JAX_VERSIONS:
        assert f"!={version}" in requirement
