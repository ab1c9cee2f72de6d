"""Reading a trajectory back."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from jaxsph.files import columns, hdf5, layout
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
        saves = layout.committed(file)
        sizes = hdf5.from_json(file, "jaxsph/systems")
        fields = hdf5.from_json(file, "jaxsph/fields")
        dimension = int(hdf5.attribute(file, "jaxsph", "dimension"))
        count = sum(sizes.values())

        def saved(name: str, components: tuple[int, ...]) -> np.ndarray:
            stored = np.asarray(hdf5.dataset(file, name)[: saves * count])
            return columns.from_stored(stored.reshape(saves, count, *stored.shape[1:]), components)

        starts = np.cumsum([0, *sizes.values()])
        part = {name: slice(starts[i], starts[i + 1]) for i, name in enumerate(sizes)}
        points = saved(layout.POINTS, (dimension,))
        systems: Fields = {name: {"position": points[:, part[name]]} for name in sizes}
        for name, said in fields.items():
            values = saved(f"VTKHDF/PointData/{name}", tuple(said["components"]))
            for system in said["systems"]:
                systems[system][said["field"]] = values[:, part[system]]
        about = {key: hdf5.attribute(file, "jaxsph", key) for key in ("precision", "created")}
        versions = {
            name: hdf5.attribute(file, "jaxsph", f"{name}_version") for name in ("jaxsph", "jax", "numpy", "python")
        }
        metadata = {
            **hdf5.from_json(file, "jaxsph/metadata"),
            **about,
            "versions": versions,
            "dimension": dimension,
            "units": {"position": "m", **{said["field"]: said["unit"] for said in fields.values()}},
            "systems": sizes,
            "reference_positions": {name: hdf5.array(file, f"jaxsph/reference_positions/{name}") for name in sizes},
        }
        return hdf5.array(file, "VTKHDF/Steps/Values")[:saves], systems, metadata
