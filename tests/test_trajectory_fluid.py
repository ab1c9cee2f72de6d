"""A trajectory of fluids and walls is probed at places and at times between saves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import pytree
from jaxsph.geometry import tank

PERIOD, SPEED, TIMES = 1.0, np.array([0.9, -0.3]), np.linspace(0.0, 1.0, 6)


def drifting(effects=(), periodic=True):
    """Fluid whose particles move along parabolas that are known, through the borders of a periodic box."""
    water = sph.Fluid("water", sph.box((0, 0), (PERIOD, PERIOD), 0.125), 1.0, 10.0, velocity=SPEED)
    domain = sph.Domain((0, 0), (PERIOD, PERIOD), periodic=True) if periodic else sph.Domain((-3, -3), (3, 3))
    scene = sph.Scene(water, domain=domain, effects=list(effects))
    start = water.particles.positions
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(TIMES)), sph.initial_state(scene))
    fields = dict(states.systems["water"])
    place = start + path(TIMES)[:, None]
    fields["position"] = jnp.asarray(place % PERIOD if periodic else place)
    fields["velocity"] = jnp.broadcast_to(SPEED + (2 * TIMES[:, None] * 0.2)[:, None], place.shape)
    fields["density_deviation"] = jnp.asarray(TIMES[:, None] * np.ones(len(start)))
    return sph.Trajectory(scene, pytree.replace(states, time=jnp.asarray(TIMES), systems={"water": fields}), 0.1)


def path(t):
    return t[:, None] * SPEED + 0.2 * t[:, None] ** 2


@pytest.mark.parametrize("periodic", [True, False])
def test_other_times_of_a_fluid(periodic):
    run, wanted = drifting(periodic=periodic), np.array([0.0, 0.05, 0.33, 0.9, 1.0])
    found = run.at(wanted)["water"]
    exact = run.scene["water"].particles.positions + path(wanted)[:, None]
    apart = np.asarray(found["position"]) - exact
    if periodic:
        apart -= np.round(apart)
        assert np.all((found["position"] >= 0) & (found["position"] <= PERIOD))
    # cubic interpolation is exact for parabolas, linear for what is linear; round-off of numbers of size 1
    np.testing.assert_allclose(apart, 0.0, atol=1e-14)
    np.testing.assert_allclose(found["velocity"][:, 0, 0], SPEED[0] + 0.4 * wanted, rtol=1e-14)
    np.testing.assert_allclose(found["density_deviation"][:, 3], wanted, rtol=1e-14, atol=1e-15)


def test_shifted_particles_are_interpolated_linearly():
    run = drifting([sph.ParticleShifting(1.0)])
    between = run.at([0.1])["water"]["position"][0]
    middle = 0.5 * (path(TIMES[:1]) + path(TIMES[1:2]))
    apart = np.asarray(between) - run.scene["water"].particles.positions - middle
    np.testing.assert_allclose(apart - np.round(apart), 0.0, atol=1e-14)


def test_probe_of_a_fluid_follows_a_particle_through_the_border():
    run = drifting()
    probe = run.probe("water", (0.94, 0.07))
    np.testing.assert_allclose(probe.displacement, path(TIMES), rtol=0, atol=1e-14)
    np.testing.assert_allclose(probe.velocity, run["water"]["velocity"][:, 0], rtol=1e-15)
    with pytest.raises(ValueError, match=r"a point of the fluid is at most a spacing of 0\.125 m from one"):
        run.probe("water", (1.3, 0.5))


def test_moving_walls_are_where_their_motion_puts_them():
    motion = lambda t, x: jnp.stack([jnp.sin(3 * t) + 0 * x[:, 0], 0 * x[:, 1]], axis=1)  # noqa: E731
    wall = sph.Wall("tank", tank((0, 0), (0.5, 0.5), 0.125, 2), motion=motion)
    scene = sph.Scene(sph.Fluid("water", sph.box((0, 0), (0.5, 0.25), 0.125), 1.0, 10.0), wall)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), sph.initial_state(scene))
    run = sph.Trajectory(scene, pytree.replace(states, time=jnp.array([0.0, 1.0])), 0.1)
    found = run.at([0.3])["tank"]
    moved = np.asarray(found["position"])[0] - wall.particles.positions
    np.testing.assert_allclose(moved, np.broadcast_to([np.sin(0.9), 0.0], moved.shape), atol=1e-15)
    np.testing.assert_allclose(found["velocity"][0, :, 0], 3 * np.cos(0.9), rtol=1e-14)
    with pytest.raises(ValueError, match="'tank' is a wall, which moves as prescribed"):
        run.probe("tank", (0.0, 0.0))


def test_structures_in_float32_keep_their_remainder():
    body = sph.Structure("body", sph.box((0, 0), (0.3, 0.3), 0.1, dtype=np.float32), 1e3, 1e6, 0.3)
    scene = sph.Scene(body)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), sph.initial_state(scene))
    rest = {"remainder": jnp.asarray(np.linspace(0, 2e-9, 3, dtype=np.float32)[:, None, None] * np.ones((9, 2), "f"))}
    systems = {"body": {**states.systems["body"], **rest}}
    run = sph.Trajectory(scene, pytree.replace(states, time=jnp.arange(3, dtype=np.float32), systems=systems), 0.1)
    found = run.at([0.0, 0.5, 2.0])["body"]["remainder"]
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[:, 0, 0], [0.0, 5e-10, 2e-9], rtol=2e-7)  # float32's round-off
