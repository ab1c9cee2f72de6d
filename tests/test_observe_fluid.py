"""Sensors, fronts, heights and vorticity of a fluid are what hydrostatics and geometry say of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from basins import DX, GRAVITY, HEIGHT, REST, WIDTH, basin, with_water

import jaxsph as sph
from jaxsph import observe, pytree


def test_points_on_lines_and_planes():
    np.testing.assert_allclose(observe.line((0, 1), (2, 3), 3), [[0, 1], [1, 2], [2, 3]])
    points = observe.plane((0, 0, 1), (1, 0, 1), (0, 2, 1), (2, 3)).reshape(2, 3, 3)
    np.testing.assert_allclose(points[1, 2], [1, 2, 1])
    np.testing.assert_allclose(points[0, 1], [0, 1, 1])
    with pytest.raises(ValueError, match="n = 1 points; at least 2"):
        observe.line((0, 1), (2, 3), 1)
    with pytest.raises(ValueError, match=r"not start \(2,\), end \(3,\)"):
        observe.line((0, 1), (2, 3, 4), 5)


@pytest.mark.parametrize("width", [None, 0.2])
def test_wall_sensors_read_hydrostatic_pressure(width):
    scene = basin()
    state = sph.initial_state(scene)
    points, depth = [(0.8, 0.0), (0.0, 0.4), (WIDTH, 0.2), (0.0, 0.05)], np.array([0.8, 0.4, 0.6, 0.75])
    found = observe.wall_pressure(scene, state, "tank", points, width=width)
    # each particle's pressure is continued with its own density, which is up to 5e-3 above the rest density, over at
    # most a support radius of .35 m: 2e-3 of the pressure at the bottom
    np.testing.assert_allclose(found, REST * GRAVITY * depth, rtol=3e-3)


def test_a_plain_mean_reads_the_fluid_above_the_sensor():
    """On the bottom it is too low by the mean distance of a half-kernel: .2 to .35 support radii."""
    scene = basin()
    found = observe.wall_pressure(scene, sph.initial_state(scene), "tank", [(0.8, 0.0)], hydrostatic=False)
    lacking = (REST * GRAVITY * HEIGHT - float(found[0])) / (REST * GRAVITY * 3.5 * DX)
    assert 0.2 < lacking < 0.35


def test_a_wide_sensor_is_the_mean_over_its_face():
    """Of a pressure that is the square of the height over its middle, by a quadrature of the definition."""
    scene = basin(pressure=lambda x: 1e4 * (x[:, 1] - 0.4) ** 2, sound_speed=1e3)
    scene = scene.replace({"gravity": np.zeros(2)})
    state = sph.initial_state(scene)
    read = lambda width: float(observe.wall_pressure(scene, state, "tank", [(0.0, 0.4)], width=width)[0])  # noqa: E731
    across, along = np.meshgrid(np.linspace(0.0, 0.35, 71), np.linspace(-0.35, 0.35, 141))
    for width in (None, 1e-6, 0.2):
        outside = np.sign(along) * np.maximum(np.abs(along) - 0.5 * (width or 0.0), 0.0)
        weight = scene.kernel.w(np.stack([across, outside]), scene.smoothing_length)
        # ten particles for the kernel's half-width of two: some hundredths
        assert read(width) == pytest.approx(float(1e4 * np.sum(weight * along**2) / np.sum(weight)), rel=0.05)


@pytest.mark.parametrize("width", [None, 0.2])
@pytest.mark.parametrize("d", [2, 3])
def test_a_sensor_reads_the_share_of_what_is_before_it_that_is_wet(d, width):
    """Water at one pressure that withdraws from the wall; the share is the kernel's beyond it, by quadrature."""
    scene = basin(d=d, pressure=lambda x: 1e4 + 0 * x[:, 0], sound_speed=1e3)
    scene = scene.replace({"gravity": np.zeros(d)})
    state = sph.initial_state(scene)
    place = state.systems["water"]["position"]
    point = [(0.0, 0.4)] if d == 2 else [(0.0, 0.3, 0.4)]

    @jax.jit
    def read(gap):
        moved = with_water(state, position=place + gap * jnp.eye(d)[0])
        return observe.wall_pressure(scene, moved, "tank", point, width=width)[0] / 1e4

    reach = 0.5 * (width or 0.0) + 0.36
    before, *sides = np.meshgrid(np.linspace(0.0, 0.36, 73), *[np.linspace(-reach, reach, 113)] * (d - 1))
    beyond = np.maximum(np.sqrt(sum(side**2 for side in sides)) - 0.5 * (width or 0.0), 0.0)
    offset = np.stack([before, beyond] + [0 * before] * (d - 2))
    weight = np.array(scene.kernel.w(offset.reshape(d, -1), scene.smoothing_length)).reshape(before.shape)
    weight[:, 0] *= 0.5  # of the wall's face: the trapezoidal rule
    for gap in (0.0, 0.1, 0.2, 0.3, 0.4):
        share = np.sum(weight[before > gap - 1e-9]) / np.sum(weight)
        # rows of particles for a kernel of seven across: some hundredths
        assert float(read(gap)) == pytest.approx(min(share / 0.9, 1.0), abs=0.05), gap


