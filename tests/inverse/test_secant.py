"""Secants follow the trend of a rough model, whose tangents follow every ripple."""

import jax.numpy as jnp
import numpy as np
import pytest

import inverse
from inverse.fit import _with_slopes
from inverse.gauss_newton import better_beside
from inverse.model import Evaluation, Model, RunFailed
from inverse.scan import scan

RIPPLE, WAVES = 0.06, 150.0  # amplitude, and radians per unit of the logarithm: a slope of 9 beside one of 1, and
# a valley every 4 %, as wide as those of a plate in a dam break


def rough(toys, start):
    """A decay whose amplitude has ripples over its logarithm, as splashes make of a modulus."""

    def simulate(scene, times, mode):
        amplitude = scene["amplitude"]
        ripple = RIPPLE * jnp.sin(WAVES * jnp.log(amplitude) + 40.0 * jnp.asarray(times))
        return (amplitude + ripple) * jnp.exp(-jnp.asarray(times))

    unknown = {"amplitude": inverse.log(0.1, 10.0, start=start)}
    times = np.arange(1, 61) / 60
    return toys.twin({"amplitude": 1.0}, unknown, times, simulate, lambda run: run, noise=0.05)


@pytest.mark.parametrize("start", [3.0, 1 / 3])
def test_a_rough_model_is_fitted_from_a_factor_three_off(toys, start):
    fit = inverse.fit(rough(toys, start), "secant")
    assert fit.converged and fit.tangent_runs == fit.adjoint_runs == 0
    assert fit.simulation_runs <= 39  # eight trials of three runs, twelve of the scan, three for the slopes there
    # without the scan the trend ends 1.3 to 1.9 % away, and the standard error, .3 %, knows nothing of it
    assert abs(fit["amplitude"] - 1) < 3 * fit.standard_errors["amplitude"] < 0.06
    # without ripples to be lost in, this case would prove nothing; tangents stop some standard errors away
    assert abs(inverse.fit(rough(toys, start))["amplitude"] - 1) > 0.06


def test_secants_are_central_and_one_sided_at_a_bound(toys):
    model = Model(toys.oscillator(0.9, 1.0))
    (z,) = model.problem.start
    near = model.secants(np.array([z]), 1e-4)
    # central differences are off by their square, 1e-8, times a third derivative of some tens; the rest is rounding
    np.testing.assert_allclose(near.jacobian, model.evaluate(np.array([z])).jacobian, rtol=0, atol=1e-5)
    (upper,) = model.problem.bounds[1]
    at_bound = model.secants(np.array([upper]), 0.1)
    slope = (model.residual(np.array([upper])) - model.residual(np.array([upper - 0.1]))) / 0.1
    np.testing.assert_allclose(at_bound.jacobian[:, 0], slope, rtol=1e-12)


def test_a_fit_goes_on_from_a_better_run_beside_its_end(toys):
    model = Model(toys.oscillator(0.9, 1.0))
    (true,) = model.problem.start
    aside = model.secants(np.array([true + 0.2]), 0.2)
    evaluate = lambda z: model.secants(z, 0.2)  # noqa: E731
    onward = better_beside(evaluate, aside)
    assert onward is not None and onward.z[0] == pytest.approx(true, rel=1e-12)
    assert better_beside(evaluate, onward) is None  # both runs beside the truth are worse

    def fails(z) -> Evaluation:
        raise RunFailed("no such run")

    assert better_beside(fails, aside) is None
    assert better_beside(evaluate, model.evaluate(aside.z)) is None  # tangents have no runs beside


def test_a_scan_looks_beside_an_end_and_within_the_bounds(toys):
    model = Model(toys.oscillator(0.9, 1.0))
    (true,), none = model.problem.start, np.empty((0, 1))
    looks = []

    def around(z):
        at = np.array([z])
        return scan(model, Evaluation(at, model.residual(at), none), 0.1, 0.01, lambda *look: looks.append(look))

    assert around(true + 0.085).z[0] == pytest.approx(true + 0.005, abs=1e-12)  # two hundredths apart, then one
    assert [(accepted, samples) for _, accepted, samples, _ in looks] == [(True, 81), (False, 81)]
    assert around(true).z[0] == true  # nothing is better than the truth
    (upper,) = model.problem.bounds[1]
    looks.clear()
    assert around(upper).z[0] <= upper
    assert looks[0][3].startswith("best of 5 beside")  # the other five would be beyond


def test_an_end_whose_secants_fail_has_those_of_the_trend(toys):
    model = Model(toys.oscillator(0.9, 1.0))
    (true,), none = model.problem.start, np.empty((0, 1))
    trend = model.secants(np.array([true + 0.1]), 0.2)
    best = Evaluation(np.array([true]), model.residual(np.array([true])), none)

    def fails(z) -> Evaluation:
        raise RunFailed("no such run")

    kept = _with_slopes(fails, best, trend)
    assert kept.z is best.z and kept.residual is best.residual and kept.jacobian is trend.jacobian


def test_difference_belongs_to_secants(toys):
    with pytest.raises(ValueError, match=r"difference=0\.1 has no meaning for method='gauss-newton'"):
        inverse.fit(toys.oscillator(), difference=0.1)
