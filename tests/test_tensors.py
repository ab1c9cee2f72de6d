"""The written-out algebra of small tensors is that of NumPy's matrices."""

import jax
import numpy as np
import pytest

from jaxsph import tensors

# Sums of up to 9 products of numbers of order 1: some tens of roundings.
ROUND_OFF = {np.float64: 1e-13, np.float32: 1e-5}


def matrices(d, kind, behind, seed=0):
    """Well-conditioned matrices (d, d, ...) and the same with the matrix axes last, as NumPy wants them."""
    a = np.eye(d).reshape(d, d, *(1,) * len(behind)) + 0.4 * np.random.default_rng(seed).uniform(-1, 1, (d, d, *behind))
    a = a.astype(kind)
    return a, np.moveaxis(a.astype(np.float64), (0, 1), (-2, -1))


def everything(a, b):
    one = (tensors.transpose(a), tensors.trace(a), tensors.determinant(a), tensors.inverse(a))
    return tensors.multiply(a, b), *one, tensors.identity_like(a) + 0 * a


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("behind", [(), (7,), (2, 3)], ids=["one", "particles", "slots and particles"])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_algebra_is_numpys(d, behind, kind):
    a, expected_a = matrices(d, kind, behind)
    b, expected_b = matrices(d, kind, behind, seed=1)

    def close(value, expected, axes=2):
        assert value.dtype == kind
        first = range(axes)
        shown = np.moveaxis(np.asarray(value), tuple(first), tuple(range(-axes, 0))) if axes else np.asarray(value)
        np.testing.assert_allclose(shown, expected, rtol=0, atol=ROUND_OFF[kind] * 4)

    product, transposed, trace, determinant, inverse, unit = jax.jit(everything)(a, b)
    close(product, expected_a @ expected_b)
    close(transposed, np.swapaxes(expected_a, -1, -2))
    close(trace, np.trace(expected_a, axis1=-2, axis2=-1), axes=0)
    close(determinant, np.linalg.det(expected_a), axes=0)
    close(inverse, np.linalg.inv(expected_a))
    close(unit, np.broadcast_to(np.eye(d), expected_a.shape))


@pytest.mark.parametrize("d", [1, 2, 3])
def test_inverse_undoes(d):
    a, _ = matrices(d, np.float64, (11,))
    unit = np.broadcast_to(np.eye(d)[:, :, None], a.shape)
    # condition numbers below 10, so ten roundings
    np.testing.assert_allclose(tensors.multiply(tensors.inverse(a), a), unit, atol=1e-14 * 10)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_are_jacobis_formula_and_minus_inverse_squared(d):
    a, _ = matrices(d, np.float64, ())
    da, _ = matrices(d, np.float64, (), seed=2)
    inverse = tensors.inverse(a)
    change = jax.jvp(jax.jit(tensors.determinant), (a,), (da,))[1]
    np.testing.assert_allclose(
        change, tensors.determinant(a) * tensors.trace(tensors.multiply(inverse, da)), rtol=1e-12
    )
    change = jax.jvp(jax.jit(tensors.inverse), (a,), (da,))[1]
    expected = -tensors.multiply(inverse, tensors.multiply(da, inverse))
    np.testing.assert_allclose(change, expected, rtol=1e-12, atol=1e-13)  # a few tens of roundings


@pytest.mark.parametrize("d", [1, 2, 3])
def test_symmetric_tensors_are_their_upper_half(d):
    """Exactly: numbers are only moved."""
    a, _ = matrices(d, np.float64, (5,))
    half = tensors.upper(a)
    assert half.shape == (d * (d + 1) // 2, 5)
    np.testing.assert_array_equal(
        tensors.symmetric(half), np.where(np.tri(d, dtype=bool).T[:, :, None], a, a.swapaxes(0, 1))
    )
