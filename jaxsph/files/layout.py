"""The datasets of a temporal VTKHDF PolyData, with room for a stated number of saves.

Source: VTKHDF format specification 2.x (docs.vtk.org, "VTKHDF format specification"). The points of all saves
lie one after the other in one dataset, and so does each field; `Steps` says where each save begins. Topology,
`system` and `identity` do not change, so they are stored once and every step points at the same place.

Every dataset has its place in the file from the start. A save then only fills in numbers and moves two
counters: no B-tree and no address changes, and there is no moment at which a killed run leaves half-written
HDF5 metadata (chunked datasets that grow by new chunks do have such moments). Room that is not filled yet is
a hole: it takes no disk space on file systems with sparse files.
"""

from __future__ import annotations

from collections.abc import Mapping

import h5py
import numpy as np

from jaxsph.files import hdf5
from jaxsph.files.columns import Column

POINTS = "VTKHDF/Points"
_TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")


def create(
    file: h5py.File,
    saves: int,
    columns: Mapping[str, Column],
    static: Mapping[str, np.ndarray],
    point_dtype: np.dtype,
    count: int,
) -> None:
    """Lay out `/VTKHDF` for `saves` saves of `count` particles; nothing is saved yet (`NSteps` is 0)."""
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array([2, 0], np.int64)
    # fixed length ASCII: readers older than VTK 9.3 refuse the variable-length string h5py would write
    root.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", len(b"PolyData")))

    root["NumberOfPoints"] = np.array([count], np.int64)
    for topology in _TOPOLOGIES:
        cells = count if topology == "Vertices" else 0  # a vertex cell per particle: ParaView shows them at once
        root[f"{topology}/NumberOfCells"] = np.array([cells], np.int64)
        root[f"{topology}/NumberOfConnectivityIds"] = np.array([cells], np.int64)
        root[f"{topology}/Connectivity"] = np.arange(cells, dtype=np.int64)
        root[f"{topology}/Offsets"] = np.arange(cells + 1, dtype=np.int64)
    _reserve(file, POINTS, (saves * count, 3), point_dtype)
    for name, column in columns.items():
        _reserve(file, f"VTKHDF/PointData/{name}", (saves * count, *column.stored_shape), column.dtype)
    for name, value in static.items():
        root[f"PointData/{name}"] = value

    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    moving, resting = np.arange(saves, dtype=np.int64) * count, np.zeros(saves, np.int64)
    # VTK reads all of Values into memory for NSteps numbers, so its length has to follow NSteps. It lies in
    # one chunk, which is in the file from the start: growing changes one number in one place.
    steps.create_dataset("Values", (1,), np.float64, maxshape=(saves,), chunks=(saves,), data=[np.nan])
    steps["PartOffsets"] = resting
    steps["NumberOfParts"] = np.ones(saves, np.int64)
    steps["PointOffsets"] = moving
    steps["CellOffsets"] = np.zeros((saves, len(_TOPOLOGIES)), np.int64)
    steps["ConnectivityIdOffsets"] = np.zeros((saves, len(_TOPOLOGIES)), np.int64)
    for name in columns:
        steps[f"PointDataOffsets/{name}"] = moving
    for name in static:
        steps[f"PointDataOffsets/{name}"] = resting


def commit(file: h5py.File, saved: int, time: float) -> None:
    """Declare `saved` saves valid, the last one at `time`, once their numbers have left this process.

    NSteps goes first: VTK overruns its memory when Values is the longer one. A run that is killed between the
    two leaves a last step without a time, which `read_trajectory` does not count.
    """
    hdf5.group(file, "VTKHDF/Steps").attrs.modify("NSteps", np.int64(saved))
    file.flush()
    times = hdf5.dataset(file, "VTKHDF/Steps/Values")
    times.resize((saved,))
    times[saved - 1] = time
    file.flush()


def committed(file: h5py.File) -> int:
    """Number of valid saves."""
    steps = int(hdf5.attribute(file, "VTKHDF/Steps", "NSteps"))
    return min(steps, len(hdf5.dataset(file, "VTKHDF/Steps/Values")))


def _reserve(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype) -> None:
    """Give a dataset its place in the file now, without writing the bytes."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    file.create_dataset(name, shape, dtype, dcpl=properties)
