"""Smoothing kernels: unit integral, derivatives, coincident particles, support."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsph.kernels import (
    CubicSpline,
    Gaussian,
    QuarticSpline,
    QuinticSpline,
    WendlandC2,
    WendlandC4,
    WendlandC6,
    _same_dtype,
)

KERNELS = [
    CubicSpline(),
    QuarticSpline(),
    QuinticSpline(),
    WendlandC2(),
    WendlandC4(),
    WendlandC6(),
    Gaussian(),
]
H = 0.7  # a smoothing length that is not 1, so that powers of it cannot hide

every_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: type(kernel).__name__)
every_dim = pytest.mark.parametrize("dim", [1, 2, 3])
# Every dimension and both precisions, but not every pair of them: compiling is what these tests cost.
each_dim_and_dtype = pytest.mark.parametrize(("dim", "dtype"), [(1, "float32"), (2, "float64"), (3, "float32")])
every_dtype = pytest.mark.parametrize("dtype", ["float64", "float32"])


def separations(kernel, dim, count=40):
    """Vectors (count, d) of lengths spread over the support, away from its center, its end and its knots."""
    random = np.random.default_rng(1)
    directions = random.normal(size=(count, dim))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    q = (np.arange(count) + 0.61) / count * kernel.support
    knots = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    q = q[np.abs(q[:, None] - knots).min(axis=1) > 0.01]
    return jnp.asarray(directions[: len(q)] * q[:, None] * H)


@every_kernel
@every_dim
def test_integral_is_one(kernel, dim):
    """Gauss-Legendre on the pieces between knots, over shells of the sphere in `dim` dimensions."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    area = {1: 2.0, 2: 2 * math.pi, 3: 4 * math.pi}[dim]
    radius = kernel.support_radius(H)
    edges = np.linspace(0.0, radius, 61)  # every knot of a spline is an edge: its pieces are polynomials
    r = (0.5 * (edges[1:] + edges[:-1])[:, None] + 0.5 * np.diff(edges)[:, None] * nodes).ravel()
    weight = (0.5 * np.diff(edges)[:, None] * weights).ravel()
    w = jax.jit(jax.vmap(lambda length: kernel.w(jnp.zeros(dim).at[0].set(length), H)))(jnp.asarray(r))
    # 16 points are exact to degree 31, above every polynomial here: what is left is rounding of the sum.
    assert np.sum(weight * area * r ** (dim - 1) * np.asarray(w)) == pytest.approx(1.0, rel=1e-13)


@every_kernel
@each_dim_and_dtype
def test_gradient_is_the_derivative_of_w(kernel, dim, dtype):
    r_vec = separations(kernel, dim).astype(dtype)
    h = jnp.asarray(H, dtype)

    def w(r_vec):  # without the rule that `Kernel.w` carries: plain AD of the radial function
        return kernel.radial(jnp.sqrt(jnp.sum(r_vec * r_vec)) / h, dim) / h**dim

    @jax.jit
    @jax.vmap
    def evaluate(x):
        by_ad = jax.value_and_grad(w)(x)
        by_rule = jax.value_and_grad(lambda x: kernel.w(x, h))(x)
        return by_ad, by_rule, kernel.gradient(x, h)

    (expected_values, expected), (values, ruled), gradient = evaluate(r_vec)
    assert gradient.dtype == dtype
    # A few tens of roundings, relative to the largest gradient (the difference cancels in the spline tails).
    tolerance = 100 * np.finfo(dtype).eps * np.abs(expected).max()
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(ruled, gradient, rtol=0, atol=tolerance)
    assert values.dtype == dtype
    np.testing.assert_allclose(values, expected_values, rtol=0, atol=tolerance * H)


@every_kernel
@every_dim
def test_gradient_against_central_differences(kernel, dim):
    r_vec = separations(kernel, dim)
    step = 1e-5 * H
    w = jax.jit(jax.vmap(lambda x: kernel.w(x, H)))
    gradients = jax.jit(jax.vmap(lambda x: kernel.gradient(x, H)))(r_vec)
    for axis in range(dim):
        offset = jnp.zeros(dim).at[axis].set(step)
        difference = (w(r_vec + offset) - w(r_vec - offset)) / (2 * step)
        gradient = gradients[:, axis]
        # Truncation step^2 / 6 W''' ~ 1e-9 and rounding eps W / step ~ 1e-11, W''' up to 100 W' / h^2.
        np.testing.assert_allclose(gradient, difference, rtol=0, atol=1e-8 * np.abs(gradient).max())


