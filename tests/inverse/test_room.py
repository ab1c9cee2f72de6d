"""Room for neighbors in a fit: that of the runs at the start and at the ends of the bounds."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import inverse
import jaxsph
from inverse.jaxsph_simulation import topologies_of_runs

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fluids import column  # pyright: ignore[reportMissingImports]

START, HEAVY = (0.5, -1.0), (0.0, -40.0)
UNKNOWN = {"gravity": inverse.linear(HEAVY, (1.0, -1.0), start=START, unit="m/s^2")}
TIMES = np.array([0.05, 0.1])


def simulation_of():
    data = inverse.Observations(TIMES, np.zeros(2))
    seen = lambda run: jnp.mean(run["water"]["velocity"][..., 0], axis=1)  # noqa: E731
    return inverse.Problem(column(), seen, data, UNKNOWN).simulate


def test_lists_have_room_for_the_ends_of_the_bounds():
    """Water that falls under forty times the weight presses more particles together, faster than was expected."""
    simulation = simulation_of()
    values = [{"gravity": np.array(g)} for g in (START, HEAVY)]
    runs = simulation._rehearsals(lambda scene, v: scene.replace(v), column(), values, TIMES)
    of_start, of_end = (topologies_of_runs([run])["water-tank"].transpose.capacity for run in runs)
    assert of_end.slots > of_start.slots, "or there is nothing to see"
    assert simulation._options["topologies_of_scene"]["water-tank"].transpose.capacity.slots >= of_end.slots
    fastest = [float(np.max(np.linalg.norm(run["water"]["velocity"], axis=-1))) for run in runs]
    assert simulation._options["max_speed"] > fastest[1] > 2 * fastest[0]


def test_an_end_of_the_bounds_that_fails_is_left_out(monkeypatch):
    """The start must run; what is beyond it need not."""
    whole = jaxsph.simulate

    def fragile(scene, *args, **options):
        if float(scene.gravity[1]) < -2:
            raise jaxsph.SimulationError("it broke")
        return whole(scene, *args, **options)

    monkeypatch.setattr(jaxsph, "simulate", fragile)
    assert len(simulation_of()._options["topologies_of_scene"]) > 0
    values = [{"gravity": np.array(g)} for g in (HEAVY, START)]
    with pytest.raises(jaxsph.SimulationError, match="it broke"):
        simulation_of()._rehearsals(lambda scene, v: scene.replace(v), column(), values, TIMES)
