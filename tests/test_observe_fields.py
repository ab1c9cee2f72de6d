"""Fields of a fluid at its particles and between them are exact where theory says so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from basins import GRAVITY, HEIGHT, REST, basin, with_water

import jaxsph as sph
from jaxsph import observe
from jaxsph.scenes.taylor_green import taylor_green

POINTS = np.array([[0.3, 0.3], [0.81, 0.44], [1.25, 0.52], [0.02, 0.03]])


def test_pressure_and_density_are_those_of_the_state_equation():
    scene = basin()
    state = sph.initial_state(scene)
    depth = HEIGHT - scene["water"].particles.positions[:, 1]
    np.testing.assert_allclose(observe.pressure(scene, state, "water"), REST * GRAVITY * depth, rtol=1e-12)
    expected = REST + REST * GRAVITY * depth / 40.0**2
    np.testing.assert_allclose(observe.density(scene, state, "water"), expected, rtol=1e-14)
    with pytest.raises(ValueError, match="'tank' is a Wall; this is observed of a Fluid"):
        observe.pressure(scene, state, "tank")


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_interpolation_is_exact_for_constant_and_affine_fields(kind, d):
    """Of order 0 and 1; at surfaces and in corners too."""
    scene = basin(kind, d, width=0.8)
    rng = np.random.default_rng(d)
    points = rng.uniform(0.0, 0.6, (5, d))
    points[0] = 0.0
    x = scene["water"].particles.positions
    slope, value = rng.uniform(-1, 1, (d, d)), np.arange(1.0, d + 1)
    state = sph.initial_state(scene)
    precision = float(np.finfo(kind).eps)
    constant = with_water(state, velocity=jnp.broadcast_to(jnp.asarray(value, kind), x.shape))
    affine = with_water(state, velocity=jnp.asarray(x @ slope.T + value, kind))
    for order, of, expected in ((0, constant, value), (1, constant, value), (1, affine, points @ slope.T + value)):
        found = observe.interpolate(scene, of, "water", "velocity", points, order=order)
        assert found.dtype == kind and found.shape == points.shape
        # sums over a hundred particles; the corner's spread is inverted
        np.testing.assert_allclose(found, np.broadcast_to(expected, points.shape), rtol=0, atol=200 * precision)


def test_interpolation_is_of_second_order():
    """Twice as many particles, at the same h / dx, leave a quarter of the error; .3 allows for the next order."""
    errors = []
    points = observe.plane((0.1, 0.2), (0.9, 0.25), (0.15, 0.8), (4, 5))
    k = 2 * np.pi
    exact = -np.cos(k * points[:, 0]) * np.sin(k * points[:, 1])
    for particles in (20, 40):
        scene = taylor_green(particles)
        found = observe.interpolate(scene, sph.initial_state(scene), "water", "velocity", points)
        errors.append(np.max(np.abs(found[:, 0] - exact)))
    assert errors[1] < 0.3 * errors[0] < 0.3 * 0.05


def test_a_periodic_field_is_whole_across_the_border():
    scene = taylor_green(20)
    state = sph.initial_state(scene)
    ends = observe.interpolate(scene, state, "water", "velocity", [[0.0, 0.3], [1.0, 0.3]], order=1)
    # the same particles, summed with offsets that differ in the last digit
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-13)
    # inside everywhere: kernel sums on a lattice are 1 to a thousandth at h = dx with the quintic spline
    np.testing.assert_allclose(observe.coverage(scene, state, "water", [[0.0, 0.0], [0.5, 1.0]]), 1.0, atol=1e-3)


def test_far_from_the_fluid_the_value_is_zero_and_derivatives_are_finite():
    scene = basin()
    state = sph.initial_state(scene)
    points = np.array([[0.5, 5.0], [0.5, HEIGHT + 0.25], [0.5, HEIGHT + 0.299999], [0.55, 0.55], [0.5, HEIGHT]])
    cover = observe.coverage(scene, state, "water", points)
    assert cover[0] == 0.0 and cover[3] == pytest.approx(1.0, abs=0.01)
    # half of space, but the weights of the rows beside the surface are not quite its integral
    assert cover[4] == pytest.approx(0.5, abs=0.02)
    for order in (0, 1):

        def total(position, places, order=order):
            moved = with_water(state, position=position)
            return jnp.sum(observe.interpolate(scene, moved, "water", "pressure", places, order=order) ** 2)

        found = observe.interpolate(scene, state, "water", "pressure", points, order=order)
        assert found[0] == 0.0 and np.all(np.isfinite(found))
        slopes = jax.jit(jax.grad(total, argnums=(0, 1)))(state.systems["water"]["position"], jnp.asarray(points))
        assert all(np.all(np.isfinite(slope)) for slope in slopes)
        assert np.all(slopes[1][0] == 0.0)


@pytest.mark.parametrize("order", [0, 1])
def test_derivative_of_interpolation_is_that_of_differences(order):
    scene = basin(sound_speed=30.0)
    state = sph.initial_state(scene)
    x = state.systems["water"]["position"]
    direction = jnp.asarray(np.random.default_rng(0).normal(size=x.shape))

    def at(s):
        moved = with_water(state, position=x + s * direction)
        return jnp.sum(observe.interpolate(scene, moved, "water", "pressure", POINTS, order=order))

    step = 1e-6
    # central differences: their error is of step^2, and rounding leaves 1e-16 / step
    at = jax.jit(at)
    assert jax.jit(jax.grad(at))(0.0) == pytest.approx(float(at(step) - at(-step)) / (2 * step), rel=1e-7)


def test_chunks_give_what_one_sum_gives(monkeypatch):
    scene = basin()
    state = sph.initial_state(scene)
    points = observe.line((0.0, 0.1), (1.6, 0.7), 23)
    whole = observe.interpolate(scene, state, "water", "pressure", points)
    monkeypatch.setattr("jaxsph.observe.fields.CHUNK", 4 * scene["water"].n_particles)
    chunked = observe.interpolate(scene, state, "water", "pressure", points)
    np.testing.assert_allclose(chunked, whole, rtol=1e-13)  # sums of another order
