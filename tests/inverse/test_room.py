"""Room for neighbors in a fit: that of the runs at the start and at the ends of the bounds."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import inverse
from inverse.jaxsph_simulation import topologies_of_runs
from jaxsph import pytree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fluids import column  # pyright: ignore[reportMissingImports]


def test_ends_of_the_bounds_are_rehearsed_and_have_room():
    """Water that is thrown against a wall, up to four times as fast as at the start."""
    scene = column()
    scene = pytree.replace(scene, gravity=np.array([0.5, -1.0]))
    times = np.array([0.01, 0.02])
    unknown = {"gravity": inverse.linear((-4.0, -4.0), (4.0, 4.0), start=(0.5, -1.0), unit="m/s^2")}
    data = inverse.Observations(times, np.zeros(2))
    problem = inverse.Problem(scene, lambda run: jnp.mean(run["water"]["velocity"][..., 0], axis=1), data, unknown)
    simulation = problem.simulate
    values = [{"gravity": np.array(end)} for end in ((0.5, -1.0), (4.0, 4.0))]
    runs = simulation._rehearsals(lambda s, v: s.replace(v), scene, values, times)
    assert len(runs) == 2
    both, first = topologies_of_runs(runs), topologies_of_runs(runs[:1])
    for name in ("water-water", "water-tank"):
        sizes = [
            (part.capacity.slots, part.capacity.range, part.capacity.members or 0)
            for found in (both, first, topologies_of_runs(runs[1:]))
            for part in [found[name]]
        ]
        assert all(np.all(np.array(sizes[0]) >= others) for others in sizes[1:])
    fastest = max(float(np.abs(np.asarray(run["water"]["velocity"])).max()) for run in runs)
    assert simulation._options["max_speed"] >= fastest
