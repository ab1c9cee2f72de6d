"""The examples of falling bodies run, small and short, and what they return is physical."""

from pathlib import Path

import numpy as np
import pytest
from examples_of import runner

FOLDER = Path(__file__).parents[1] / "examples" / "fsi"


@pytest.fixture
def example(tmp_path):
    return runner(FOLDER, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["falling_spheres", "falling_rigid_spheres"])
def test_spheres_fall_freely_until_they_meet_the_water(example, name):
    run = example(name, spacing=0.1, t_end=0.2)
    times = np.asarray(run.times, float)
    for sphere in run.scene.solids:
        height = np.asarray(run.positions(sphere.name), float)[..., 1].mean(axis=1)
        # float32 rounds a place 1.6 m off by 1e-7 of it
        np.testing.assert_allclose(height, height[0] - 0.5 * 9.81 * times**2, atol=2e-5)


def test_water_bends_the_beam(example):
    run = example("falling_column_on_beam", particles=5, across=3, t_end=0.03)
    tip = np.asarray(run.probe("beam", (0.35, 0.0)).displacement, float)[:, 1]
    weight = -0.5 * 9.81 * float(run.times[-1]) ** 2
    middle = np.asarray(run.probe("beam", (0.2, 0.0)).displacement, float)[-1, 1]
    assert weight * 1.3 < tip[-1] < 0  # its tip has not yet heard of the water: it falls by its weight
    assert middle < 1.1 * weight  # below the column it goes further
