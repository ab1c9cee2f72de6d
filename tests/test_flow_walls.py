"""Walls: what they take over from the fluid, against plain sums, and what they do in a run."""

import jax.numpy as jnp
import numpy as np
import pytest
from fluids import AllPairs, assert_equal, column, stirred, sums

import jaxsph as sph
from jaxsph import observe
from jaxsph.geometry import box
from jaxsph.pytree import replace

H = 0.075  # smoothing length of `column`


def swung(t, x):
    return 0.1 * t**2 * jnp.stack([jnp.ones_like(x[:, 0]), x[:, 0]], axis=1)


def test_hydrostatic_pressure_is_continued_exactly():
    """sum_f W (p_f + rho g . (x_w - x_f)) / sum_f W is p(x_w) for a linear p, wherever the neighbors are."""
    scene = column(viscosity=None, sound_speed=1e6, effects=[], pressure=sph.AdamiExtrapolation())
    x = np.asarray(scene["water"].particles.positions)
    profile = lambda x: 9810 * (0.3 - x[:, 1])  # noqa: E731
    systems = sph.initial_state(scene).systems
    systems = {**systems, "water": {**systems["water"], "density_deviation": jnp.asarray(profile(x) / 1e12)}}
    got = np.asarray(sums(scene, sph.topologies(scene), systems)["tank"]["pressure"])
    walls = np.asarray(scene["tank"].particles.positions)
    near = np.linalg.norm(walls[:, None] - x, axis=-1).min(axis=1) < 2 * H * 0.999
    assert near.sum() > 20
    # the density deviates by p / c^2 = 3e-9, a 3e-12 of rho
    np.testing.assert_allclose(got[near], profile(walls)[near], rtol=0, atol=1e-8 * 2943)
    np.testing.assert_array_equal(got[~near & (np.linalg.norm(walls[:, None] - x, axis=-1).min(axis=1) > 2 * H)], 0)


@pytest.mark.parametrize("factor", [None, 0.7])
def test_extrapolation_and_no_slip(factor):
    """Of an accelerated wall: pressure, with the dynamic part of approaching fluid, and 2 v_w - <v>."""
    model = sph.AdamiExtrapolation() if factor is None else sph.BernoulliExtrapolation(factor)
    scene = column(motion=swung, pressure=model, effects=[])
    state, t = stirred(scene), 0.3
    out = sums(scene, sph.topologies(scene), state.systems, t)["tank"]
    start = np.asarray(scene["tank"].particles.positions)
    along = np.stack([np.ones(len(start)), start[:, 0]], axis=1)
    fields = {key: np.asarray(value) for key, value in state.systems["water"].items()}
    pairs = AllPairs(start + 0.1 * t**2 * along, fields["position"], H)
    rho, velocity, acceleration = 1000 + fields["density_deviation"], 0.2 * t * along, 0.2 * along
    pull = np.array([0.0, -9.81]) - acceleration
    pressure = 400 * fields["density_deviation"] + rho * np.sum(pull[:, None] * pairs.offset, axis=-1)
    if factor is not None:
        approach = np.sum((velocity[:, None] - fields["velocity"]) * pairs.offset, axis=-1)
        pressure += 0.5 * factor * rho * np.minimum(approach, 0) ** 2 / pairs.squared
    weight = pairs.w.sum(axis=1)
    near = weight > 0
    assert 20 < near.sum() < len(start)
    assert_equal(out["pressure"][near], np.sum(pairs.w * pressure, axis=1)[near] / weight[near], 1e-11)
    slip = 2 * velocity[near] - (pairs.w @ fields["velocity"])[near] / weight[near, None]
    assert_equal(out["slip"][near], slip, 1e-11)
    np.testing.assert_array_equal(out["pressure"][~near], 0)
    np.testing.assert_allclose(out["slip"][~near], velocity[~near], rtol=1e-14)


MODELS = [sph.PressureMirroring(), sph.PressureZeroing(), sph.WallContinuity(), sph.WallSummation()]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_pressure_of_a_wall_in_the_forces(model):
    """-V_a V_w (p_a + p_w) grad W with the p_w of each model; what walls remember, as sums of their own."""
    scene = column(viscosity=None, effects=[], pressure=model)
    state = stirred(scene)
    systems = dict(state.systems)
    x, start = np.asarray(systems["water"]["position"]), np.asarray(scene["tank"].particles.positions)
    out = sums(scene, sph.topologies(scene), systems)
    rho = 1000 + np.asarray(systems["water"]["density_deviation"])
    m, p, volume = float(scene["water"].mass()), 400 * (rho - 1000), float(scene["water"].mass()) / rho
    own, across, walls = AllPairs(x, x, H), AllPairs(x, start, H), AllPairs(start, start, H)
    wall_volume = np.full(len(start), 0.05**2)
    wall_pressure = np.zeros(len(start))
    if isinstance(model, sph.WallContinuity):
        velocity = -np.asarray(systems["water"]["velocity"])
        # seen from the wall, which rests: v_w - v_f and the gradient turned around
        rate = 1000 * np.sum(-across.gradient * velocity[:, None] * volume[:, None, None], axis=(0, 2))
        assert_equal(out["tank"]["rate"], rate)
        deviation = np.asarray(systems["tank"]["density_deviation"])
    if isinstance(model, sph.WallSummation):
        deviation = m * (walls.w.sum(axis=1) + walls.w_at_zero) + m * across.w.sum(axis=0) - 1000
        assert_equal(out["tank"]["summed"], deviation)
    if isinstance(model, (sph.WallContinuity, sph.WallSummation)):
        wall_pressure = np.maximum(400 * deviation, 0)
        assert wall_pressure.max() > 0 and wall_pressure.min() == 0, "clipped, so that it never pulls"
        wall_volume = wall_volume * 1000 / (1000 + wall_pressure / 400)
    both = p[:, None] + (p[:, None] if isinstance(model, sph.PressureMirroring) else wall_pressure)
    force = -np.sum((volume[:, None] * wall_volume * both)[..., None] * across.gradient, axis=1)
    force -= np.sum((volume[:, None] * volume * (p[:, None] + p))[..., None] * own.gradient, axis=1)
    assert_equal(m * (out["water"]["acceleration"] + np.array([0.0, 9.81])), force)


