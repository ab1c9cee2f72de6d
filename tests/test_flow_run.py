"""Runs with fluids: continued, saved, in both modes, batched, in both precisions, and against diffrax."""

import jax
import numpy as np
import pytest
from fluids import column, periodic

import jaxsph as sph
from jaxsph import surroundings
from jaxsph.dynamics import prepare
from jaxsph.files import read_state, read_trajectory
from jaxsph.plain_run import _start
from jaxsph.pytree import replace

FIELDS = ("position", "velocity", "acceleration", "density_deviation", "density_gradient")


@pytest.fixture(scope="module")
def scene():
    return column()


@pytest.fixture(scope="module")
def whole(scene):
    return sph.simulate(scene, 0.08, 0.02)


def test_a_run_is_continued_bit_for_bit_and_read_back(scene, whole, tmp_path):
    half = sph.simulate(scene, 0.04, 0.02, out=tmp_path / "half.vtkhdf")
    times, systems, about = read_trajectory(tmp_path / "half.vtkhdf")
    np.testing.assert_array_equal(times, half.times)
    for field in ("position", "velocity", "acceleration", "density_deviation"):
        np.testing.assert_array_equal(systems["water"][field], half["water"][field])
    deviation = np.asarray(half["water"]["density_deviation"])
    # sums and products of some roundings
    np.testing.assert_allclose(systems["water"]["density"], 1000 + deviation, rtol=1e-14)
    np.testing.assert_allclose(systems["water"]["pressure"], 400 * deviation, rtol=1e-12, atol=1e-9)
    assert about["units"]["pressure"] == "Pa" and about["units"]["density"] == "kg/m^3"
    np.testing.assert_array_equal(systems["tank"]["position"][-1], scene["tank"].particles.positions)
    read = read_state(tmp_path / "half.vtkhdf", sph.initial_state(scene), scene)
    for start in (half.final, read):
        rest = sph.simulate(scene, 0.04, 0.02, state=start)
        for field in FIELDS:
            np.testing.assert_array_equal(rest["water"][field], whole["water"][field][2:])
        np.testing.assert_array_equal(rest.times, whole.times[2:])


def test_what_all_particles_share_is_not_gathered_in_a_run(scene):
    """A run starts in a compiled function, which can't see that masses are alike; the steps must know it all the same.

    Not of particles that are heavier under pressure.
    """
    water = replace(scene.fluids[0], pressure=np.linspace(0, 1, 36))
    heavier = replace(scene, systems=(water, *scene.walls))
    for one, shape in ((scene, ()), (heavier, (36,))):
        found, state = sph.topologies(one), sph.initial_state(one)
        step = {"n_steps": 1, "rebuild_every": 1, "integrator": sph.KickDriftKick(), "forward_mode": False}
        references, _, _ = _start(one, found, state, step)
        assert np.shape(references["water"].mass) == shape
        assert np.shape(references["tank"].cells) == ()
        # both are means in float64 of products that differ by a rounding
        np.testing.assert_allclose(references["water"].mass, prepare(one, found)["water"].mass, rtol=1e-15)


def test_what_a_run_does(scene, whole):
    """The water moves, stays in the tank, and its density changes as the impact says: rho v / c."""
    x = np.asarray(whole["water"]["position"])
    assert x[-1, :, 0].max() > x[0, :, 0].max() + 0.02 and x[-1, :, 1].mean() < x[0, :, 1].mean()
    assert x.min() > 0, "nobody enters the wall"
    # thrown off the left wall at .5 m/s: 25 kg/m^3 there, and a third more where waves cross
    assert np.abs(whole["water"]["density_deviation"]).max() < 1000 * 0.5 / 20 * 4 / 3
    assert whole.final.step * whole.time_step == pytest.approx(0.08)


@pytest.mark.slow
def test_traced_runs_are_the_same_in_both_modes(scene, whole):
    found = sph.topologies(scene)

    def of(viscosity, mode):
        run = sph.simulate(
            scene.replace({"water.viscosity": viscosity}),
            0.08,
            0.02,
            time_step=whole.time_step,
            mode=mode,
            topologies_of_scene=found,
        )
        return run["water"]

    for mode in ("forward", "reverse"):
        fields = jax.jit(of, static_argnames="mode")(1.0, mode)
        for field in FIELDS:
            # the same operations, compiled apart, for a few dozen steps
            largest = np.abs(whole["water"][field]).max()
            np.testing.assert_allclose(fields[field], whole["water"][field], rtol=0, atol=1e-10 * largest)
    viscosities = np.array([0.5, 1.0, 2.0])
    many = jax.jit(jax.vmap(lambda v: of(v, "forward")))(viscosities)
    for field in FIELDS:
        largest = np.abs(whole["water"][field]).max()
        np.testing.assert_allclose(many[field][1], whole["water"][field], rtol=0, atol=1e-10 * largest)
    shear = np.std(np.asarray(many["velocity"])[:, -1, :, 0], axis=1)
    assert shear[0] > shear[1] > shear[2], "the more viscous, the less sheared"


