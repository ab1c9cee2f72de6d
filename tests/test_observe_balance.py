"""Energies and momenta of fluids are those of mechanics; observers stand inside of transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from basins import GRAVITY, REST, basin, with_water

import jaxsph as sph
from jaxsph import observe
from jaxsph.scenes.taylor_green import taylor_green


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


def test_a_pressure_that_evolves_by_itself_stores_energy():
    """Of sound: p^2 / (2 rho^2 c^2) per mass, 1/2 (.5 / (2 x 10))^2 in 2 kg/m^3 of a unit square."""
    water = sph.Fluid("water", sph.box((0, 0), (1, 1), 0.1), 2.0, 10.0, pressure=lambda x: 0.5 + 0 * x[:, 0])
    scene = sph.Scene(water, density=sph.EDAC(free_surface=True))
    # the mass is that of the density at this pressure, .5 / 10^2 more
    expected = (2.0 + 0.005) * 0.5 * (0.5 / 20.0) ** 2
    assert observe.energies(scene, sph.initial_state(scene))["internal"] == pytest.approx(expected, rel=1e-13)


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


@pytest.mark.slow
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