def test_sensors_move_with_their_wall_and_are_dry_without_fluid():
    scene = basin(motion=lambda t, x: jnp.stack([5.0 * t**2 + 0 * x[:, 0], 0 * x[:, 1]], axis=1))
    state = sph.initial_state(scene)
    assert observe.wall_pressure(scene, state, "tank", [(0.0, 0.4)])[0] > 1000
    away = pytree.replace(state, time=jnp.asarray(2.0))
    assert observe.wall_pressure(scene, away, "tank", [(0.0, 0.4)])[0] == 0.0
    with pytest.raises(ValueError, match=r"points\[1\] = .* more than two spacings of 0.1 m"):
        observe.wall_pressure(scene, state, "tank", [(0.0, 0.4), (0.8, 0.4)])
    with pytest.raises(ValueError, match="'water' is a Fluid; sensors are in a Wall"):
        observe.wall_pressure(scene, state, "water", [(0.0, 0.4)])
    with pytest.raises(ValueError, match=r"of points\[0\] = .* points into the wall"):
        observe.wall_pressure(scene, state, "tank", [(0.0, 0.4)], normal=(-1.0, 0.0))
    with pytest.raises(ValueError, match=r"points\[0\] = .* has the wall on all sides"):
        observe.wall_pressure(scene, state, "tank", [(-0.2, 0.45)])


def test_derivative_of_a_sensor_in_the_gravity_is_the_depth():
    scene = basin()
    state = sph.initial_state(scene)

    def read(gravity):
        other = scene.replace({"gravity": jnp.stack([0 * gravity, -gravity])})
        return observe.wall_pressure(other, state, "tank", [(0.8, 0.0)], width=0.2)[0]

    # the part that is continued over the mean distance, a third of a support radius
    assert 0.2 < jax.grad(read)(GRAVITY) / (REST * 3.5 * DX) < 0.35


def test_the_front_is_the_edge_of_the_bulk_and_not_spray():
    scene = basin()
    state = sph.initial_state(scene)
    x = state.systems["water"]["position"]
    front = lambda state, **o: observe.surge_front(scene, state, "water", **o)  # noqa: E731
    assert front(state) == pytest.approx(WIDTH, rel=1e-14)
    assert front(state, axis=1) == pytest.approx(HEIGHT, rel=1e-14)
    assert front(state, backward=True) == pytest.approx(0.0, abs=1e-14)
    sprayed = with_water(state, position=x.at[20].set(jnp.array([4.0, 0.3])))
    assert front(sprayed) == pytest.approx(WIDTH, rel=1e-14)
    assert front(sprayed, spray=0.0) == pytest.approx(4.05, rel=1e-14)
    scattered = with_water(state, position=10.0 * x)
    assert np.isfinite(front(scattered)), "where all is spray there is a front too"
    # 8 foremost particles, and rows of 8 behind them at 1, 2, 3 ... spacings with weights exp(-k DX / blur)
    weights = np.exp(-np.arange(16) * 2.0)
    behind = DX * np.sum(np.arange(16) * weights) / np.sum(weights)
    assert front(state, blur=0.05) == pytest.approx(WIDTH - behind, rel=1e-12)


