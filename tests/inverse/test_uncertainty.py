"""Standard errors against closed forms and against scatter; the verdict names what the data can't tell."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import inverse
from inverse.model import Model

TIMES = np.linspace(0.0, 1.0, 41)


def statistics(fit):
    assert fit.uncertainty is not None
    return fit.uncertainty


def straight_line(noise=0.1, seed=0, given=True, bend=0.0):
    """a + b t, with noise of known standard deviation, and a bend that the model lacks."""
    clean = 2.0 + 3.0 * TIMES + bend * np.sin(3 * np.pi * TIMES)
    values = clean + noise * np.random.default_rng(seed).standard_normal(len(TIMES))
    data = inverse.Observations(TIMES, values, noise if given else None)
    return inverse.Problem(
        {},
        lambda run: run,
        data,
        {"a": inverse.linear(-10, 10, start=5.0), "b": inverse.linear(-10, 10, start=-5.0)},
        simulate=lambda scene, times, mode: scene["a"] + scene["b"] * jnp.asarray(times),
        replace=lambda scene, values: values,
    )


def exact_covariance(noise):
    design = np.stack([np.ones_like(TIMES), TIMES], axis=1)
    return noise**2 * np.linalg.inv(design.T @ design)


def test_linear_model_reaches_the_cramer_rao_bound_exactly():
    fit = inverse.fit(straight_line())
    covariance = exact_covariance(0.1)
    u = statistics(fit)
    # linear model: the Fisher information is the same everywhere, round-off only
    assert u.standard_error_absolute is not None
    np.testing.assert_allclose(u.standard_error_absolute, np.sqrt(np.diag(covariance)), rtol=1e-9)
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert u.correlation[0, 1] == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(u.covariance, u.reduced_chi_square * covariance, rtol=1e-9)
    design = np.stack([np.ones_like(TIMES), TIMES], axis=1)
    best = np.linalg.lstsq(design, fit.observed, rcond=None)[0]
    # the step tolerance of 1e-5 in quarters of a range of 20; statistically the last step is 1 % of an error
    np.testing.assert_allclose(fit.vector, best, atol=0.02 * u.standard_error.max())
    assert fit.verdict == "identifiable"
    assert "consistent with 1" in str(fit)
    assert not fit.messages


def test_noise_is_estimated_where_none_is_given():
    fit = inverse.fit(straight_line(given=False))
    expected = np.sqrt(np.diag(exact_covariance(0.1)))
    assert statistics(fit).standard_error_absolute is None
    # 39 degrees of freedom: the estimated noise scatters by 1 / sqrt(78) = 11 %, three of those
    np.testing.assert_allclose(statistics(fit).standard_error, expected, rtol=0.34)


def test_wrong_noise_and_missing_physics_are_noticed():
    bent = inverse.fit(straight_line(bend=1.0))
    assert any("model error" in message and "times the stated noise" in message for message in bent.messages)
    assert any("Durbin-Watson" in message for message in bent.messages)
    u = statistics(bent)
    assert np.all(u.standard_error_corrected > 2 * u.standard_error)
    assert u.effective_samples < 0.3 * len(TIMES)
    assert "not consistent with 1" in str(bent)
    overstated = straight_line()
    overstated.data = dataclasses.replace(overstated.data, standard_deviations=np.array(1.0))
    assert any("look too large" in message for message in inverse.fit(overstated).messages)


def test_autocorrelation_of_white_noise_is_not_called_model_error():
    called = sum(any("Durbin" in m for m in inverse.fit(straight_line(seed=s)).messages) for s in range(10))
    assert called == 0  # three sigmas: 1 in 700 each


def test_oscillator_scatter_over_200_seeds_matches_the_reported_error(toys):
    from inverse.gauss_newton import gauss_newton
    from inverse.uncertainty import estimate

    clean = toys.oscillator(noise=0.05)
    model = Model(clean)  # one compilation for all seeds
    truth = model.evaluate(np.log([toys.stiffness]))
    rng = np.random.default_rng(1)
    base = truth.residual * model.deviation + model.data
    found, reported = [], []
    for _ in range(200):
        model.data = base + model.deviation * rng.standard_normal(len(base))
        best, converged, _ = gauss_newton(model, 40, 1e-5, lambda *record: None)
        assert converged
        u = estimate(model, best)
        found.append(model.problem.vector(best.z)[0])
        reported.append(u.standard_error[0])
    bound = toys.stiffness / np.linalg.norm(truth.jacobian)  # Cramer-Rao at the truth
    # a standard deviation from 200 samples scatters by 1 / sqrt(400) = 5 %: three of those
    assert np.std(found) == pytest.approx(bound, rel=0.15)
    assert np.mean(reported) == pytest.approx(bound, rel=0.03)
    # bias far below the scatter: standard error of the mean is 7 % of it, three of those
    assert abs(np.mean(found) - toys.stiffness) < 0.21 * bound


@pytest.mark.parametrize("noise", [None, 0.01])
def test_a_product_that_alone_matters_is_called_not_identifiable(toys, noise):
    truth = {"amplitude": 2.0, "gain": 3.0, "rate": 1.5}
    unknown = {
        "amplitude": inverse.log(0.1, 100, start=1.0),
        "gain": inverse.log(0.1, 100, start=1.0),
        "rate": inverse.log(0.1, 10, start=1.0),
    }
    fit = inverse.fit(toys.decay(TIMES * 2 + 0.1, truth, unknown, noise))
    u = statistics(fit)
    assert fit.verdict == "not identifiable"
    assert set(u.collinear) == {"amplitude", "gain"}
    assert u.condition_number > 1e6
    assert u.correlation[0, 1] == pytest.approx(-1.0, abs=1e-9)
    assert "amplitude and gain can't be told apart" in str(fit)
    # the rate, and the product, are found all the same: noise of 1 % over 41 samples
    assert fit["rate"] == pytest.approx(1.5, rel=0.02)
    assert fit["amplitude"] * fit["gain"] == pytest.approx(6.0, rel=0.02)
    assert u.verdict_error[2] < 0.1


def test_strongly_correlated_pair_like_modulus_and_ratio_from_a_tip(toys):
    # tip stiffness = E / (1 - nu^2): a factor common to both, as for plane strain bending
    def simulate(scene, times, mode):
        k = scene["E"] / (1 - scene["nu"] ** 2)
        return toys.oscillator_run(
            {"stiffness": k * (1 + 1e-3 * scene["nu"]), "damping": 0.0, "gravity": 2.0}, times, mode
        )

    truth = {"E": 40.0, "nu": 0.4}
    unknown = {"E": inverse.log(1, 1e3, start=20.0), "nu": inverse.linear(0.0, 0.49, start=0.2)}
    problem = toys.twin(truth, unknown, np.arange(1, 90) / 100, simulate, lambda run: run[:, 0], 0.05)
    fit = inverse.fit(problem)
    assert fit.verdict == "not identifiable"
    assert "E and nu can't be told apart" in str(fit)
    alone = inverse.fit(toys.oscillator(noise=0.05))
    assert alone.verdict == "identifiable"


def test_unknown_without_influence(toys):
    truth = {"amplitude": 2.0, "gain": 3.0, "rate": 1.5, "color": 1.0}
    unknown = {"rate": inverse.log(0.1, 10, start=1.0), "color": inverse.log(0.1, 10, start=2.0)}
    fit = inverse.fit(toys.decay(TIMES + 0.1, truth, unknown))
    assert fit.verdict == "not identifiable"
    assert any("do not determine color" in message for message in fit.messages)
    assert fit["color"] == pytest.approx(2.0)  # left where it started
    assert fit["rate"] == pytest.approx(1.5, rel=1e-4)


def test_fewer_data_than_unknowns():
    problem = straight_line()
    problem.data = problem.data.select(window=(0.0, 0.001))
    fit = inverse.fit(problem)
    assert any("leave nothing to estimate the noise from" in message for message in fit.messages)
    assert fit.verdict == "not identifiable"


def two_sensors(seed, noise=(0.02, 0.5), given=False, silent=0.0):
    """a + b t by two sensors of unlike noise."""
    rng = np.random.default_rng(seed)
    values = 2.0 + 3.0 * TIMES[:, None] + rng.standard_normal((len(TIMES), 2)) * np.asarray(noise)
    if silent:  # a third one, which tells nothing of either
        values = np.concatenate([values, silent * np.sin(40 * TIMES)[:, None]], axis=1)
    deviations = np.broadcast_to([*noise, 1e-3 * silent][: values.shape[1]], values.shape)
    data = inverse.Observations(TIMES, values, deviations.copy() if given else None)
    time, wave = jnp.asarray(TIMES)[:, None], jnp.asarray(silent * np.sin(40 * TIMES))[:, None]

    def simulate(scene, times, mode):
        line = scene["a"] + scene["b"] * time
        return jnp.concatenate([line, line, wave] if silent else [line, line], axis=1)

    unknown = {"a": inverse.linear(-10, 10, start=5.0), "b": inverse.linear(-10, 10, start=-5.0)}
    return inverse.Problem({}, lambda run: run, data, unknown, simulate=simulate, replace=lambda scene, values: values)


def test_sensors_of_unlike_noise_have_honest_errors_also_where_it_is_not_stated():
    scores, messages = [], []
    for seed in range(60):
        fit = inverse.fit(two_sensors(seed))
        scores.append((fit.vector - [2.0, 3.0]) / statistics(fit).standard_error)
        messages.append(str(fit))
    # 60 runs: the rms of standardized errors scatters by 1 / sqrt(120) = 9 %, twice that; with one s for both it is 1.4
    assert np.sqrt(np.mean(np.square(scores), axis=0)) == pytest.approx(1.0, abs=0.2)
    assert all("all columns weigh alike" in text for text in messages)
    assert "weigh alike" not in str(inverse.fit(two_sensors(0, given=True)))
    assert "weigh alike" not in str(inverse.fit(two_sensors(0, noise=(0.1, 0.1))))


def test_one_sigma_for_every_column_is_the_usual_error_where_noise_is_alike():
    u = statistics(inverse.fit(two_sensors(1, noise=(0.1, 0.1))))
    pooled = np.sqrt(np.diag(exact_covariance(0.1)) / 2)
    # a standard deviation from 41 numbers scatters by 11 %: three of those
    np.testing.assert_allclose(u.standard_error, pooled, rtol=0.35)


def test_a_sensor_that_tells_nothing_does_not_change_the_verdict():
    """One percent of its own amplitude is what a sensor is trusted to, not of the largest among all."""
    small, large = (statistics(inverse.fit(two_sensors(0, given=True, silent=size))) for size in (1.0, 1e4))
    # the third sensor has no residual: the same numbers but for rounding, beside 1e4 squared
    np.testing.assert_allclose(large.verdict_error, small.verdict_error, rtol=1e-6)


def test_correlated_residuals_enlarge_the_error_by_what_they_hide():
    """Noise with rho = .8 has (1 - rho) / (1 + rho) = 1/9 independent samples, and thrice the error."""
    times, rho, found, reported = np.linspace(0, 1, 400), 0.8, [], []
    for seed in range(60):
        rng, noise = np.random.default_rng(seed), np.zeros(len(times))
        for i, kick in enumerate(rng.standard_normal(len(times))):
            noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * kick if i else kick
        problem = inverse.Problem(
            {},
            lambda run: run,
            inverse.Observations(times, 2.0 + 0.1 * noise, 0.1),
            {"a": inverse.linear(-10, 10, start=5.0)},
            simulate=lambda scene, times, mode: scene["a"] * jnp.ones(len(times)),
            replace=lambda scene, values: values,
        )
        fit = inverse.fit(problem)
        found.append(fit.vector[0])
        reported.append(statistics(fit).standard_error_corrected[0])
    # the scatter of 60 is known to 9 %, rho and s of each run to a tenth: within a third; with 1/9 for 1/3 it is 3
    assert np.std(found) / np.mean(reported) == pytest.approx(1.0, abs=0.33)
