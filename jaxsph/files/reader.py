"""Reading a trajectory back."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from jaxsph.files import layout
from jaxsph.files.check import open_for_reading

Fields = dict[str, dict[str, np.ndarray]]


def read_trajectory(path: str | os.PathLike[str]) -> tuple[np.ndarray, Fields, dict[str, Any]]:
    """Read all saves of a run, also of one that was killed or still goes on.

    Returns:
        times (T,) [s]; system -> field -> array (T, N), (T, N, d) or (T, N, d, d) in the user's particle
        order, with `position` for each system; metadata: what the writer was given, and `versions`,
        `precision`, `created`, `dimension`, `units` (field -> unit), `systems` (name -> number of particles),
        `reference_positions` (name -> (N, d)).

    Raises:
        FileNotFoundError: nothing at `path`.
        ValueError: not an HDF5 file, cut short, without the groups of a trajectory, or of another format
            version.

    """
    with open_for_reading(path) as file:
        root, about = file["VTKHDF"], file["jaxsph"]
        saves = layout.committed(file)
        sizes = json.loads(about["systems"].asstr()[()])
        fields = json.loads(about["fields"].asstr()[()])
        dimension = int(about.attrs["dimension"])
        count = sum(sizes.values())

        def saved(name: str, components: tuple[int, ...]) -> np.ndarray:
            stored = root[name][: saves * count]
            return layout.from_stored(stored.reshape(saves, count, *stored.shape[1:]), components)

        starts = np.cumsum([0, *sizes.values()])
        part = {name: slice(starts[i], starts[i + 1]) for i, name in enumerate(sizes)}
        points = saved("Points", (dimension,))
        systems: Fields = {name: {"position": points[:, part[name]]} for name in sizes}
        for name, said in fields.items():
            values = saved(f"PointData/{name}", tuple(said["components"]))
            for system in said["systems"]:
                systems[system][said["field"]] = values[:, part[system]]
        metadata = {
            **json.loads(about["metadata"].asstr()[()]),
            "versions": {
                name: about.attrs[f"{name}_version"] for name in ("jaxsph", "jax", "numpy", "python")
            },
            "precision": about.attrs["precision"],
            "created": about.attrs["created"],
            "dimension": dimension,
            "units": {"position": "m", **{said["field"]: said["unit"] for said in fields.values()}},
            "systems": sizes,
            "reference_positions": {name: about[f"reference_positions/{name}"][()] for name in sizes},
        }
        return root["Steps/Values"][:saves], systems, metadata