@every_kernel
@every_dim
def test_second_derivative_against_central_differences(kernel, dim):
    """Also at r = 0, where every kernel has a second derivative: grad grad W = F(0) times the identity."""
    r_vec = jnp.concatenate([separations(kernel, dim), jnp.zeros((1, dim))])
    step = 1e-5 * H
    gradient = jax.jit(jax.vmap(lambda x: kernel.gradient(x, H)))
    second = jax.jit(jax.vmap(lambda x: (jax.jacfwd(kernel.gradient)(x, H), jax.hessian(kernel.w)(x, H))))
    of_gradient, of_w = second(r_vec)
    scale = np.abs(of_gradient).max()
    # Both are the same closed form: rounding only.
    np.testing.assert_allclose(of_w, of_gradient, rtol=0, atol=1e-13 * scale)
    for axis in range(dim):
        offset = jnp.zeros(dim).at[axis].set(step)
        difference = (gradient(r_vec + offset) - gradient(r_vec - offset)) / (2 * step)
        # The third derivative of W jumps at r = 0 (Wendland C2, cubic spline): an error of order step / h.
        np.testing.assert_allclose(of_gradient[:-1, :, axis], difference[:-1], rtol=0, atol=1e-8 * scale)
        np.testing.assert_allclose(of_gradient[-1, :, axis], difference[-1], rtol=0, atol=1e-4 * scale)


@every_dim
@pytest.mark.parametrize(
    ("kernel", "knots"),
    [(CubicSpline(), (1.0,)), (QuarticSpline(), (0.5, 1.5)), (QuinticSpline(), (1.0, 2.0))],
    ids=lambda value: type(value).__name__,
)
def test_second_derivative_at_the_knots(kernel, knots, dim):
    """Where pairs of a lattice are that is as wide as h: the pieces join there, and so must what AD makes of them."""
    along = lambda r, h: kernel.gradient(jnp.zeros(dim).at[0].set(r), h)[0]  # noqa: E731
    for knot in knots:
        at, step = jnp.asarray(knot * 1.0), 1e-6
        for argument, place in ((0, (at, 1.0)), (1, (at, 1.0))):
            slope = jax.grad(along, argument)(*map(jnp.asarray, place))
            ends = [[value + sign * step * (i == argument) for i, value in enumerate(place)] for sign in (1, -1)]
            difference = (along(*ends[0]) - along(*ends[1])) / (2 * step)
            # the next derivative may jump: a step of it
            np.testing.assert_allclose(slope, difference, atol=1e-5 * abs(float(along(at, 1.0))) + 1e-9, rtol=1e-5)


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_whole_numbers_do_not_round_the_smoothing_length(kind):
    offset, h = _same_dtype(np.array([1, 0], kind), 1.5)
    assert jnp.issubdtype(offset.dtype, jnp.floating) and float(h) == 1.5


@every_kernel
@every_dim
def test_derivative_with_respect_to_smoothing_length(kernel, dim):
    r_vec = separations(kernel, dim)
    step = 1e-6 * H
    for function in (kernel.w, kernel.gradient):
        mapped = jax.jit(jax.vmap(function, (0, None)))
        difference = (mapped(r_vec, H + step) - mapped(r_vec, H - step)) / (2 * step)
        derivative = jax.jit(jax.vmap(jax.jacfwd(function, argnums=1), (0, None)))(r_vec, H)
        # Rounding eps / 1e-6 = 2e-10 of the value, and truncation 1e-12 of the third derivative.
        np.testing.assert_allclose(derivative, difference, rtol=0, atol=5e-9 * np.abs(derivative).max())


@every_kernel
@each_dim_and_dtype
def test_coincident_particles_have_finite_derivatives(kernel, dim, dtype):
    """All first and second derivatives in r_vec and h, every order of forward and reverse mode.

    Also a separation so small that its square is lost beside the floor, and one whose square underflows.
    """

    def value_and_gradient(r_vec_and_h):
        r_vec, h = r_vec_and_h[:-1], r_vec_and_h[-1]
        return jnp.append(kernel.gradient(r_vec, h), kernel.w(r_vec, h))

    # One direction that mixes all components: a NaN or an infinity in any entry of a Jacobian shows in it.
    direction = np.linspace(0.7, 1.3, dim + 1).astype(dtype)

    def along(function):
        return lambda x: jax.jvp(function, (x,), (direction,))[1]

    def mixed(x):
        return jnp.sum(direction * value_and_gradient(x))

    def back(function):
        return lambda x: jnp.sum(direction * jax.grad(function)(x))

    @jax.jit
    @jax.vmap
    def derivatives(x):
        first = along(mixed)(x), back(mixed)(x)
        second = [outer(inner(mixed))(x) for outer, inner in itertools.product((along, back), repeat=2)]
        return value_and_gradient(x), jnp.stack(first), jnp.stack(second)

    points = np.array([[length] * dim + [H] for length in (0.0, 1e-9, 1e-30)], dtype)
    value, first, second = derivatives(points)
    for result in (value, first, second):
        assert result.dtype == dtype
        assert np.isfinite(result).all()
    # Every mode computes the same number: some tens of roundings of terms as large as the derivative itself.
    for result in (first, second):
        tolerance = 100 * np.finfo(dtype).eps * np.abs(result).max()
        np.testing.assert_allclose(result - result[:, :1], 0, atol=tolerance)


