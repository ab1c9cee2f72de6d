"""The default simulation with fluids: viscosities from velocities at points, with examples/calibrate_viscosity.py."""

import csv
import importlib.util
from pathlib import Path

import numpy as np
import pytest

import inverse
import jaxsph
from inverse.jaxsph_simulation import JaxsphSimulation

ROOT = Path(__file__).resolve().parents[2]
NAME = "water.viscosity"


@pytest.fixture(scope="module")
def example():
    specification = importlib.util.spec_from_file_location("viscosity", ROOT / "examples/calibrate_viscosity.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def vortices(example):
    """12 x 12 particles, a fluid that starts with twice its viscosity, and its simulation."""
    flow = example.vortices(12, t_end=0.2, every=0.02)
    unknown = {NAME: inverse.log(flow.viscosity / 3, 3 * flow.viscosity, start=2 * flow.viscosity)}
    simulation = JaxsphSimulation(flow.scene, lambda s, v: s.replace(v), unknown, flow.times)
    data = inverse.Observations(flow.times, np.asarray(flow.observe(simulation(flow.scene, flow.times, "forward"))))
    return inverse.Problem(flow.scene, flow.observe, data, unknown, simulate=simulation)


def test_twin_without_noise(vortices):
    fit = inverse.fit(vortices)
    # the .1 % that is asked of a twin; the same steps as those of the data leave the tolerance of the iteration, 1e-5
    assert fit[NAME] == pytest.approx(0.01, rel=1e-3)
    assert fit.simulation_runs <= 15
    assert fit.verdict == "identifiable"


def test_derivatives_agree(vortices):
    # differences of a run of some 30 steps are right to about 1e-8 at their best step
    assert vortices.check(steps=(1e-4, 1e-5, 1e-6)).max_relative_difference < 1e-6


def test_room_and_speed_come_from_a_run(vortices):
    options = vortices.simulate._options
    scene = vortices.scene
    # the vortices are a tenth of the speed of sound fast at the start, shifting comes on top
    assert 1.1 <= options["max_speed"] <= 1.1 * 1.5
    start = jaxsph.topologies(scene)["water-water"].capacity
    assert options["topologies_of_scene"]["water-water"].capacity.slots >= start.slots


def test_time_step_is_that_of_the_highest_viscosity(example):
    flow = example.channel(5, t_end=0.02, every=0.01)
    unknown = {NAME: inverse.log(2e-4, 4e-3, start=1e-3)}
    simulation = JaxsphSimulation(flow.scene, lambda s, v: s.replace(v), unknown, flow.times)
    highest = flow.scene.replace({NAME: 4e-3})
    assert simulation.time_step == pytest.approx(jaxsph.stable_time_step(highest))
    # the force that drives the flow is not the viscosity's
    assert np.array_equal(highest.gravity, flow.scene.gravity)


def test_series_of_the_channel(example):
    with (ROOT / "tests/reference/fluid/startup_morris_SI.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    for line in lines:
        u = example.start_up(1e-6, 1e-4, 1e-3, float(line["y_m"]), float(line["t_s"]))
        # ten digits are written
        assert u == pytest.approx(float(line["u_poiseuille_mps"]), rel=1e-8, abs=1e-8 * example.TOP_SPEED)


def test_example(example, tmp_path):
    """As a program, with few particles: a twin is right although 12 particles are too few for exact data."""
    summaries = example.main(
        fits=["twin"], particles=12, precision="float64", noise=0.01, t_end=0.2, progress=False, out=tmp_path
    )
    twin = summaries["twin"]
    # four standard errors, which are those of the noise alone
    assert abs(twin["bias"]) < 4 * twin["standard_error"] / twin["true"]
    assert (tmp_path / "calibrate_viscosity.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="no fit is called"):
        example.main(fits=["other"])
