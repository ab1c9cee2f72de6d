"""The file of a run: what `simulate(..., out=...)` writes at each save."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import jax

from jaxsph.dynamics import topologies
from jaxsph.files.writer import TrajectoryWriter
from jaxsph.flow import pressure
from jaxsph.observe import stresses


class RunWriter(TrajectoryWriter):
    """A `TrajectoryWriter` for the states of a scene: their fields, what follows from them, and the restart.

    To the fields of each structure it adds `von_mises` (N,) and `cauchy_stress` (N, d, d) [Pa], to those of a fluid
    `density` (N,) [kg/m^3] and `pressure` (N,) [Pa].

    Args:
        path: file to write, by convention `*.vtkhdf`.
        scene: that is run; its parameters and its fingerprint are kept.
        found: from `topologies`, if it is at hand.
        metadata: anything that JSON holds, beside the scene's description.
        saves: number of saves expected.

    Raises ValueError as `TrajectoryWriter`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        scene: Any,
        found: dict | None = None,
        *,
        metadata: Mapping[str, Any] | None = None,
        saves: int | None = None,
    ) -> None:
        systems = {system.name: system.particles.positions for system in scene.systems}
        super().__init__(path, systems, metadata={"scene": str(scene), **(metadata or {})}, scene=scene, saves=saves)
        self._scene = scene
        self._found = topologies(scene) if found is None else found

    def __enter__(self) -> RunWriter:
        return self

    def append_state(self, state: Any) -> None:
        """Append a state of the scene and put it on disk. Raises ValueError as `append`."""
        self.save(state, jax.device_get(_derived(self._scene, state, self._found)))


@jax.jit
def _derived(scene, state, found):
    out = {}
    for structure in scene.structures:
        of_structure = stresses(scene, state, structure.name, found)
        out[structure.name] = {"von_mises": of_structure["von_mises"], "cauchy_stress": of_structure["cauchy"]}
    for fluid in scene.fluids:
        fields = state.systems[fluid.name]
        out[fluid.name] = {"density": fluid.density + fields["density_deviation"]}
        if "pressure" not in fields:  # else the state brings it
            out[fluid.name]["pressure"] = pressure(fluid, fields)
    return out
