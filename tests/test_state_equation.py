"""Pressure, density and energy of an equation of state belong together, also where float32 ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsph.materials import Cole, LinearStateEquation

REST, SOUND = 1000.0, 20.0
EQUATIONS = [
    LinearStateEquation(),
    LinearStateEquation(background_pressure=300.0),
    Cole(),
    Cole(exponent=1.0),
    Cole(exponent=1.4, background_pressure=-200.0),
]
each = pytest.mark.parametrize("equation", EQUATIONS, ids=str)
DEVIATIONS = np.concatenate([-np.geomspace(300.0, 1e-9, 40), [0.0], np.geomspace(1e-9, 500.0, 40)])


def at(equation, name, deviation):
    return getattr(equation, name)(deviation, REST, SOUND)


@each
def test_density_and_pressure_are_inverse(equation):
    pressure = at(equation, "pressure", DEVIATIONS)
    back = at(equation, "deviation", pressure)
    # a background pressure rounds the sum, to eps p_background / c^2 = 2e-16 of the density
    np.testing.assert_allclose(back, DEVIATIONS, rtol=1e-13, atol=1e-15 * 300)


@each
def test_sound_speed_is_the_slope_at_rest(equation):
    slope = jax.grad(lambda x: at(equation, "pressure", x))(0.0)
    assert slope == pytest.approx(SOUND**2, rel=1e-14)
    assert at(equation, "pressure", 0.0) == pytest.approx(-equation.background_pressure, abs=1e-12)


@each
def test_slope_of_the_energy_is_the_pressure_over_the_density_squared(equation):
    slope = jax.vmap(jax.grad(lambda x: at(equation, "energy", x)))(DEVIATIONS)
    expected = np.asarray(at(equation, "pressure", DEVIATIONS)) / (REST + DEVIATIONS) ** 2
    # some twenty roundings; a background pressure is the larger term, and rounds by eps p_background / rho^2
    floor = 1e-14 * abs(equation.background_pressure) / REST**2
    np.testing.assert_allclose(slope, expected, rtol=1e-13, atol=floor)
    assert at(equation, "energy", 0.0) == 0.0


@each
def test_energy_is_the_closed_formula_where_that_has_digits(equation):
    deviation = np.array([-300.0, -200.0, 250.0, 500.0])
    r, gamma = 1 + deviation / REST, getattr(equation, "exponent", 1.0)
    bracket = (np.log(r) if gamma == 1 else (r ** (gamma - 1) - 1) / (gamma - 1)) + 1 / r - 1
    expected = SOUND**2 / gamma * bracket - equation.background_pressure * (1 / REST - 1 / (REST + deviation))
    # the bracket is a tenth of its terms
    np.testing.assert_allclose(at(equation, "energy", deviation), expected, rtol=1e-13)


@each
@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.3, 30.0])
def test_float32_keeps_its_digits_for_tiny_deviations(equation, size):
    """A density of 1000 + 1e-7 is 1000 in float32; its pressure and energy are still right to float32's precision."""
    deviation = np.array([-size, size])
    single = jax.tree.map(np.float32, equation)
    for name in ("pressure", "energy"):
        exact = at(equation, name, deviation)
        value = at(single, name, jnp.asarray(deviation, np.float32))
        assert value.dtype == np.float32
        # ten roundings of 6e-8
        np.testing.assert_allclose(value, exact, rtol=6e-7)


def test_energy_near_rest_is_that_of_a_spring():
    """c^2 (rho - rho_0)^2 / (2 rho_0^2), whatever the exponent; the next term is smaller by the relative deviation."""
    for equation in (LinearStateEquation(), Cole(), Cole(exponent=3.0)):
        assert at(equation, "energy", 1e-5) == pytest.approx(0.5 * SOUND**2 * 1e-16, rel=1e-7)


def test_derivatives_of_the_energy_are_finite_in_all_numbers():
    def energy(exponent, deviation, rest, sound):
        return Cole(exponent=exponent).energy(deviation, rest, sound)

    for deviation in (0.0, -50.0, 400.0):
        for exponent in (1.0, 7.0):
            slopes = jax.grad(energy, argnums=(0, 1, 2, 3))(exponent, deviation, REST, SOUND)
            assert np.all(np.isfinite(slopes))