@every_kernel
@every_dim
@every_dtype
def test_coincident_particles_do_not_push(kernel, dim, dtype):
    np.testing.assert_array_equal(kernel.gradient(jnp.zeros(dim, dtype), H), np.zeros(dim))


@every_kernel
@each_dim_and_dtype
def test_gradient_is_antisymmetric(kernel, dim, dtype):
    """To the last bit, so that pairs conserve momentum to round-off."""
    r_vec = separations(kernel, dim).astype(dtype)
    gradient = jax.jit(jax.vmap(lambda x: kernel.gradient(x, H)))
    np.testing.assert_array_equal(gradient(r_vec), -gradient(-r_vec))


@every_kernel
@each_dim_and_dtype
def test_zero_from_the_support_radius_on(kernel, dim, dtype):
    points = np.zeros((3, dim), dtype)
    points[:, 0] = np.array([1.000001, 1.2, 50.0]) * kernel.support_radius(H)
    functions = kernel.w, kernel.gradient, jax.jacrev(kernel.gradient)
    for values in jax.jit(jax.vmap(lambda x: [function(x, H) for function in functions]))(points):
        np.testing.assert_array_equal(values, np.zeros_like(values))


@every_kernel
@every_dim
def test_decreasing_and_positive_inside_the_support(kernel, dim):
    q = jnp.linspace(0.0, kernel.support, 400, endpoint=False)
    w = np.asarray(kernel.radial(q, dim))
    assert (w > 0).all()
    assert (np.diff(w) < 0).all()


@every_kernel
@every_dim
def test_independent_of_the_unit_of_length(kernel, dim):
    """Micrometers or kilometers, in float32: W scales with h^-d and its gradient with h^-(d+1)."""
    r_vec = (separations(kernel, dim) / H).astype("float32")
    mapped = [jax.jit(jax.vmap(function, (0, None))) for function in (kernel.w, kernel.gradient)]
    for h in (1e-6, 1e3):
        for power, function in zip((dim, dim + 1), mapped, strict=True):
            expected = np.asarray(function(r_vec, 1.0), "float64")
            found = np.asarray(function(r_vec * np.float32(h), h), "float64") * h**power
            # The last places of r / h differ; the steepest kernel amplifies that ten times or so.
            np.testing.assert_allclose(found, expected, rtol=0, atol=3e-6 * np.abs(expected).max())


@every_dim
def test_wendland_c2_gradient_costs_one_square_root(dim):
    """No division for each pair: the only ones are by h, which all pairs share."""
    pairs = 8
    closed = jax.make_jaxpr(jax.vmap(lambda x, h: WendlandC2().gradient(x, h), (0, None)))(jnp.ones((pairs, dim)), H)
    operations = [(e.primitive.name, e.outvars[0].aval.shape) for e in flat_equations(closed.jaxpr)]
    assert [name for name, shape in operations if name == "sqrt"] == ["sqrt"]
    assert [shape for name, shape in operations if name in ("div", "rsqrt", "pow") and pairs in shape] == []


def flat_equations(jaxpr):
    for equation in jaxpr.eqns:
        inner = [p.jaxpr for p in equation.params.values() if hasattr(p, "jaxpr")]
        yield equation
        for closed in inner:
            yield from flat_equations(closed)


@pytest.mark.parametrize("dim", [4, 7])
def test_too_many_dimensions_are_refused(dim):
    with pytest.raises(ValueError, match=f"1, 2 or 3 dimensions, not {dim}"):
        WendlandC2().w(jnp.ones(dim), H)
    with pytest.raises(ValueError, match="1, 2 or 3 dimensions"):
        WendlandC2().gradient(jnp.ones(dim), H)
    with pytest.raises(ValueError, match="1, 2 or 3 dimensions"):
        WendlandC2().radial(jnp.ones(3), dim)


@every_kernel
def test_a_kernel_is_a_pytree_without_leaves(kernel):
    """It is compiled in: two of one class are the same to jit."""
    assert jax.tree.leaves(kernel) == []
    assert jax.tree.structure(kernel) == jax.tree.structure(type(kernel)())