def shaken(t, x):
    return jnp.stack([0.05 * (1 - jnp.cos(10 * t)) + 0 * x[:, 0], 0 * x[:, 0]], axis=1)


def test_a_moving_wall_is_followed_and_pushes():
    scene = column(motion=shaken, velocity=(0.0, 0.0))
    run = sph.simulate(scene, 0.2, 0.05)
    start = scene["tank"].particles.positions
    for i, t in enumerate(np.asarray(run.times)):
        # the time of a step is a sum of a few roundings
        np.testing.assert_allclose(run["tank"]["position"][i], start + shaken(t, start), atol=1e-14)
        np.testing.assert_allclose(run["tank"]["velocity"][i, :, 0], 0.5 * np.sin(10 * t), atol=1e-14)
    np.testing.assert_array_equal(run.positions("tank"), run["tank"]["position"])
    x = np.asarray(run["water"]["position"])[-1, :, 0]
    assert x.min() > float(shaken(0.2, start)[0, 0]), "the left wall came to .07 m and took the water along"


@pytest.mark.parametrize("pressure", MODELS[2:])
def test_other_models_of_walls_turn_water_back(pressure):
    """A block that falls onto the bottom: none gets further in than half a spacing, and it comes to rest or bounces."""
    scene = column(pressure=pressure, velocity=(0.0, -1.0), effects=[sph.ArtificialViscosity(0.1)])
    run = sph.simulate(scene.replace({"gravity": (0.0, 0.0)}), 0.04, 0.02)
    x, v = (np.asarray(run["water"][k]) for k in ("position", "velocity"))
    assert x.min() > -0.5 * 0.05
    assert v[-1, :, 1].mean() > -0.2
    if "density_deviation" in run["tank"]:
        assert np.asarray(run["tank"]["density_deviation"]).max() > 1
    assert np.all(np.isfinite(v))


@pytest.mark.parametrize("factor", [None, 0.7])
def test_a_body_force_is_continued_as_gravity_is(factor):
    """The same pull, given as the one or as the other: the same pressures of walls, sensors and accelerations."""
    model = sph.AdamiExtrapolation() if factor is None else sph.BernoulliExtrapolation(factor)
    fallen = column(pressure=model, effects=[])
    pulled = sph.Scene(
        *fallen.systems,
        effects=[sph.BodyForce(lambda x, t: jnp.array([[0.0], [-9.81 * (1 + t)]]))],
        domain=fallen.domain,
        smoothing_length=fallen.smoothing_length,
    )
    fallen = fallen.replace({"gravity": (0.0, -9.81 * 1.5)})
    state, found = stirred(fallen), sph.topologies(fallen)
    by_gravity, by_force = (sums(scene, found, state.systems, 0.5) for scene in (fallen, pulled))
    for name, field in (("tank", "pressure"), ("water", "acceleration")):
        assert_equal(by_force[name][field], by_gravity[name][field])
    state = replace(state, time=jnp.asarray(0.5))
    sensor = lambda scene: observe.wall_pressure(scene, state, "tank", [[0.1, 0.0]], normal=(0.0, 1.0))  # noqa: E731
    np.testing.assert_allclose(sensor(pulled), sensor(fallen), rtol=1e-12)


def test_friction_at_a_wall_is_that_of_a_linear_profile():
    """v = G y in the fluid, at rest at the wall y = 0: no force on the rows beside it, the stress mu G on the wall."""
    dx, mu, shear = 0.05, 2.0, 3.0
    profile = lambda x: x[:, ::-1] * [shear, 0.0]  # noqa: E731
    water = sph.Fluid("water", box((0, 0), (0.6, 0.4), dx), 1000.0, 20.0, mu, velocity=profile)
    floor = sph.Wall("floor", box((0, -0.2), (0.6, 0.2), dx))
    scene = sph.Scene(water, floor, domain=sph.Domain((0, -1), (0.6, 1), (True, False)), smoothing_length=1.3 * dx)
    out = sums(scene, sph.topologies(scene), sph.initial_state(scene).systems)
    force = np.asarray(out["water"]["acceleration"])[:, 0] * 1000.0 * dx**2 / (mu * shear * 0.6)
    # The mean of the neighbors stands for the velocity at the wall, which costs .04 of the stress in all. A wall with
    # its own velocity, or half of the viscosity, transmits half of it.
    assert np.abs(force.reshape(12, 8).sum(axis=0)[:5]).max() < 0.02
    assert force.sum() == pytest.approx(-1.0, abs=0.05)
