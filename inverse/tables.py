"""Named columns of numbers from CSV and HDF5 files; complaints name the file, the column and the line."""

from __future__ import annotations

import csv
import pathlib
from abc import ABC, abstractmethod
from typing import Any

import numpy as np


class Table(ABC):
    """A file that holds named columns.

    names: the columns. place(i): where sample i stands, for messages.
    """

    path: pathlib.Path
    names: list[str]

    @abstractmethod
    def column(self, name: str) -> np.ndarray:
        """(T,) finite numbers of one column; ValueError where they are not."""

    @abstractmethod
    def place(self, index: int) -> str:
        """Where a sample stands."""


class CsvTable(Table):
    """A CSV file with a header line; empty lines and lines that start with # are passed over."""

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [(number, [cell.strip() for cell in row]) for number, row in enumerate(csv.reader(file), 1)]
        self._lines = [(number, row) for number, row in lines if any(row) and not row[0].startswith("#")]
        if len(self._lines) < 2:
            raise ValueError(
                f"{path}: a header and at least one line of numbers are needed, found {len(self._lines)} lines"
            )
        self.names = self._lines[0][1]

    def place(self, index: int) -> str:
        return f"line {self._lines[index + 1][0]}"

    def column(self, name: str) -> np.ndarray:
        if name not in self.names:
            raise ValueError(f"{self.path}: no column {name!r}; line {self._lines[0][0]} names {', '.join(self.names)}")
        position = self.names.index(name)
        numbers = np.empty(len(self._lines) - 1)
        for i, (line, cells) in enumerate(self._lines[1:]):
            text = cells[position] if position < len(cells) else ""
            try:
                numbers[i] = float(text)
            except ValueError:
                raise ValueError(
                    f"{self.path}, line {line}, column {name!r}: {text!r} is not a number; fill it "
                    "in or delete the line"
                ) from None
            if not np.isfinite(numbers[i]):
                raise ValueError(
                    f"{self.path}, line {line}, column {name!r}: {text} is not finite; fill it in or delete the line"
                )
        return numbers


class Hdf5Table(Table):
    """An HDF5 file; its columns are the datasets, by path."""

    def __init__(self, path: pathlib.Path) -> None:
        import h5py

        self.path = path
        self._columns: dict[str, np.ndarray] = {}

        def collect(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                self._columns[name] = np.asarray(item[()])

        with h5py.File(path, "r") as file:
            file.visititems(collect)
        self.names = list(self._columns)

    def place(self, index: int) -> str:
        return f"index {index}"

    def column(self, name: str) -> np.ndarray:
        if name not in self._columns:
            raise ValueError(f"{self.path}: no dataset {name!r}; the file holds {', '.join(self.names) or 'none'}")
        raw = self._columns[name]
        if raw.ndim != 1 or raw.dtype.kind not in "iuf":
            raise ValueError(
                f"{self.path}, dataset {name!r}: shape {raw.shape} of {raw.dtype} where a vector of "
                "numbers (T,) is needed"
            )
        wrong = np.flatnonzero(~np.isfinite(raw))
        if wrong.size:
            raise ValueError(f"{self.path}, dataset {name!r}, index {wrong[0]}: {raw[wrong[0]]} is not finite")
        return raw.astype(float)


def read_times(table: Table, name: str) -> np.ndarray:
    """(T,) strictly increasing times."""
    times = table.column(name)
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        i = int(late[0]) + 1
        raise ValueError(
            f"{table.path}, {table.place(i)}, column {name!r}: times must increase, but "
            f"{times[i]:g} follows {times[i - 1]:g}; sort the samples and drop repeated ones"
        )
    return times


def read_values(table: Table, time: str, columns: Any, noise: Any, length: int) -> tuple[list[str], np.ndarray]:
    """Names (m) and values (T, m) of the observed columns; every column but time and noise by default."""
    if columns is None:
        chosen = [name for name in table.names if name != time and name not in _entries(noise)]
    else:
        chosen = [columns] if isinstance(columns, str) else list(columns)
    if not chosen:
        raise ValueError(f"{table.path}: no observed column beside {time!r}; name them with columns=[...]")
    return chosen, _stacked(table, [table.column(name) for name in chosen], chosen, length)


def read_noise(table: Table, noise: Any, chosen: list[str], length: int) -> np.ndarray:
    """(T, m) standard deviations from a number, a column, or a list of either."""
    entries = _entries(noise)
    if len(entries) not in (1, len(chosen)):
        raise ValueError(
            f"{table.path}: noise={noise!r} has {len(entries)} entries for {len(chosen)} observed "
            f"columns {', '.join(chosen)}; give one, or one per column"
        )
    parts = []
    for entry in entries:
        part = table.column(entry) if isinstance(entry, str) else np.full(length, float(entry))
        wrong = np.flatnonzero(~(part > 0))
        if wrong.size and isinstance(entry, str):
            i = int(wrong[0])
            raise ValueError(
                f"{table.path}, {table.place(i)}, column {entry!r}: a standard deviation of {part[i]:g} must be > 0"
            )
        if wrong.size:
            raise ValueError(f"{table.path}: noise={entry} must be a standard deviation > 0, or None if unknown")
        parts.append(part)
    return _stacked(table, parts * (len(chosen) // len(parts)), chosen, length)


def _entries(noise: Any) -> list[Any]:
    return list(noise) if isinstance(noise, (list, tuple)) else [noise]


def _stacked(table: Table, parts: list[np.ndarray], names: list[str], length: int) -> np.ndarray:
    for name, part in zip(names, parts, strict=True):
        if len(part) != length:
            raise ValueError(f"{table.path}: {name!r} has {len(part)} samples beside {length} times")
    return np.stack(parts, axis=1)
