"""A linear map with its own transpose goes through every transformation of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsph.linear_call import linear_call

A = jnp.asarray(np.random.default_rng(0).normal(size=(4, 3)))
X = jnp.asarray(np.random.default_rng(1).normal(size=3))
C = jnp.asarray(np.random.default_rng(2).normal(size=4))
ROUND_OFF = 1e-14  # sums of at most 4 products of numbers of order 1


def times(a, x):
    return jnp.sum(a * x, axis=-1)


def product(a, x):
    return linear_call(times, lambda a, c: times(a.T, c), a, x)


def close(value, expected):
    np.testing.assert_allclose(value, expected, rtol=1e-13, atol=ROUND_OFF)


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_values_and_first_derivatives(wrap):
    close(wrap(product)(A, X), A @ X)
    value, change = wrap(lambda a, x, dx: jax.jvp(lambda y: product(a, y), (x,), (dx,)))(A, X, 2 * X)
    close(value, A @ X)
    close(change, A @ (2 * X))
    close(wrap(jax.grad(lambda x: product(A, x) @ C))(X), A.T @ C)
    (back,) = jax.linear_transpose(lambda x: product(A, x), X)(C)
    close(back, A.T @ C)


def test_reverse_mode_uses_the_transpose_given():
    marked = lambda x: linear_call(times, lambda a, c: 10 * times(a.T, c), A, x)  # noqa: E731
    close(jax.vjp(marked, X)[1](C)[0], 10 * (A.T @ C))
    close(jax.jvp(marked, (X,), (X,))[1], A @ X)


@pytest.mark.parametrize("axes", [(0, None), (None, 0), (0, 0), (2, 1)], ids=["map", "argument", "both", "other axes"])
def test_batches(axes):
    many_a = A if axes[0] is None else jnp.moveaxis(jnp.stack([A, 2 * A, A - 1]), 0, axes[0])
    many_x = X if axes[1] is None else jnp.moveaxis(jnp.stack([X, X + 1, 3 * X]), 0, axes[1])
    plain = lambda a, x: a @ x  # noqa: E731
    close(jax.vmap(product, axes)(many_a, many_x), jax.vmap(plain, axes)(many_a, many_x))
    of_loss = lambda f: jax.grad(lambda a, x: jnp.sin(f(a, x)) @ C, argnums=1)  # noqa: E731
    close(jax.vmap(of_loss(product), axes)(many_a, many_x), jax.vmap(of_loss(plain), axes)(many_a, many_x))


def test_derivatives_with_respect_to_what_the_map_is_made_of():
    change = jax.jvp(product, (A, X), (A - 1, X + 2))[1]
    close(change, (A - 1) @ X + A @ (X + 2))
    close(jax.grad(lambda a: product(a, X) @ C)(A), jnp.outer(C, X))


def test_hessian_vector_product_is_forward_over_reverse():
    """The map depends on the point at which it is taken: f(x) = diag(x) x, g = sum c x^2, Hessian 2 diag(c)."""
    square = lambda x: linear_call(lambda r, y: r * y, lambda r, c: r * c, x, x)  # noqa: E731
    c, v = jnp.array([1.0, -2.0, 0.5]), jnp.array([3.0, 1.0, 2.0])
    gradient = jax.grad(lambda x: jnp.sum(c * square(x)))
    close(gradient(X), 2 * c * X)
    close(jax.jvp(gradient, (X,), (v,))[1], 2 * c * v)


def test_pytrees_and_integers_in_the_residual():
    index = jnp.array([2, 0, 1])

    def gather(residual, y):
        return {"out": residual["scale"] * y["in"][residual["index"]]}

    def scatter(residual, c):
        return {"in": jnp.zeros(3).at[residual["index"]].add(residual["scale"] * c["out"])}

    def loss(scale, x):
        out = linear_call(gather, scatter, {"scale": scale, "index": index}, {"in": x})["out"]
        return jnp.sum(jnp.arange(3.0) * out)

    of_scale, of_x = jax.grad(loss, argnums=(0, 1))(2.0, X)
    close(of_scale, jnp.sum(jnp.arange(3.0) * X[index]))
    close(of_x, 2.0 * jnp.zeros(3).at[index].set(jnp.arange(3.0)))


def test_a_transpose_of_another_structure_is_refused():
    with pytest.raises(TypeError, match="expected the structure"):
        jax.grad(lambda x: jnp.sum(linear_call(times, lambda a, c: [times(a.T, c)] * 2, A, x)))(X)
