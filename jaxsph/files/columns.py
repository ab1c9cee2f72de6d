"""Fields as the columns of the file: which there are, what they look like, and what a save may hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Arrays = dict[str, dict[str, np.ndarray]]
"""system -> field -> array, particles first."""


@dataclass(frozen=True)
class Column:
    """One point array of the file: where it comes from and how it is stored."""

    field: str
    """Name of the field in jaxsph, e.g. `von_mises`."""
    components: tuple[int, ...]
    """() for a scalar, (d,) for a vector, (d, d) for a tensor; in the file 1, 3 and 9 components."""
    dtype: np.dtype
    unit: str
    systems: tuple[str, ...]
    """The systems that have this field; the others hold NaN (-1 for integers)."""

    @property
    def stored_shape(self) -> tuple[int, ...]:
        """Components in the file: vectors always have 3, tensors 9 (row by row), as VTK wants them."""
        return ((), (3,), (9,))[len(self.components)]

    @property
    def absent(self) -> float | int:
        """What particles hold that do not have this field."""
        return np.nan if self.dtype.kind == "f" else -1


def vtk_name(field: str) -> str:
    """Name of a field in the file: `von_mises` is `VonMises`."""
    return "".join(word[:1].upper() + word[1:] for word in field.split("_"))


def to_stored(value: np.ndarray, column: Column) -> np.ndarray:
    """Bring (N,), (N, d) or (N, d, d) to the components of the file; components beyond d are 0."""
    count, rank = value.shape[0], len(column.components)
    if rank == 0:
        return value.astype(column.dtype)
    stored = np.zeros((count, *(3,) * rank), column.dtype)
    stored[(slice(None), *(slice(0, n) for n in column.components))] = value
    return stored.reshape(count, *column.stored_shape)


def from_stored(stored: np.ndarray, components: tuple[int, ...]) -> np.ndarray:
    """Undo `to_stored` for an array with any leading axes."""
    rank = len(components)
    if rank == 0:
        return stored
    lead = stored.shape[:-1]
    full = stored.reshape(*lead, *(3,) * rank)
    return full[(..., *(slice(0, n) for n in components))]


def columns_of(arrays: Arrays, units: Mapping[str, str], dtype: np.dtype | None) -> dict[str, Column]:
    """Column of each field of the first save by its name in the file; `position` is the points, no column."""
    columns: dict[str, Column] = {}
    for field in dict.fromkeys(field for fields in arrays.values() for field in fields if field != "position"):
        holders = {name: fields[field] for name, fields in arrays.items() if field in fields}
        shapes = {value.shape[1:] for value in holders.values()}
        if len(shapes) > 1:
            raise ValueError(f"field {field} has components {sorted(shapes)} in different systems, expected one")
        stored = np.result_type(*holders.values())
        if stored.kind in "bu":
            stored = np.dtype(np.int64)  # absent is -1
        if stored.kind == "f" and dtype is not None:
            stored = dtype
        name = vtk_name(field)
        if name in columns or name in ("system", "identity"):
            raise ValueError(f"field {field} would be stored as {name}, which is taken; rename it")
        columns[name] = Column(field, shapes.pop(), stored, units.get(field, ""), tuple(holders))
    return columns


def points_column(positions: Arrays, dtype: np.dtype | None) -> Column:
    """Column of the points themselves, which all systems have."""
    given = {name: fields["position"] for name, fields in positions.items()}
    stored = dtype or np.result_type(*given.values())
    return Column("position", next(iter(given.values())).shape[1:], stored, "m", tuple(given))


def gather(column: Column, arrays: Arrays, reference: Mapping[str, np.ndarray]) -> np.ndarray:
    """One save of a column over the particles of all systems."""
    parts = [
        to_stored(arrays[system][column.field], column)
        if system in column.systems
        else np.full((len(positions), *column.stored_shape), column.absent, column.dtype)
        for system, positions in reference.items()
    ]
    return np.concatenate(parts)


def with_positions(arrays: Arrays, reference: Mapping[str, np.ndarray]) -> Arrays:
    """Where the particles stand: as given, or displaced from where they were at rest, or there."""
    placed = {}
    for name, rest in reference.items():
        fields = arrays.get(name, {})
        moved = rest + fields["displacement"] if "displacement" in fields else rest
        placed[name] = {"position": fields.get("position", moved)}
    return placed


def checked_systems(systems: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Reference positions as arrays; see `TrajectoryWriter` for what is refused."""
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
        raise ValueError(f"systems differ in dimension: { {n: x.shape[1] for n, x in checked.items()} }, expected one")
    return checked


def checked_fields(fields: Mapping[str, Mapping[str, Any]], reference: Mapping[str, np.ndarray]) -> Arrays:
    """Fields of a save as arrays of the right shapes."""
    checked: Arrays = {}
    for system, named in fields.items():
        if system not in reference:
            raise ValueError(f"no system {system!r} in this file, expected one of {sorted(reference)}")
        count, d = reference[system].shape
        checked[system] = {}
        for field, given in named.items():
            value = np.asarray(given)
            vector = field in ("position", "displacement")
            right = [(count, d)] if vector else [(count,), (count, d), (count, d, d)]
            if value.shape not in right or value.dtype.kind not in "biuf":
                raise ValueError(
                    f"{system}.{field} has shape {value.shape} and type {value.dtype}, expected numbers of "
                    f"shape {' or '.join(map(str, right))}: particles come first"
                )
            checked[system][field] = value
    return checked


def changed_fields(arrays: Arrays, columns: Mapping[str, Column]) -> list[str]:
    """Fields that this save has and the first had not, or the other way, or with other components."""
    expected = {(system, c.field): c.components for c in columns.values() for system in c.systems}
    found = {(s, f): v.shape[1:] for s, named in arrays.items() for f, v in named.items() if f != "position"}
    return sorted({".".join(key) for key, _ in found.items() ^ expected.items()})
