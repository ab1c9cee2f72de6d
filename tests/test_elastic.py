"""Elastic laws: derivatives of their energies, closed forms, invariance under rotation, small strains in float32."""

import csv
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxsph.materials import NeoHookean, StVenantKirchhoff, lame_parameters, p_wave_speed, von_mises
from jaxsph.materials.elastic import cauchy_stress, green_lagrange_strain

REFERENCE = Path(__file__).parent / "reference"
LAWS = [StVenantKirchhoff(), NeoHookean()]
LAM, MU = (float(value) for value in lame_parameters(1.0, 0.3))


@partial(jax.jit, static_argnames="law")
def stress_of(law, h):
    return law.stress(h, LAM, MU)


@partial(jax.jit, static_argnames="law")
def energy_of(law, h):
    return law.energy_density(h, LAM, MU)


@partial(jax.jit, static_argnames="law")
def cauchy_of(law, h):
    return cauchy_stress(h, law.stress(h, LAM, MU))


law_of_each_kind = pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
in_2d_and_3d = pytest.mark.parametrize("d", [2, 3])


def table(name):
    with open(REFERENCE / name, encoding="utf-8") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def gradients(d, size, n=20, seed=0):
    return jnp.asarray(size * np.random.default_rng(seed).uniform(-1, 1, (d, d, n)))


def rotation(d, degrees, seed=0):
    if d == 2:
        angle = np.radians(degrees)
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    axis = np.random.default_rng(seed).normal(size=3)
    return Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()


@law_of_each_kind
@in_2d_and_3d
@pytest.mark.parametrize("size", [1e-6, 0.3])
def test_stress_is_the_derivative_of_the_energy(law, d, size):
    h = gradients(d, size)
    by_ad = jax.grad(lambda x: jnp.sum(energy_of(law, x)))(h)
    # Both are sums of some tens of products of numbers of order 1 or of the strain; where terms of order 1 cancel
    # (the neo-Hookean energy, tr E - ln J) the rounding is that of 1, not of the strain.
    np.testing.assert_allclose(stress_of(law, h), by_ad, rtol=1e-12, atol=1e-14)


@law_of_each_kind
@in_2d_and_3d
def test_energy_is_zero_at_rest_and_positive_elsewhere(law, d):
    assert law.energy_density(jnp.zeros((d, d)), LAM, MU) == 0
    np.testing.assert_array_equal(stress_of(law, jnp.zeros((d, d))), 0)
    h = gradients(d, 0.3)
    strain = np.abs(green_lagrange_strain(h)).max(axis=(0, 1))
    assert np.all(energy_of(law, h) > 0.01 * strain**2)


@law_of_each_kind
@in_2d_and_3d
@pytest.mark.parametrize("degrees", [1, 10, 45, 90, 180])
def test_objectivity(law, d, degrees):
    """P(R F) = R P(F), the energy does not see R, and the Cauchy stress turns with the body."""
    turn = rotation(d, degrees)
    h = gradients(d, 0.2)
    unit = np.eye(d)[:, :, None]
    turned = np.einsum("ij,jkn->ikn", turn, h + unit) - unit
    stress, energy = stress_of(law, h), energy_of(law, h)
    # numbers of order 1, some tens of roundings
    np.testing.assert_allclose(stress_of(law, turned), np.einsum("ij,jkn->ikn", turn, stress), atol=1e-14 * 10)
    np.testing.assert_allclose(energy_of(law, turned), energy, atol=1e-14 * 10)
    expected = np.einsum("ij,jkn,lk->iln", turn, cauchy_of(law, h), turn)
    np.testing.assert_allclose(cauchy_of(law, turned), expected, atol=1e-14 * 10)


@law_of_each_kind
@in_2d_and_3d
def test_cauchy_stress_is_symmetric(law, d):
    h = gradients(d, 0.3)
    stress = cauchy_of(law, h)
    np.testing.assert_allclose(stress, np.swapaxes(stress, 0, 1), atol=1e-14 * 10)  # some tens of roundings of 1


@law_of_each_kind
@in_2d_and_3d
def test_small_strains_are_hookes_law(law, d):
    """P = lambda tr(e) I + 2 mu e + O(strain^2): the rest falls a hundred times when the strain falls ten times."""

    def rest(size):
        h = gradients(d, size)
        e = 0.5 * (h + np.swapaxes(h, 0, 1))
        hooke = LAM * np.trace(e) * np.eye(d)[:, :, None] + 2 * MU * e
        return np.abs(stress_of(law, h) - hooke).max()

    assert rest(1e-4) < 10 * 1e-8, "the coefficient of the strain squared is a few moduli"
    assert rest(1e-3) / rest(1e-4) == pytest.approx(100, rel=0.02), "the next term is a strain, .001, times a few"