def test_the_front_moves_with_its_particles():
    scene = basin()
    state = sph.initial_state(scene)
    x = state.systems["water"]["position"]
    for blur in (None, 0.05):

        @jax.jit
        @jax.grad
        def slope(shift, blur=blur):
            return observe.surge_front(scene, with_water(state, position=x + shift), "water", blur=blur)

        np.testing.assert_allclose(slope(jnp.zeros(2)), [1.0, 0.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_height_of_still_water(d):
    scene = basin(d=d, width=0.8)
    state = sph.initial_state(scene)
    at = np.array([0.0, 0.13, 0.4, 0.75]) if d == 2 else np.array([[0.0, 0.0], [0.13, 0.3], [0.4, 0.6]])
    sides = (0.0, 0.8) if d == 2 else [(0.0, 0.8), (0.0, 0.6)]
    found = observe.free_surface_height(scene, state, "water", at, sides=sides)
    # compressed by the weight above: 2.5e-3 = rho g H / (2 rho c^2) of the mass is added with the pressure at the
    # start, so that volumes are exact; the kernel sum on a lattice at h = 1.75 dx is 1 to 2e-3 along each axis
    np.testing.assert_allclose(found, HEIGHT, rtol=4e-3)
    raised = observe.free_surface_height(scene, state, "water", at, sides=sides, bottom=-0.3)
    np.testing.assert_allclose(raised, found - 0.3, rtol=1e-13)
    if d == 2:
        half = observe.free_surface_height(scene, state, "water", at[:1])
        assert np.asarray(half)[0] == pytest.approx(0.5 * HEIGHT, rel=4e-3), (
            "without sides a place at the wall sees half"
        )


def test_height_follows_a_sloping_surface():
    scene = basin()
    state = sph.initial_state(scene)
    x = state.systems["water"]["position"]
    slope = 0.1
    stretch = 1 + slope * (x[:, 0] - 0.5 * WIDTH)
    volume = DX**2 * stretch
    mass = scene["water"].mass()
    tilted = with_water(
        state,
        position=jnp.stack([x[:, 0], x[:, 1] * stretch], axis=1),
        density_deviation=mass / volume - REST,
    )
    at = np.array([0.5, 0.8, 1.05])
    found = observe.free_surface_height(scene, tilted, "water", at)
    # a symmetric kernel keeps an affine height; as for still water
    np.testing.assert_allclose(found, HEIGHT * (1 + slope * (at - 0.5 * WIDTH)), rtol=4e-3)


def test_vorticity_of_a_rotation_is_twice_its_rate():
    for d in (2, 3):
        ball = sph.ball(np.zeros(d), 0.35, DX)
        box = sph.Domain(-0.5 * np.ones(d), 0.5 * np.ones(d))
        scene = sph.Scene(sph.Fluid("water", ball, REST, 40.0), smoothing_length=1.75 * DX, domain=box)
        x = scene["water"].particles.positions
        spin = np.array([0.3, -0.5, 0.7])
        velocity = 0.7 * np.stack([-x[:, 1], x[:, 0]], axis=1) if d == 2 else np.cross(spin, x)
        state = with_water(sph.initial_state(scene), velocity=jnp.asarray(velocity))
        expected = 1.4 if d == 2 else np.broadcast_to(2 * spin, x.shape)
        found = jax.jit(observe.vorticity, static_argnums=2)(scene, state, "water", sph.topologies(scene))
        # corrected gradients are exact for affine fields; a sum over a hundred neighbors
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=0, atol=1e-12)
