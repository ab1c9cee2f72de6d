"""What a free fluid keeps: linear momentum to round-off, and energy that never grows without input."""

import jax
import numpy as np
import pytest

import jaxsph


def course(scene, t_end, saves):
    """Energies by kind, and the linear momentum, of every saved state."""
    run = jaxsph.simulate(scene, t_end, t_end / saves)
    energies = jax.vmap(jaxsph.observe.energies, (None, 0))(scene, run.states)
    momenta = jax.vmap(jaxsph.observe.linear_momentum, (None, 0))(scene, run.states)
    return {name: np.asarray(value) for name, value in energies.items()}, np.asarray(momenta)


def stretching_drop(**options):
    return jaxsph.scenes.oscillating_drop(10, frequency=0.0, rate=1.0, **options)


@pytest.mark.parametrize("dtype, limit", [("float64", 1e-13), ("float32", 3e-6)])
def test_a_free_drop_keeps_its_linear_momentum(dtype, limit):
    # round-off of the sums over 316 particles and of 300 steps, over the momentum of one half of the drop
    scene = stretching_drop(dtype=np.dtype(dtype))
    velocity = np.asarray(scene["water"].velocity) + np.array([0.3, -0.2])
    scene = scene.replace({"water.velocity": velocity})
    _, momenta = course(scene, 1.0, 5)
    scale = 1000.0 * np.pi * 0.36
    drift = np.max(np.abs(momenta - momenta[0])) / scale
    print(f"linear momentum of a free drop, {dtype}: changes by {drift:.1e} of its size")
    assert drift < limit


@pytest.mark.parametrize(
    "name, scene, t_end",
    [
        ("stretching drop", stretching_drop, 1.0),
        pytest.param("stretching drop, no effects", lambda: stretching_drop(effects=[]), 1.0, marks=pytest.mark.slow),
        ("dam break", lambda: jaxsph.scenes.dam_break(10, tank_height=1.2), 1.0),
        pytest.param("still water", lambda: jaxsph.scenes.still_water(10), 3.0, marks=pytest.mark.slow),
        pytest.param("rotating square", lambda: jaxsph.scenes.rotating_square(20), 2.0, marks=pytest.mark.slow),
        pytest.param("Taylor-Green vortex", lambda: jaxsph.scenes.taylor_green(16), 0.5, marks=pytest.mark.slow),
    ],
)
def test_energy_does_not_grow(name, scene, t_end):
    energies, _ = course(scene(), t_end, 20)
    total = energies["total"]
    # what could be gained: the energy in motion and in the lift, not the reference of the gravitational energy
    size = np.max(energies["kinetic"]) + np.ptp(energies["gravitational"])
    if name == "still water":
        size = np.max(energies["gravitational"])
    growth = np.max(np.diff(np.maximum.accumulate(total))) / size
    gained = np.max(total - total[0]) / size
    print(f"energy of {name}: gains at most {gained:+.2%} of {size:.4g} J/m, from save to save {growth:.2%}")
    # dissipation only takes away; a thousandth is what the time step's second order may oscillate by
    assert gained < 1e-3
