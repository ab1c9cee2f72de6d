"""A trajectory is probed at places and times between particles and saves, and drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import beam, block
from PIL import Image

import jaxsph as sph
from jaxsph import plot, pytree
from jaxsph.plot.moments import _turn
from jaxsph.plot.run import STRUCTURE_COLORS
from jaxsph.trajectory import interpolation

POLYNOMIAL = np.array([0.3, -1.0, 4.0, 20.0])  # of time: 1, t, t^2, t^3
TIMES = np.linspace(0.0, 0.5, 6)


def derivative(order, t):
    return np.polynomial.Polynomial(POLYNOMIAL).deriv(order)(t) if order else np.polynomial.Polynomial(POLYNOMIAL)(t)


def affine(x):
    """A displacement that is affine in space; everything moves by it, times a polynomial in time."""
    return x @ np.array([[0.1, 0.3], [-0.2, 0.05]]).T + np.array([0.5, -0.1])


def made(scale=affine):
    """A trajectory whose motion is known."""
    scene = sph.Scene(block(2, disorder=0.1))
    shape = scale(scene["block"].particles.positions)
    fields = {
        name: jnp.asarray(derivative(order, TIMES)[:, None, None] * shape)
        for order, name in enumerate(("displacement", "velocity", "acceleration"))
    }
    start = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(TIMES)), sph.initial_state(scene))
    return sph.Trajectory(scene, pytree.replace(start, time=jnp.asarray(TIMES), systems={"block": fields}), 0.1)


def test_fields_positions_and_the_final_state():
    run = made()
    np.testing.assert_array_equal(run.times, TIMES)
    np.testing.assert_array_equal(run.final.systems["block"]["velocity"], run["block"]["velocity"][-1])
    x = run.scene["block"].particles.positions
    np.testing.assert_allclose(run.positions("block"), x + run["block"]["displacement"])
    with pytest.raises(KeyError, match=r"no system is called 'plate'; there are \['block'\]"):
        run["plate"]


@pytest.mark.parametrize(
    "at", [(0.0, 0.0), (0.03, -0.21), (0.33, 0.3)], ids=["inside", "elsewhere", "outside a little"]
)
def test_probe_is_exact_for_affine_displacements(at):
    probe = made().probe("block", at)
    for order, name in enumerate(("displacement", "velocity", "acceleration")):
        expected = derivative(order, TIMES)[:, None] * affine(np.array(at))
        # moving least squares of some ten particles: some ten roundings
        np.testing.assert_allclose(
            getattr(probe, name), expected, rtol=0, atol=1e-13 * np.abs(derivative(order, TIMES)).max()
        )
    np.testing.assert_array_equal(probe.times, TIMES)


def test_probe_of_a_particle_is_the_particle():
    run = made(scale=np.sin)
    x = run.scene["block"].particles.positions
    np.testing.assert_array_equal(run.probe("block", x[5]).displacement, run["block"]["displacement"][:, 5])


def test_probe_between_particles_is_differentiable():
    run = made()
    slope = jax.grad(lambda scale: jnp.sum(pytree.replace(run, states=jax.tree.map(
        lambda leaf: scale * leaf if leaf.dtype == float else leaf, run.states)).probe("block", (0.0, 0.0)).velocity)
    )(1.0)  # fmt: skip
    assert slope == pytest.approx(float(jnp.sum(run.probe("block", (0.0, 0.0)).velocity)), rel=1e-12)


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ((1.0, 0.0), r"0 particles are within two spacings of \[1\. 0\.\]; the nearest is at .* m away"),
        ((0.0, 0.0, 0.0), "must have 2 components"),
    ],
)
def test_places_without_particles_are_refused(at, said):
    with pytest.raises(ValueError, match=said):
        made().probe("block", at)


def test_a_place_beside_a_line_of_particles_is_refused():
    line = sph.box((0, 0), (1, 0.1), 0.1)
    with pytest.raises(ValueError, match="lie on a line"):
        interpolation(line, (0.5, 0.1))


def test_other_times_are_exact_for_cubic_motion():
    run, wanted = made(), np.array([0.0, 0.04, 0.1, 0.3712, 0.5])
    found = run.at(wanted)
    shape = affine(run.scene["block"].particles.positions)
    np.testing.assert_allclose(found.times, wanted)
    for order, name in enumerate(("displacement", "velocity", "acceleration")):
        # displacements are cubic, velocities quadratic, accelerations linear in time: each is exact
        expected = derivative(order, wanted)[:, None, None] * shape
        np.testing.assert_allclose(found["block"][name], expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_error_between_times_falls_with_the_fourth_power():
    errors = []
    for n in (11, 21):
        t = np.linspace(0, 1, n)
        scene = sph.Scene(block(2))
        one = np.ones_like(scene["block"].particles.positions)
        waves = {"displacement": np.sin(6 * t), "velocity": 6 * np.cos(6 * t), "acceleration": -36 * np.sin(6 * t)}
        fields = {name: jnp.asarray(wave[:, None, None] * one) for name, wave in waves.items()}
        states = jax.tree.map(lambda leaf, n=n: jnp.stack([leaf] * n), sph.initial_state(scene))
        run = sph.Trajectory(scene, pytree.replace(states, time=jnp.asarray(t), systems={"block": fields}), 0.1)
        wanted = np.linspace(0, 1, 101)
        errors.append(np.abs(run.at(wanted)["block"]["displacement"][:, 0, 0] - np.sin(6 * wanted)).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1), "the next order is (6 / 20)^2, a few per cent"


def test_other_times_of_a_traced_run():
    run, wanted = made(), np.array([0.04, 0.3712])
    traced = jax.jit(lambda r: r.at(wanted).states.systems)(run)
    np.testing.assert_allclose(
        traced["block"]["velocity"], run.at(wanted)["block"]["velocity"], atol=1e-13
    )  # round-off


@pytest.mark.parametrize("times", [[-0.1, 0.2], [0.2, 0.51], [0.7]])
def test_times_beyond_the_run_are_refused(times):
    with pytest.raises(ValueError, match=r"were asked for; the run has 0 to 0\.5 s"):
        made().at(times)


@pytest.fixture(scope="module")
def swing():
    return sph.simulate(beam(), 0.02, 0.01)


@pytest.mark.parametrize("color", [None, *STRUCTURE_COLORS])
def test_snapshot_shows_what_is_asked_for(swing, color):
    figure = plot.snapshot(swing, "beam", color=color)
    disks = figure.axes[0].collections[0]
    np.testing.assert_allclose(np.asarray(disks.get_offsets()), swing.positions("beam")[-1])
    assert figure.axes[0].get_title(loc="left") == "beam   t = 0.020 s"
    if color is None:
        assert disks.get_array() is None
        return
    state = swing.final
    if color in ("von_mises", "pk1"):
        stress = np.asarray(sph.observe.stresses(swing.scene, state, "beam")[color])
        expected = stress if stress.ndim == 1 else np.linalg.norm(stress, axis=(1, 2))
        assert np.max(expected) > 0
    else:
        expected = np.linalg.norm(state.systems["beam"][color], axis=1)
    np.testing.assert_allclose(
        np.asarray(disks.get_array()), expected, rtol=1e-12
    )  # the same operations, compiled apart


def test_snapshot_of_another_state(swing):
    disks = plot.snapshot(swing, "beam", index=0, color=None).axes[0].collections[0]
    np.testing.assert_array_equal(disks.get_offsets(), swing.scene["beam"].particles.positions)


def test_animation_has_a_frame_for_each_state(swing, tmp_path):
    swing.animate(tmp_path / "beam.gif", resolution=40)
    with Image.open(tmp_path / "beam.gif") as film:
        assert getattr(film, "n_frames", 1) == 3


def test_pictures_of_what_is_not_there_are_refused(swing, tmp_path):
    with pytest.raises(ValueError, match=r"color 'pressure' is not known; choose one of .*'von_mises'"):
        plot.snapshot(swing, "beam", color="pressure")
    with pytest.raises(ValueError, match="index 3: the run has 3 saved states, from 0 to 2"):
        plot.snapshot(swing, "beam", index=3)
    with pytest.raises(KeyError, match="no system is called 'plate'"):
        swing.animate(tmp_path / "a.gif", "plate")


def test_a_traced_run_has_no_numbers_outside_of_its_times():
    """Where a plain one raises: its times are not known."""
    scene = sph.Scene(sph.Structure("block", sph.box((0, 0), (0.3, 0.3), 0.1), 1000.0, 1e6, 0.3, velocity=(1.0, 0.0)))

    def places(gravity):
        run = sph.simulate(scene.replace({"gravity": gravity}), 0.004, 0.001, time_step=1e-3)
        return run.at([0.002, 0.004, 0.0041]).states.systems["block"]["displacement"]

    found = jax.jit(places)(jnp.zeros(2))
    np.testing.assert_allclose(found[:2, :, 0], np.broadcast_to([[0.002], [0.004]], (2, 9)), rtol=1e-9)
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_states_at_other_times_are_whole(kind):
    """Each leaf has a time axis as long as the times that were asked for, so that all can be observed."""
    body = sph.box((0, 0), (0.3, 0.3), 0.1, dtype=kind)
    water = sph.Fluid("water", sph.box((1, 0), (0.4, 0.4), 0.1, dtype=kind), 1000.0, 20.0, velocity=(1.0, 0.0))
    scene = sph.Scene(sph.Structure("block", body, 1000.0, 1e6, 0.3, velocity=(1.0, 0.0)), water)
    run = sph.simulate(scene, 0.004, 0.001, time_step=1e-3).at([0.001, 0.0025])
    assert {np.shape(leaf)[0] for leaf in jax.tree.leaves(run.states)} == {2}
    seen = run.observe(lambda scene, state: state.systems["water"]["position"][0, 0])
    np.testing.assert_allclose(seen, [1.051, 1.0525], rtol=1e-6)  # a few roundings of 6e-8


def test_the_clock_does_not_drift_with_the_number_of_saves():
    """Motions and forces read it. Also of a run that is continued, with the same bits."""
    ball = sph.RigidBody("ball", sph.ball((0, 0), 0.1, 0.05, dtype=np.float32), 1000.0)
    scene = sph.Scene(ball)
    run = sph.simulate(scene, 0.3, 3e-5, time_step=3e-5)
    # a rounding of the last time, and one of the step in all 10,000; without the remainder it is off by 2e-5
    assert abs(float(run.times[-1]) - 0.3) < 0.3 * 2e-7
    half = sph.simulate(scene, 0.15, 3e-5, time_step=3e-5)
    rest = sph.simulate(scene, 0.15, 3e-5, time_step=3e-5, state=half.final)
    np.testing.assert_array_equal(np.asarray(rest.times), np.asarray(run.times)[5000:])


def test_moments_are_the_nearest_saved_states_on_one_scale():
    scene = sph.Scene(sph.Structure("block", sph.box((0, 0), (0.3, 0.3), 0.1), 1000.0, 1e6, 0.3, velocity=(1.0, 0.0)))
    run = sph.simulate(scene, 0.4, 0.1)
    figure = plot.moments(run, [0.0, 0.31, 0.4], columns=3)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in panels] == ["t = 0.000 s", "t = 0.300 s", "t = 0.400 s"]
    assert len({axes.get_xlim() for axes in panels}) == 1
    with pytest.raises(ValueError, match="2 times and 1 axes"):
        plot.moments(run, [0.0, 0.1], axes=panels[:1])
    with pytest.raises(ValueError, match="for runs in 3D"):
        plot.moments(run, [0.0], view=(0, 0))


@pytest.mark.parametrize(
    ("view", "right", "up", "eye"),
    [((0, 0), (1, 0, 0), (0, 0, 1), (0, -1, 0)), ((90, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)),
     ((0, 90), (1, 0, 0), (0, 1, 0), (0, 0, 1))],
)  # fmt: skip
def test_a_view_turns_to_right_up_and_the_eye(view, right, up, eye):
    """(0, 0) looks along y with z upwards, 90 degrees of azimuth along -x, 90 of elevation down."""
    np.testing.assert_allclose(_turn(*view)(np.array([right, up, eye], float)), np.eye(3), atol=1e-15)
