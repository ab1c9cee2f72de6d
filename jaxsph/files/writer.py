"""Saving a run while it goes on, so that a run that is killed leaves a readable file up to its last save."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import jax
import numpy as np

from jaxsph.files import layout, restart
from jaxsph.files.check import FORMAT_VERSION
from jaxsph.files.units import UNITS, parameters
from jaxsph.versions import __version__

# The oldest layout that holds all we write. Files of HDF5 1.10 and later carry an "open for writing" mark
# that a killed run would leave behind, and then neither h5py nor VTK opens them; older layouts have no such
# mark.
_HDF5_LAYOUT = ("earliest", "v108")
_FIRST_ROOM = 16


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
        if not self.path.absolute().parent.is_dir():
            raise ValueError(
                f"{path}: directory {self.path.absolute().parent} does not exist; create it first"
            )
        if self.path.is_dir():
            raise ValueError(f"{path}: is a directory; give the name of a file in it, such as run.vtkhdf")
        if saves is not None and saves < 1:
            raise ValueError(f"saves is {saves}, expected at least 1, or None when the number is not known")
        self._dtype = None if dtype is None else np.dtype(dtype)
        if self._dtype is not None and self._dtype.kind != "f":
            raise ValueError(f"dtype is {self._dtype}, expected a float type such as np.float32")
        self._reference = _checked_systems(systems)
        self._dimension = next(iter(self._reference.values())).shape[1]
        self._count = sum(len(x) for x in self._reference.values())
        self._units = {**UNITS, **(units or {})}
        self._metadata = dict(metadata or {})
        self._fingerprint = None
        if scene is not None:
            self._fingerprint = json.dumps(restart.fingerprint(scene))
            self._metadata.setdefault("parameters", parameters(scene, units))
        self._metadata = json.loads(json.dumps(self._metadata, default=_plain))
        self._room = saves or _FIRST_ROOM
        self._columns: dict[str, layout.Column] = {}
        self._point_dtype = np.dtype(np.float64)
        self._leaves: list[tuple[str, np.ndarray]] | None = None
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
        self.append(float(state.time), fields, state=state)

    def append(self, time: float, fields: Mapping[str, Mapping[str, Any]], *, state: Any = None) -> None:
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
            raise ValueError(
                f"{self.path}: the writer is closed; open a new one, with another path, to save more"
            )
        if not time > self._last_time:
            raise ValueError(
                f"{self.path}: save at {time} s does not come after the last one at {self._last_time} s"
            )
        arrays = self._checked_fields(fields)
        leaves = None if state is None else restart.leaves_with_names(state)
        if self.saved == 0:
            self._columns = self._columns_of(arrays)
            self._point_dtype = self._dtype or np.result_type(*self._positions(arrays).values())
            self._leaves = leaves
        self._check_unchanged(arrays, leaves)

        if self._file is None:
            self._file = self._new_file(self._room)
            self._write(self._file, time, arrays, leaves)
            os.replace(self._part, self.path)
        else:
            if self.saved == self._room:
                self._move(2 * self._room)
            self._write(self._file, time, arrays, leaves)
        self.saved += 1
        self._last_time = time

    def close(self) -> None:
        """Close the file, without the room that was not used. Closing twice does no harm."""
        if self._file is not None:
            if self.saved < self._room:
                self._move(self.saved)
            self._file.close()
            self._file = None
        if self.saved == 0 and not self._closed:
            self._part.unlink(missing_ok=True)  # the first save failed: nothing to keep
        self._closed = True

    @property
    def _part(self) -> Path:
        return self.path.with_name(self.path.name + ".part")

    def _write(self, file: h5py.File, time: float, arrays: dict[str, Any], leaves: list | None) -> None:
        """Fill in one save. The counters come last, after everything they vouch for has left this process."""
        rows = slice(self.saved * self._count, (self.saved + 1) * self._count)
        positions = self._positions(arrays)
        vector = layout.Column("position", (self._dimension,), self._point_dtype, "m", tuple(positions))
        file[layout.POINTS][rows] = np.concatenate([layout.to_stored(x, vector) for x in positions.values()])
        for name, column in self._columns.items():
            file[f"VTKHDF/PointData/{name}"][rows] = np.concatenate(
                [
                    layout.to_stored(arrays[system][column.field], column)
                    if system in column.systems
                    else np.full((len(x), *column.stored_shape), column.absent, column.dtype)
                    for system, x in self._reference.items()
                ]
            )
        slot = None if leaves is None else restart.write_slot(file, leaves)
        file.flush()
        if slot is not None:
            restart.commit_slot(file, slot)
        layout.commit(file, self.saved + 1, time)

    def _new_file(self, room: int) -> h5py.File:
        # no lock: a run can be watched in ParaView while it goes on
        file = h5py.File(self._part, "w", libver=_HDF5_LAYOUT, locking=False)
        names = list(self._reference)
        sizes = [len(x) for x in self._reference.values()]
        static = {
            "system": np.repeat(np.arange(len(names), dtype=np.int32), sizes),
            "identity": np.concatenate([np.arange(n, dtype=np.int64) for n in sizes]),
        }
        layout.create(file, room, self._columns, static, self._point_dtype, self._count)
        group = file.create_group("jaxsph")
        group.attrs["format_version"] = np.int64(FORMAT_VERSION)
        group.attrs["jaxsph_version"] = __version__
        group.attrs["jax_version"] = jax.__version__
        group.attrs["numpy_version"] = np.__version__
        group.attrs["python_version"] = platform.python_version()
        group.attrs["precision"] = str(self._point_dtype)
        group.attrs["created"] = datetime.now(UTC).isoformat(timespec="seconds")
        group.attrs["dimension"] = np.int64(self._dimension)
        group["systems"] = json.dumps(dict(zip(names, sizes, strict=True)))
        fields = {
            name: {"field": c.field, "unit": c.unit, "components": c.components, "systems": c.systems}
            for name, c in self._columns.items()
        }
        group["fields"] = json.dumps(fields)
        group["metadata"] = json.dumps(self._metadata)
        for name, positions in self._reference.items():
            group[f"reference_positions/{name}"] = positions
        if self._fingerprint is not None:
            group["fingerprint"] = self._fingerprint
        if self._leaves is not None:
            restart.create_slots(file, self._leaves)
        return file

    def _move(self, room: int) -> None:
        """Copy what is saved into a file with other room, which then takes the place of this one."""
        old, new = self._file, self._new_file(room)
        assert old is not None
        for name in (layout.POINTS, *(f"VTKHDF/PointData/{column}" for column in self._columns)):
            for save in range(self.saved):
                rows = slice(save * self._count, (save + 1) * self._count)
                new[name][rows] = old[name][rows]
        times = old["VTKHDF/Steps/Values"][: self.saved]
        new["VTKHDF/Steps/Values"].resize(times.shape)
        new["VTKHDF/Steps/Values"][:] = times
        new["jaxsph"].attrs.modify("created", old["jaxsph"].attrs["created"])
        if self._leaves is not None:
            slot = int(old["jaxsph/restart"].attrs["slot"])
            kept = [(name, np.asarray(old[f"jaxsph/restart/{slot}/{name}"][()])) for name, _ in self._leaves]
            restart.commit_slot(new, restart.write_slot(new, kept))
        layout.commit(new, self.saved, times[-1])
        old.close()
        os.replace(self._part, self.path)
        self._file, self._room = new, room

    def _positions(self, arrays: dict[str, Any]) -> dict[str, np.ndarray]:
        placed = {}
        for name, reference in self._reference.items():
            fields = arrays.get(name, {})
            placed[name] = fields.get("position", reference)
            if "position" not in fields and "displacement" in fields:
                placed[name] = reference + fields["displacement"]
        return placed

    def _columns_of(self, arrays: dict[str, Any]) -> dict[str, layout.Column]:
        columns: dict[str, layout.Column] = {}
        for field in dict.fromkeys(
            field for fields in arrays.values() for field in fields if field != "position"
        ):
            holders = {name: fields[field] for name, fields in arrays.items() if field in fields}
            shapes = {value.shape[1:] for value in holders.values()}
            if len(shapes) > 1:
                raise ValueError(
                    f"field {field} has components {sorted(shapes)} in different systems, expected one"
                )
            dtype = np.result_type(*holders.values())
            if dtype.kind in "bu":
                dtype = np.dtype(np.int64)  # absent is -1
            if dtype.kind == "f" and self._dtype is not None:
                dtype = self._dtype
            name = layout.vtk_name(field)
            if name in columns or name in ("system", "identity"):
                raise ValueError(f"field {field} would be stored as {name}, which is taken; rename it")
            columns[name] = layout.Column(
                field, shapes.pop(), dtype, self._units.get(field, ""), tuple(holders)
            )
        return columns

    def _checked_fields(self, fields: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, np.ndarray]]:
        d, checked = self._dimension, {}
        for system, named in fields.items():
            if system not in self._reference:
                raise ValueError(
                    f"no system {system!r} in this file, expected one of {sorted(self._reference)}"
                )
            count, checked[system] = len(self._reference[system]), {}
            for field, given in named.items():
                value = np.asarray(given)
                right = (
                    [(count, d)]
                    if field in ("position", "displacement")
                    else [(count,), (count, d), (count, d, d)]
                )
                if value.shape not in right or value.dtype.kind not in "biuf":
                    raise ValueError(
                        f"{system}.{field} has shape {value.shape} and type {value.dtype}, expected numbers "
                        f"of shape {' or '.join(map(str, right))}: particles come first"
                    )
                checked[system][field] = value
        return checked

    def _check_unchanged(self, arrays: dict[str, Any], leaves: list | None) -> None:
        expected = {(system, c.field): c.components for c in self._columns.values() for system in c.systems}
        found = {
            (s, f): v.shape[1:] for s, named in arrays.items() for f, v in named.items() if f != "position"
        }
        if found != expected:
            changed = sorted({".".join(key) for key, _ in found.items() ^ expected.items()})
            raise ValueError(
                f"{self.path}: fields of this save differ from the first save: {', '.join(changed)}; every "
                "save needs the same fields with the same components"
            )
        then, now = ([(n, v.dtype, v.shape) for n, v in (x or [])] for x in (self._leaves, leaves))
        if then != now:
            changed = sorted({leaf[0] for leaf in then} ^ {leaf[0] for leaf in now}) or [
                a[0] for a, b in zip(then, now, strict=False) if a != b
            ]
            raise ValueError(
                f"{self.path}: the state of this save differs from the first save in "
                f"{', '.join(changed[:5])}; every save needs a state with the same leaves, shapes and "
                "types, or none"
            )


def _checked_systems(systems: Mapping[str, Any]) -> dict[str, np.ndarray]:
    if not systems:
        raise ValueError("no system to save, expected at least one: name -> reference positions (N, d)")
    checked = {name: np.asarray(positions) for name, positions in systems.items()}
    for name, positions in checked.items():
        if positions.ndim != 2 or positions.shape[1] not in (1, 2, 3) or positions.dtype.kind != "f":
            raise ValueError(
                f"positions of system {name!r} have shape {positions.shape} and type {positions.dtype}, "
                "expected floats of shape (N, d) with d = 1, 2 or 3"
            )
        if "/" in name or not name:
            raise ValueError(f"system {name!r}: a name needs at least one character and no '/'")
    if len({positions.shape[1] for positions in checked.values()}) > 1:
        raise ValueError(
            f"systems differ in dimension: { {n: x.shape[1] for n, x in checked.items()} }, expected one"
        )
    return checked


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy and JAX as JSON holds them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise ValueError(
        f"metadata holds {value!r} of type {type(value).__name__}, expected what JSON holds, or an array"
    )
