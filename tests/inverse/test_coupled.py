"""The default simulation with fluids and structures: Young's modulus of a plate that water strikes."""

import sys
from pathlib import Path

import numpy as np
import pytest

import inverse
import jaxsph

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from struck_plate import MIDDLE, THICKNESS, struck_plate  # pyright: ignore[reportMissingImports]

NAME = "plate.youngs_modulus"


@pytest.mark.slow
def test_modulus_of_a_struck_plate():
    scene = struck_plate()
    start = float(scene["plate"].youngs_modulus)
    bounds = start / 4, 4 * start
    step = jaxsph.stable_time_step(scene)
    times = 8 * step * np.arange(1, 11)
    data = inverse.Observations(times, np.zeros(10), 1e-6)
    unknown = {NAME: inverse.log(*bounds, start=1.5 * start)}
    problem = inverse.Problem(
        scene, lambda run: run.probe("plate", (MIDDLE, -THICKNESS)).displacement[:, 1], data, unknown
    )
    options = problem.simulate._options
    stiffest = scene.replace({NAME: bounds[1]})
    needed = jaxsph.stable_substeps(stiffest, problem.simulate.time_step)
    assert dict(options["integrator"].substeps) == needed
    assert needed["plate"] > jaxsph.stable_substeps(scene, problem.simulate.time_step)["plate"]
    assert options["max_speed"] >= 2.0, "the water falls with that"

    truth = np.asarray(problem.model(np.array([start]), "forward"))
    problem = problem.with_data(inverse.Observations(times, truth, 0.01 * np.max(np.abs(truth))))
    fit = inverse.fit(problem)
    # the same steps as those of the data: the tolerance of the iteration is left
    assert float(fit[NAME]) == pytest.approx(start, rel=1e-4)
    assert fit.verdict == "identifiable"
    assert fit.simulation_runs <= 10
