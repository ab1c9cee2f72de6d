"""Solids that touch: the pair force, its stable limit, what it conserves, and its derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import observe
from jaxsph.contact import TOUCHING, contact_time_step
from jaxsph.dynamics import prepare
from jaxsph.pair_sum import symmetry_error

DX = 0.05


def pairs(d=2, n=200, seed=1):
    """Random pairs closer than 1.2 spacings, of unlike volumes and reaches."""
    rng = np.random.default_rng(seed)
    sides = []
    for _ in range(2):
        about = {"volume": rng.uniform(0.2, 1, n) * DX**d, "spacing": rng.uniform(0.5, 1, n) * DX}
        about["reach"] = rng.uniform(0.8, 1.2, n) * DX
        sides.append({**about, "position": rng.uniform(-0.4, 0.4, (d, n)) * DX})
    return sides


def test_force_of_a_pair_is_antisymmetric_and_the_slope_of_its_energy():
    contact, (a, b) = sph.Contact(), pairs()
    force = lambda a, b: contact.pair(a, b, a["position"] - b["position"], 1e5)  # noqa: E731
    assert symmetry_error(force, a, b, -1) == 0

    def energy(x, a, b):
        return contact.pair_energy(a, b, x - b["position"], 1e5)

    slope = jax.vmap(jax.grad(energy), (-1, -1, -1), -1)(a["position"], a, b)
    got = jax.vmap(force, (-1, -1), -1)(a, b)
    assert np.count_nonzero(np.abs(got).sum(axis=0)) > 100  # most of them touch
    np.testing.assert_allclose(got, -slope, rtol=1e-12, atol=1e-12 * np.abs(got).max())


def test_force_begins_with_no_slope():
    side = {"volume": DX**2, "spacing": DX, "reach": DX}
    push = lambda r: sph.Contact().pair(side, side, jnp.array([r, 0.0]), 1.0)[0]  # noqa: E731
    assert push(DX * (1 + 1e-9)) == 0
    inside = jax.grad(push)(DX * (1 - 1e-6))
    # F = V / r_0 d^2 / (d + .1), so the slope is -V / r_0^2 20 d there, and a 1e-5th less
    np.testing.assert_allclose(inside, -2e-5, rtol=3e-5)


def block(name, corner, cells=3, **about: Any):
    about = {"density": 1000.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3, **about}
    return sph.Structure(name, sph.box(corner, (cells * DX, cells * DX), DX), **about)


def floor(**about: Any):
    return sph.Wall("floor", sph.box((-0.3, -2 * DX), (0.9, 2 * DX), DX), **about)


def test_bodies_that_start_in_touch_across_a_period_push_from_where_they_start():
    """As the same two do within the box."""
    inside = sph.Scene(block("a", (0.1, 0)), block("b", (0.1 + 2.6 * DX, 0)), effects=[sph.Contact(0.5, 2e5)])
    domain = sph.Domain((0, -1), (0.6, 1), (True, False))
    across = [block("a", (0.6 - 2.8 * DX, 0)), block("b", (-0.2 * DX, 0))]
    across = sph.Scene(*across, effects=[sph.Contact(0.5, 2e5)], domain=domain)
    for scene in (inside, across):
        touching = prepare(scene, sph.topologies(scene))[TOUCHING]
        assert np.min(touching.reach) == pytest.approx(0.6 * DX)
        assert float(observe.energies(scene, sph.initial_state(scene))["contact"]) == 0


def test_stable_limit_bounds_every_vibration():
    """Two lattices half a spacing inside each other: the square of the fastest vibration is at most 4 / limit^2."""
    scene = sph.Scene(block("a", (0, 0)), block("b", (0.4, 0), density=300.0), effects=[sph.Contact(0.5, 2e5)])
    limit = float(contact_time_step(scene, prepare(scene, sph.topologies(scene))))
    x = np.asarray(scene["a"].particles.positions)
    volume, contact = np.full(len(x), DX**2), scene.effect(sph.Contact)
    mass = np.repeat(np.concatenate([1000.0 * volume, 300.0 * volume]), 2)
    side = {"volume": DX**2, "spacing": DX, "reach": DX}

    def energy(u, shift):
        first, second = x + u[: len(x)], x + shift + u[len(x) :]
        offsets = first[:, None] - second[None]
        return jnp.sum(jax.vmap(jax.vmap(lambda r: contact.pair_energy(side, side, r, 1e5)))(offsets))

    found = []
    for shift in ((2.5 * DX, 0.0), (2.5 * DX, 0.5 * DX), (2.2 * DX, 2.2 * DX), (0.5 * DX, 0.5 * DX), (0.01 * DX, 0.0)):
        stiffness = jax.hessian(energy)(jnp.zeros((2 * len(x), 2)), jnp.array(shift)).reshape(len(mass), -1)
        found.append(np.linalg.eigvalsh(stiffness / np.sqrt(mass[:, None] * mass))[-1])
    assert max(found) <= 4 / limit**2
    assert max(found) > 0.2 * 4 / limit**2  # the limit is not far on the safe side


def falling(modulus=1e5, density=500.0, coefficient=0.5, speed=-1.0):
    """A soft block, a rigid ball and a floor, that touch within .05 s."""
    ball = sph.RigidBody("ball", sph.ball((0.08, 0.29), 0.1, DX), density, (0.3, -1.5), 3.0)
    body = block("block", (0, 0.01), youngs_modulus=modulus, velocity=(0.0, speed))
    return sph.Scene(body, ball, floor(), effects=[sph.Contact(coefficient, 1e6)], gravity=(0, -9.81))


@pytest.fixture(scope="module")
def run():
    return sph.simulate(falling(), 0.12, 0.01, time_step=0.0005)


def test_solids_bounce_and_keep_their_energy(run):
    energies = {name: np.asarray(value) for name, value in run.observe(observe.energies).items()}
    stored = energies["contact"].max()
    assert energies["contact"][0] == 0
    assert stored > 0.05  # J, of 30 J kinetic at the start: they do touch
    # second order in a step that is a third of the largest stable one, in impacts that pass through many a spring
    total = energies["total"]
    assert np.abs(total - total[0]).max() < 0.01 * energies["kinetic"][0]


def test_nothing_passes_through(run):
    places = {name: np.asarray(run.positions(name)) for name in ("block", "ball", "floor")}
    for a, b in (("block", "floor"), ("ball", "floor"), ("block", "ball")):
        apart = np.linalg.norm(places[a][:, :, None] - places[b][:, None], axis=-1)
        assert apart.min() > 0.5 * DX
        if a == "block":
            assert apart.min() < DX  # they have met


def test_ball_stays_rigid(run):
    places = np.asarray(run.positions("ball"))
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-13)


def test_momentum_is_exchanged_to_round_off():
    """Water, a soft block and a rigid ball inside each other's reach, nothing outside: momentum stays at every step."""
    water = sph.box((0, 0), (0.5, 0.3), DX)
    middle = (np.abs(water.positions[:, 0] - 0.25) < 0.16) & (water.positions[:, 1] > 0.1)
    fluid = sph.Fluid("water", water.where(~middle), 1000.0, 20.0, velocity=(0.0, 0.4))
    body = block("block", (0.1, 0.11), velocity=(1.0, 0.0))
    ball = sph.RigidBody("ball", sph.ball((0.33, 0.19), 0.06, DX), 500.0, (-1.0, 0.0), 5.0)
    scene = sph.Scene(fluid, body, ball, effects=[sph.Contact(), sph.ArtificialViscosity(0.05)])
    saved = sph.simulate(scene, 0.03, 0.001, time_step=0.001, integrator=sph.KickDriftKick(2))
    momentum = np.asarray(saved.observe(observe.linear_momentum))
    size = 1000.0 * 0.5 * 0.3 * 1.0
    # 30 steps, each a sum over some 60 particles of up to 20 neighbors
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-13 * size)
    changed = np.asarray(saved["ball"]["velocity"]).mean(axis=1)
    assert np.abs(changed[-1] - changed[0]).max() > 0.05  # and it is exchanged
    apart = np.asarray(saved.positions("ball"))[:, :, None] - np.asarray(saved.positions("block"))[:, None]
    assert np.linalg.norm(apart, axis=-1).min() < DX  # in touch