@pytest.mark.slow
def test_float32_is_close_to_float64():
    """Roundings of 6e-8 for 30 steps, of pressures that are c^2 = 400 times as sensitive."""
    single, double = (sph.simulate(column(kind), 0.03, time_step=1e-3)["water"] for kind in (np.float32, np.float64))
    for field, tolerance in (("position", 1e-6), ("velocity", 1e-4), ("density_deviation", 1e-3)):
        assert single[field].dtype == np.float32
        assert np.abs(single[field] - double[field]).max() < tolerance * np.abs(double[field]).max(), field


@pytest.mark.slow
def test_small_steps_go_to_what_diffrax_finds():
    """Second order: a quarter of the error with half the step."""
    scene = column(effects=[], velocity=(0.2, 0.0))
    tight = sph.Diffrax(relative_tolerance=1e-8, absolute_tolerance=1e-9)
    exact = sph.simulate(scene, 0.02, integrator=tight).final.systems["water"]
    errors = []
    for step in (1e-3, 5e-4):
        run = sph.simulate(scene, 0.02, time_step=step).final.systems["water"]
        errors.append([float(np.abs(run[k] - exact[k]).max()) for k in ("position", "density_deviation")])
    for coarse, fine in zip(*errors, strict=True):
        # viscosity enters with the velocity of the half step, which is of first order but small here
        assert coarse / fine > 2.5
    assert errors[1][0] < 1e-5 * 0.3 and errors[1][1] < 0.1


@pytest.mark.slow
def test_small_steps_go_to_what_diffrax_finds_for_shifted_particles():
    """First order: a step takes the shift of the one before, the solver that of the moment."""
    flow = lambda x: np.stack([np.sin(2 * np.pi * x[:, 1]), np.zeros(len(x))], axis=1)  # noqa: E731
    scene = periodic(effects=[sph.ParticleShifting(1.0), sph.DensityDiffusion(0.1)], velocity=flow)
    tight = sph.Diffrax(relative_tolerance=1e-8, absolute_tolerance=1e-9)
    exact = sph.simulate(scene, 0.02, integrator=tight).final.systems["water"]
    errors = []
    for step in (5e-4, 2.5e-4):
        run = sph.simulate(scene, 0.02, time_step=step).final.systems["water"]
        errors.append([float(np.abs(run[k] - exact[k]).max()) for k in ("position", "velocity", "density_deviation")])
    for coarse, fine in zip(*errors, strict=True):
        assert 1.7 < coarse / fine < 2.4
    assert errors[1][0] < 1e-3 * 0.1, "a thousandth of the spacing"


def test_a_channel_may_be_hardly_longer_than_two_support_radii():
    """Lists of two sets have a wider skin than those of one where the period leaves room for it."""
    channel = sph.scenes.poiseuille(10)
    assert channel.domain is not None
    period = channel.domain.lengths[0]
    cutoff = 0.5 * period / (1.05 * (1 + surroundings.SKIN[2]))
    assert cutoff * (1 + surroundings.SKIN_BETWEEN_SETS * surroundings.SKIN[2]) > 0.5 * period
    wide = replace(channel, smoothing_length=cutoff / channel.kernel.support)
    found = sph.topologies(wide)
    assert found["water-water"].skin < found[f"water-{channel.walls[0].name}"].skin < 0.5 * period - cutoff


@pytest.mark.parametrize(
    "effects",
    [
        [sph.AcousticDamper(0.5)],
        [sph.TensileControl()],
        [sph.ParticleShifting(free_surface=True), sph.TensileControl(), sph.AcousticDamper(0.5)],
    ],
    ids=["damper", "tension", "all"],
)
def test_diffrax_takes_what_steps_remember_from_the_moment(effects):
    """Cover and rate of the density are those of the evaluation, whatever they were at the start: small steps agree."""
    scene = column(effects=effects, velocity=(0.2, 0.0))
    tight = sph.Diffrax(relative_tolerance=1e-7, absolute_tolerance=1e-8)
    exact = sph.simulate(scene, 4e-3, integrator=tight).final.systems["water"]
    errors = []
    for dt in (2e-4, 1e-4):
        run = sph.simulate(scene, 4e-3, time_step=dt).final.systems["water"]
        errors.append(float(np.abs(run["velocity"] - exact["velocity"]).max()))
    # of first order, by what a step takes from the one before
    assert errors[1] < 0.7 * errors[0] < 0.7 * 0.02
