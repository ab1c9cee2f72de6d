"""The default simulation: Young's modulus of a coarse Turek-Hron beam from its own tip motion."""

import numpy as np
import pytest

import inverse
import jaxsph

TIMES = np.arange(1, 31) * 0.01


def test_twin_of_a_coarse_beam():
    scene = jaxsph.scenes.turek_hron_beam(3)
    start = inverse.log(4e5, 4.2e6, start=1.4e6 / 3, unit="Pa")

    def tip(run):
        return run.probe("beam", at=(0.35, 0.0)).displacement[:, 1]

    time_step = jaxsph.stable_time_step(scene.replace({"beam.youngs_modulus": 4.2e6}))
    run = jaxsph.simulate(scene, 0.3, 0.01, time_step=time_step).at(TIMES)
    data = inverse.Observations(TIMES, np.asarray(tip(run)))
    problem = inverse.Problem(scene, tip, data, {"beam.youngs_modulus": start})
    # the limit is found by an iteration for the highest frequency, which ends at a relative 1e-3 or better
    assert problem.simulate.time_step == pytest.approx(time_step, rel=1e-3)
    fit = inverse.fit(problem)
    # the .1 % and 15 runs that are asked of the main job
    assert fit["beam.youngs_modulus"] == pytest.approx(1.4e6, rel=1e-3)
    assert fit.simulation_runs <= 15
    assert fit.verdict == "identifiable"