@pytest.mark.slow
def test_gradient_in_contact():
    """Forward and reverse mode against central differences, while all three touch; 30 steps."""
    start = np.array([1e5, 500.0, 0.5])
    found = sph.topologies(falling())

    def position(values):
        scene = falling(values[0], values[1], values[2])
        saved = sph.simulate(scene, 0.03, time_step=0.001, topologies_of_scene=found, max_speed=3.0)
        last = saved.final.systems
        return jnp.sum(last["ball"]["displacement"] ** 2) + jnp.sum(last["block"]["displacement"] ** 2)

    scaled = lambda factors: position(start * factors)  # noqa: E731
    one = jnp.ones(3)
    reverse = jax.jit(jax.grad(scaled))(one)
    value = jax.jit(scaled)
    for k in range(3):
        step = jnp.zeros(3).at[k].set(1e-5)
        difference = (value(one + step) - value(one - step)) / 2e-5
        assert abs(float(difference)) > 1e-6  # they have met: the coefficient matters too
        # second order in 1e-5, and a round-off of 1e-16 over it
        np.testing.assert_allclose(reverse[k], difference, rtol=1e-6)
    forward = jax.jit(lambda v: jax.jvp(scaled, (one,), (v,))[1])(one)
    np.testing.assert_allclose(forward, jnp.sum(reverse), rtol=1e-9)


def test_bodies_that_start_in_touch_do_not_push():
    scene = sph.Scene(block("a", (0, 0.4 * DX - DX)), floor(), effects=[sph.Contact()])
    assert float(observe.energies(scene, sph.initial_state(scene))["contact"]) == 0


@pytest.mark.parametrize(
    ("systems", "effects", "message"),
    [
        (lambda: [block("a", (0, 0)), floor()], [], r"Contact\(\)"),
        (lambda: [block("a", (0, 0))], [sph.Contact()], "leave it out"),
        (lambda: [sph.RigidBody("a", sph.box((0, 0), (0.1, 0.1), DX), 1.0), floor()], [sph.Contact()], "modulus"),
        (lambda: [block("a", (0, 0)), floor(pressure=sph.WallSummation())], [sph.Contact()], "needs a fluid"),
    ],
)
def test_scene_without_what_contact_needs(systems, effects, message):
    with pytest.raises(ValueError, match=message):
        sph.Scene(*systems(), effects=effects)


def test_contact_refuses_a_coefficient_that_is_not_positive():
    with pytest.raises(ValueError, match=r"Contact\.coefficient"):
        sph.Contact(0.0)
