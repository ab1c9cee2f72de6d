"""What is observed of a fluid is what hydrostatics, geometry and conservation say of it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import observe, pytree
from jaxsph.geometry import tank
from jaxsph.scenes.taylor_green import taylor_green

GRAVITY, REST, DX = 10.0, 1000.0, 0.1
WIDTH, HEIGHT = 1.6, 0.8


def basin(kind: Any = np.float64, d=2, width=WIDTH, **changes: Any) -> sph.Scene:
    """Water at rest in a tank whose corner is the origin, with its hydrostatic pressure."""
    size = (width, HEIGHT) if d == 2 else (width, 0.6, HEIGHT)
    down = -GRAVITY * np.eye(d)[-1]
    about: dict[str, Any] = {
        "density": REST,
        "sound_speed": 40.0,
        "pressure": lambda x: REST * GRAVITY * (HEIGHT - x[:, -1]),
    }
    motion = changes.pop("motion", None)
    water = sph.Fluid("water", sph.box(np.zeros(d), size, DX, dtype=kind), **{**about, **changes})
    walls = sph.Wall("tank", tank(np.zeros(d), size, DX, 4, dtype=kind), motion=motion)
    return sph.Scene(water, walls, gravity=down, smoothing_length=1.75 * DX)


def with_water(state, **fields):
    return pytree.replace(state, systems={**state.systems, "water": {**state.systems["water"], **fields}})


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


def test_vorticity_of_a_rotation_is_twice_its_rate():
    for d in (2, 3):
        scene = basin(d=d, width=0.8)
        x = scene["water"].particles.positions
        spin = np.array([0.3, -0.5, 0.7])
        velocity = 0.7 * np.stack([-x[:, 1], x[:, 0]], axis=1) if d == 2 else np.cross(spin, x)
        state = with_water(sph.initial_state(scene), velocity=jnp.asarray(velocity))
        expected = 1.4 if d == 2 else np.broadcast_to(2 * spin, x.shape)
        found = jax.jit(observe.vorticity, static_argnums=2)(scene, state, "water", sph.topologies(scene))
        # corrected gradients are exact for affine fields; a sum over a hundred neighbors
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=0, atol=1e-12)


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
    points, depth = [(0.8, 0.0), (0.0, 0.4), (WIDTH, 0.2)], np.array([0.8, 0.4, 0.6])
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
        assert half[0] == pytest.approx(0.5 * HEIGHT, rel=4e-3), "without sides a place at the wall sees half"


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


def test_energies_and_momenta_of_a_fluid():
    scene = basin()
    state = sph.initial_state(scene)
    fluid, x = scene["water"], np.asarray(scene["water"].particles.positions)
    mass = np.asarray(fluid.mass())
    spin = 0.7
    velocity = spin * np.stack([-x[:, 1], x[:, 0]], axis=1) + np.array([1.0, -2.0])
    out = observe.energies(scene, with_water(state, velocity=jnp.asarray(velocity)))
    # sums over a hundred particles
    assert out["kinetic"] == pytest.approx(0.5 * np.sum(mass * np.sum(velocity**2, axis=1)), rel=1e-13)
    assert out["gravitational"] == pytest.approx(GRAVITY * np.sum(mass * x[:, 1]), rel=1e-13)
    stored = fluid.state_equation.energy(np.asarray(fluid.initial_deviation()), REST, 40.0)
    assert out["internal"] == pytest.approx(float(np.sum(mass * stored)), rel=1e-13)
    assert out["elastic"] == 0.0
    parts = sum(out[name] for name in ("kinetic", "elastic", "internal", "gravitational"))
    assert out["total"] == pytest.approx(float(parts), rel=1e-14)
    moving = with_water(state, velocity=jnp.asarray(velocity))
    np.testing.assert_allclose(observe.linear_momentum(scene, moving), mass @ velocity, rtol=1e-13)
    about = np.array([0.3, 0.2])
    arm = x - about
    expected = np.sum(mass * (arm[:, 0] * velocity[:, 1] - arm[:, 1] * velocity[:, 0]))
    assert observe.angular_momentum(scene, moving, about) == pytest.approx(expected, rel=1e-13)
    with pytest.raises(ValueError, match="a periodic domain has none"):
        observe.angular_momentum(taylor_green(8), sph.initial_state(taylor_green(8)))


def drop():
    """A free elliptic drop without viscosity or effects: nothing is lost."""
    ball = sph.ball((0.0, 0.0), 0.5, 0.1)
    water = sph.Fluid("water", ball, density=REST, sound_speed=20.0, velocity=lambda x: x * np.array([1.0, -1.0]))
    return sph.Scene(water, smoothing_length=0.175, domain=sph.Domain((-2, -2), (2, 2)))


def test_the_total_energy_of_an_ideal_fluid_is_kept():
    """Kinetic energy goes into compression and back. Halving the time step leaves a quarter of what is lost."""
    lost, exchanged = [], 0.0
    for factor in (1.0, 0.5):
        scene = drop()
        step = 0.25 * factor * sph.stable_time_step(scene)
        energies = sph.simulate(scene, 0.06, 0.01, time_step=step).observe(observe.energies)
        assert energies["total"].shape == (7,)
        lost.append(np.max(np.abs(energies["total"] - energies["total"][0])))
        exchanged = np.ptp(energies["internal"])
    assert lost[1] < 0.35 * lost[0] and lost[0] < 0.05 * exchanged, (lost, exchanged)


def test_observers_under_vmap_and_jit_and_in_a_loss():
    scene = drop()
    step = 0.9 * sph.stable_time_step(scene)
    found = sph.topologies(scene)

    def seen(scene, state):
        sides = observe.interpolate(scene, state, "water", "pressure", [[0.1, 0.0]], order=1)
        height = observe.free_surface_height(scene, state, "water", [0.0])
        return {"front": observe.surge_front(scene, state, "water", blur=0.05), "p": sides, "h": height}

    run = sph.simulate(scene, 0.02, 0.01, time_step=step)
    mapped = jax.jit(jax.vmap(seen, (None, 0)))(scene, run.states)
    for name, value in run.observe(seen).items():
        np.testing.assert_allclose(value, mapped[name], rtol=1e-12)  # sums of another order

    def loss(c):
        other = scene.replace({"water.sound_speed": c})
        run = sph.simulate(other, 0.02, 0.01, time_step=step, topologies_of_scene=found, max_speed=2.0)
        return sum(jnp.sum(value) for value in run.observe(seen).values())

    value = jax.jit(jax.value_and_grad(loss))
    differences = float(value(20.01)[0] - value(19.99)[0]) / 0.02
    assert value(20.0)[1] == pytest.approx(differences, rel=1e-4)  # of the second order in 5e-4
