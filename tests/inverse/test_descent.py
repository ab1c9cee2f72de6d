"""Reverse-mode routes: 50 unknowns of a field in space, an oscillator in growing windows, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import inverse

POINTS = 50


def diffusion(unknowns=POINTS, noise=None):
    """Strength of `unknowns` heat sources along a rod, from the temperatures at all of them over time."""
    x = np.linspace(0, 1, unknowns)
    truth = {"source": jnp.asarray(1 + np.sin(2 * np.pi * x) * np.exp(-x))}

    def simulate(scene, times, mode):
        def step(u, _):
            left = jnp.concatenate([u[:1], u[:-1]])
            right = jnp.concatenate([u[1:], u[-1:]])
            u = u + 0.2 * (left - 2 * u + right) + 0.1 * scene["source"]
            return u, u

        return jax.lax.scan(step, jnp.zeros(unknowns), None, length=len(times))[1]

    def replace(scene, values):
        return {**scene, **values}

    times = np.arange(1.0, 21.0)
    data = inverse.Observations(times, np.asarray(simulate(truth, times, "reverse")))
    if noise:
        data = data.with_noise(relative=noise)
    unknown = {"source": inverse.linear(-1.0, 4.0, start=np.full(unknowns, 0.5))}
    problem = inverse.Problem(truth, lambda run: run, data, unknown, simulate=simulate, replace=replace)
    return problem, np.asarray(truth["source"])


def test_l_bfgs_b_finds_fifty_unknowns():
    problem, truth = diffusion()
    fit = inverse.fit(problem, method="l-bfgs-b")
    assert fit.converged
    # smoothing by diffusion hides short waves: 1e-10 in the cost is 1e-3 in the weakest of them
    np.testing.assert_allclose(fit["source"], truth, atol=2e-3)
    assert fit.adjoint_runs == fit.simulation_runs - 1  # and one run with 50 tangents for the standard errors
    assert fit.tangent_runs == POINTS
    assert len(fit.standard_errors) == POINTS


def test_standard_errors_of_both_routes_agree():
    problem, truth = diffusion(noise=0.01)
    descent = inverse.fit(problem, method="l-bfgs-b", cost_tolerance=1e-14)
    newton = inverse.fit(problem)
    assert descent.uncertainty is not None
    assert newton.uncertainty is not None
    errors = descent.uncertainty.standard_error, newton.uncertainty.standard_error
    # both at the same optimum of a linear problem, up to a hundredth of a standard error
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-4)
    assert np.max(np.abs(descent["source"] - newton["source"]) / errors[1]) < 0.05
    # 50 unknowns: about 2/3 of them within one standard error; 5 sigmas of that binomial are .33
    within = np.mean(np.abs(newton["source"] - truth) < errors[1])
    assert 0.68 - 0.33 < within <= 1.0


def test_adam_gets_close_to_fifty_unknowns():
    problem, truth = diffusion()
    fit = inverse.fit(problem, method="adam", max_iterations=400, learning_rate=0.1)
    # a first-order method: a few percent of the range of the field
    np.testing.assert_allclose(fit["source"], truth, atol=0.05)
    assert fit.adjoint_runs == fit.simulation_runs - 1


def test_beyond_the_jacobian_limit_no_standard_errors_and_the_reason():
    problem, _ = diffusion(unknowns=80)
    fit = inverse.fit(problem, method="l-bfgs-b")
    assert fit.uncertainty is None
    assert fit.standard_errors == {}
    assert fit.verdict == "unknown"
    assert "80 unknowns would take 80 forward-mode tangents (limit 64)" in str(fit)
    assert fit.to_dict()["verdict"] == "unknown"


@pytest.mark.parametrize("method", ["l-bfgs-b", "adam"])
def test_oscillator_over_five_periods_in_growing_windows(toys, method):
    problem = toys.oscillator(5.0, 3.0)
    fit = inverse.fit(problem, method=method, windows=(0.1, 0.3, 1.0), max_iterations=300)
    # adam's last steps decay to zero: a tenth of a percent is what is asked of a fit
    assert fit["stiffness"] == pytest.approx(toys.stiffness, rel=1e-3)
    assert {entry["samples"] for entry in fit.history} == {46, 137, 454}


@pytest.mark.parametrize("method", ["l-bfgs-b", "adam"])
def test_failing_runs_are_backed_off_from(toys, method):
    def simulate(scene, times, mode):
        run = toys.oscillator_run(scene, times, mode)
        return jnp.where(scene["stiffness"] > 1.05 * toys.stiffness, jnp.nan, run)

    scene = {"stiffness": toys.stiffness, "damping": 0.0, "gravity": toys.gravity}
    unknown = {"stiffness": inverse.log(1, 1e4, start=toys.stiffness / 1.5)}
    problem = toys.twin(scene, unknown, np.arange(1, 60) / 100, simulate, lambda run: run[:, 0])
    fit = inverse.fit(problem, method=method)
    assert fit["stiffness"] == pytest.approx(toys.stiffness, rel=1e-3)
    bad = toys.twin(
        scene,
        {"stiffness": inverse.log(1, 1e4, start=100.0)},
        np.arange(1, 60) / 100,
        simulate,
        lambda run: run[:, 0],
    )
    with pytest.raises(inverse.RunFailed, match="starting values"):
        inverse.fit(bad, method=method)


@pytest.mark.parametrize("rate", [1e-4, 1e-3])
def test_adam_on_its_way_does_not_claim_to_have_arrived(toys, rate):
    """Its last step is small because the rate has decayed."""
    fit = inverse.fit(toys.oscillator(1.0, 3.0), method="adam", max_iterations=40, learning_rate=rate)
    assert fit["stiffness"] != pytest.approx(toys.stiffness, rel=0.1)
    assert not fit.converged
    assert "give it more iterations or another learning rate" in str(fit)