@in_2d_and_3d
def test_laws_agree_at_small_strain(d):
    h = gradients(d, 1e-6)
    one, other = (stress_of(law, h) for law in LAWS)
    assert np.abs(one - other).max() < 10 * 1e-6 * np.abs(one).max(), "they differ by the strain, 1e-6, times a few"


def test_saint_venant_kirchhoff_in_simple_shear():
    for row in table("solid/svk_simple_shear_E1_nu0.3.csv"):
        h = jnp.array([[0.0, row["gamma"]], [0.0, 0.0]])
        stress = stress_of(LAWS[0], h)
        sigma = cauchy_of(LAWS[0], h)
        expected = [[row["P11"], row["P12"]], [row["P21"], row["P22"]]]
        np.testing.assert_allclose(stress, expected, rtol=1e-9, err_msg="ten digits are in the table")
        expected = [[row["s11"], row["s12"]], [row["s21"], row["s22"]]]
        np.testing.assert_allclose(sigma, expected, rtol=1e-9)


def test_saint_venant_kirchhoff_in_uniaxial_tension():
    for row in table("solid/svk_uniaxial_plane_strain_E1_nu0.3.csv"):
        h = jnp.diag(jnp.array([row["stretch_1"], row["stretch_2"]]) - 1)
        stress = stress_of(LAWS[0], h)
        # the stretch across has ten digits, and the moduli are about 1
        assert stress[0, 0] == pytest.approx(row["P11"], abs=1e-9)
        assert abs(stress[1, 1]) < 2e-9, "the sides are free"
        assert cauchy_of(LAWS[0], h)[0, 0] == pytest.approx(row["sigma11"], abs=2e-9)


@law_of_each_kind
@in_2d_and_3d
def test_float32_keeps_small_strains(law, d):
    """A strain of 1e-5 has 1 % of error left in float32 when it is found as F - 1; from H it keeps all digits."""
    h = gradients(d, 1e-5)
    single = law.stress(h.astype(jnp.float32), np.float32(LAM), np.float32(MU))
    assert single.dtype == jnp.float32
    exact = stress_of(law, h)
    # some ten roundings of 6e-8 each
    assert np.abs(single - exact).max() < 1e-6 * np.abs(exact).max()


def test_neo_hookean_resists_collapse_and_is_not_defined_inside_out():
    pressed = [float(stress_of(LAWS[1], (s - 1) * jnp.eye(2))[0, 0]) for s in (0.5, 0.1, 0.01)]
    assert pressed[0] > pressed[1] > pressed[2] and pressed[2] < -100
    assert np.isnan(stress_of(LAWS[1], jnp.diag(jnp.array([-2.0, 0.0])))).any()
    collapsed = [float(stress_of(LAWS[0], (s - 1) * jnp.eye(2))[0, 0]) for s in (1 / 3**0.5, 0.3)]
    assert collapsed[1] > collapsed[0], "St. Venant-Kirchhoff softens below a stretch of 1 / sqrt(3)"


def test_wave_speed_is_that_of_the_table():
    for row in table("solid/bar_wave.csv"):
        assert p_wave_speed(row["E"], row["nu"], row["rho"]) == pytest.approx(row["c_p"], rel=1e-9)  # ten digits


def test_von_mises_of_known_states():
    pull = 3.0
    uniaxial = jnp.zeros((3, 3)).at[0, 0].set(pull)
    assert von_mises(uniaxial, 0.3) == pytest.approx(pull, rel=1e-14)
    assert von_mises(pull * jnp.eye(3), 0.3) == 0, "pressure alone"
    shear = jnp.array([[0.0, pull], [pull, 0.0]])
    assert von_mises(shear, 0.3) == pytest.approx(3**0.5 * pull, rel=1e-14)
    plane = von_mises(jnp.diag(jnp.array([pull, pull])), 0.5)
    assert plane == pytest.approx(0, abs=1e-14), "an incompressible body in plane strain bears pressure without shear"


@in_2d_and_3d
def test_von_mises_can_be_differentiated_without_stress(d):
    change = jax.grad(lambda s: von_mises(s, 0.3))(jnp.zeros((d, d)))
    assert np.all(np.isfinite(change)), "at rest, where every run begins, a fit of stresses starts too"
