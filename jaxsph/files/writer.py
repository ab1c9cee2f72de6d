"""Saving a run while it goes on, so that a run that is killed leaves a readable file up to its last save."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, SupportsFloat

import h5py
import numpy as np

from jaxsph.files import columns, hdf5, layout, restart
from jaxsph.files.describe import describe, plain
from jaxsph.files.leaves import Leaves, array_leaves
from jaxsph.files.units import UNITS, parameters

# The oldest layout that holds all we write. Files of HDF5 1.10 and later carry an "open for writing" mark
# that a killed run would leave behind, and then neither h5py nor VTK opens them; older layouts have no such
# mark.
_HDF5_LAYOUT = ("earliest", "v108")
_FIRST_ROOM = 16


def check_place(path: str | os.PathLike[str]) -> None:
    """Raise ValueError unless a file can be made at a path: its directory exists, and it is none itself."""
    parent = Path(path).absolute().parent
    if not parent.is_dir():
        raise ValueError(f"{path}: directory {parent} does not exist; create it first")
    if Path(path).is_dir():
        raise ValueError(f"{path}: is a directory; give the name of a file in it, such as run.vtkhdf")


class TrajectoryWriter:
    """Writes saves of a run to one HDF5 file that ParaView opens (VTKHDF PolyData with time steps).

    The file appears at `path` with the first save, in place of an older one. Each save is on disk when
    `append`
    returns: fields and state first, the counters that make them valid last. When `saves` is not stated, or
    more come, the file is copied to one with twice the room, which then takes its place; closing gives back
    what was not used.

    Args:
        path: file to write, by convention `*.vtkhdf`.
        systems: name -> reference positions (N, d) [m] of each system, in the user's particle order.
        metadata: anything that JSON holds, kept with the file and given back by `read_trajectory`.
        scene: its fingerprint is kept for `read_state(..., scene=)`, and the list of its parameters unless
            `metadata` has "parameters".
        units: field -> unit, beside the SI units in `jaxsph.files.UNITS`.
        dtype: float type of positions and fields in the file (np.float32 halves it); None keeps what is
            given. The restart state always keeps its own types.
        saves: number of saves expected; the file gets room for them at once.

    Raises:
        ValueError: no system, positions that are not (N, d) with one d in 1, 2, 3 for all, a dtype that is
            not float, saves below 1, metadata that JSON does not hold, a directory that does not exist.

    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        systems: Mapping[str, Any],
        *,
        metadata: Mapping[str, Any] | None = None,
        scene: Any = None,
        units: Mapping[str, str] | None = None,
        dtype: Any = None,
        saves: int | None = None,
    ) -> None:
        self.path = Path(path)
        check_place(path)
        if saves is not None and saves < 1:
            raise ValueError(f"saves is {saves}, expected at least 1, or None when the number is not known")
        self._dtype = None if dtype is None else np.dtype(dtype)
        if self._dtype is not None and self._dtype.kind != "f":
            raise ValueError(f"dtype is {self._dtype}, expected a float type such as np.float32")
        self._reference = columns.checked_systems(systems)
        self._count = sum(len(x) for x in self._reference.values())
        self._units = {**UNITS, **(units or {})}
        self._metadata = plain(metadata or {})
        self._fingerprint = None
        if scene is not None:
            self._fingerprint = json.dumps(restart.fingerprint(scene))
            self._metadata.setdefault("parameters", parameters(scene, units))
        self._room = saves or _FIRST_ROOM
        # the first save says which columns there are and of which types
        self._columns: dict[str, columns.Column] = {}
        self._points = columns.Column("position", (), np.dtype(np.float64), "m", ())
        self._leaves: Leaves | None = None
        self._file: h5py.File | None = None
        self._closed = False
        self._last_time = -np.inf
        self.saved = 0
        """Number of saves in the file."""

    def __enter__(self) -> TrajectoryWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def save(self, state: Any, derived: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        """Append a `State`: the fields of its systems, `derived` ones such as stresses, and the restart."""
        fields = {name: {**state.systems[name], **(derived or {}).get(name, {})} for name in state.systems}
        self.append(state.time, fields, state=state)

    def append(self, time: SupportsFloat, fields: Mapping[str, Mapping[str, Any]], *, state: Any = None) -> None:
        """Append one save and put it on disk.

        Args:
            time: physical time [s], larger than that of the save before.
            fields: system -> field -> array: scalars (N,), vectors (N, d), tensors (N, d, d). Particles stand
                at `position` if it is there, else at reference position + `displacement`, else where they
                were at rest. Every save has the fields of the first one.
            state: any pytree of arrays; kept bit for bit for `read_state`, in place of the one before.

        Raises:
            ValueError: closed writer, time that does not grow, unknown system, other fields, shapes or types
                than before, state with other leaves than before.

        """
        if self._closed:
            raise ValueError(f"{self.path}: the writer is closed; open a new one, with another path, to save more")
        time = float(time)
        if not time > self._last_time:
            raise ValueError(f"{self.path}: save at {time} s does not come after the last one at {self._last_time} s")
        arrays = columns.checked_fields(fields, self._reference)
        positions = columns.with_positions(arrays, self._reference)
        leaves = None if state is None else array_leaves(state)
        if self.saved == 0:
            self._columns = columns.columns_of(arrays, self._units, self._dtype)
            self._points = columns.points_column(positions, self._dtype)
            self._leaves = leaves
        self._check_unchanged(arrays, leaves)

        if self.saved == 0:
            self._file = self._new_file(self._room)
        elif self.saved == self._room:
            self._move(2 * self._room)
        assert self._file is not None
        self._write(self._file, time, arrays, positions, leaves)
        if self.saved == 0:
            os.replace(self._part, self.path)
        self.saved += 1
        self._last_time = time

    def close(self) -> None:
        """Close the file, without the room that was not used. Closing twice does no harm."""
        if self._file is not None:
            if 0 < self.saved < self._room:
                self._move(self.saved)
            self._file.close()
            self._file = None
            self._part.unlink(missing_ok=True)  # is there only when a save or a move has failed
        self._closed = True

    @property
    def _part(self) -> Path:
        return self.path.with_name(self.path.name + ".part")

    def _write(
        self,
        file: h5py.File,
        time: float,
        arrays: columns.Arrays,
        positions: columns.Arrays,
        leaves: Leaves | None,
    ) -> None:
        """Fill in one save. The counters come last, after everything they vouch for has left this process."""
        rows = slice(self.saved * self._count, (self.saved + 1) * self._count)
        hdf5.dataset(file, layout.POINTS)[rows] = columns.gather(self._points, positions, self._reference)
        for name, column in self._columns.items():
            stored = columns.gather(column, arrays, self._reference)
            hdf5.dataset(file, f"VTKHDF/PointData/{name}")[rows] = stored
        slot = None if leaves is None else restart.write_slot(file, leaves)
        file.flush()
        if slot is not None:
            restart.commit_slot(file, slot)
        layout.commit(file, self.saved + 1, time)

    def _new_file(self, room: int) -> h5py.File:
        # no lock: a run can be watched in ParaView while it goes on
        file = h5py.File(self._part, "w", libver=_HDF5_LAYOUT, locking=False)
        sizes = [len(x) for x in self._reference.values()]
        static = {
            "system": np.repeat(np.arange(len(sizes), dtype=np.int32), sizes),
            "identity": np.concatenate([np.arange(n, dtype=np.int64) for n in sizes]),
        }
        layout.create(file, room, self._columns, static, self._points.dtype, self._count)
        describe(file, self._reference, self._columns, self._points.dtype, self._metadata, self._fingerprint)
        if self._leaves is not None:
            restart.create_slots(file, self._leaves)
        return file

    def _move(self, room: int) -> None:
        """Copy what is saved into a file with other room, which then takes the place of this one."""
        old, new = self._file, self._new_file(room)
        assert old is not None
        for name in (layout.POINTS, *(f"VTKHDF/PointData/{column}" for column in self._columns)):
            source, target = hdf5.dataset(old, name), hdf5.dataset(new, name)
            for save in range(self.saved):
                rows = slice(save * self._count, (save + 1) * self._count)
                target[rows] = source[rows]
        saved_times = hdf5.array(old, "VTKHDF/Steps/Values")
        times = hdf5.dataset(new, "VTKHDF/Steps/Values")
        times.resize(saved_times.shape)
        times[:] = saved_times
        hdf5.group(new, "jaxsph").attrs["created"] = hdf5.attribute(old, "jaxsph", "created")
        if self._leaves is not None:
            slot = int(hdf5.attribute(old, "jaxsph/restart", "slot"))
            kept = [(name, hdf5.array(old, f"jaxsph/restart/{slot}/{name}")) for name, _ in self._leaves]
            restart.commit_slot(new, restart.write_slot(new, kept))
        layout.commit(new, self.saved, float(saved_times[-1]))
        old.close()
        os.replace(self._part, self.path)
        self._file, self._room = new, room

    def _check_unchanged(self, arrays: columns.Arrays, leaves: Leaves | None) -> None:
        changed = columns.changed_fields(arrays, self._columns)
        if changed:
            raise ValueError(
                f"{self.path}: fields of this save differ from the first save: {', '.join(changed)}; every "
                "save needs the same fields with the same components"
            )
        changed = restart.changed_leaves(self._leaves or [], leaves or [])
        if changed:
            raise ValueError(
                f"{self.path}: the state of this save differs from the first save in "
                f"{', '.join(changed[:5])}; every save needs a state with the same leaves, shapes and "
                "types, or none"
            )
