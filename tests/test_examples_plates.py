"""The examples of water and plates run, small and short, and what they return is physical."""

from pathlib import Path

import numpy as np
import pytest
from examples_of import runner

FOLDER = Path(__file__).parents[1] / "examples" / "fsi"
pytestmark = pytest.mark.slow  # a minute of compilation each


@pytest.fixture
def example(tmp_path):
    return runner(FOLDER, tmp_path)


def displacement(run, name, at):
    return np.asarray(run.probe(name, at).displacement, float)


def test_water_opens_the_gate(example):
    end = displacement(example("elastic_gate", particles=10, across=3, t_end=0.05), "gate", (0.1025, 0.0))
    # measured are 12.5 mm at .04 s and 34 mm at .08 s; ten particles over the width are coarse
    assert end[0, 0] == 0 and 0.5 * 0.0179 < end[-1, 0] < 2 * 0.0179


def test_the_dam_reaches_the_plate_no_earlier_than_it_can(example):
    run = example("dam_break_plate", particles=10, across=3, t_end=0.05)
    front = np.asarray(run.positions("water"), float)[-1, :, 0].max()
    assert 0.146 < front < 0.25
    aside, down = displacement(run, "plate", (0.292, 0.08)).T
    assert np.max(np.abs(aside)) < 1e-5, "nothing has struck it"
    # its own weight is suddenly there, and shortens it at most twice as much as at rest, rho g L^2 / (2 E)
    assert -2.05 * 2500 * 9.81 * 0.08**2 / 2e6 < np.min(down) < 0


def test_the_plate_carries_the_column(example):
    middle = displacement(example("water_column_on_plate", across=3, t_end=0.02), "plate", (0.5, -0.025))[:, 1]
    # a load that is suddenly there bends it at most twice as far as at rest
    assert -2.2 * 7.262e-5 < middle.min() < -0.8 * 7.262e-5
