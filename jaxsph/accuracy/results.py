"""The table of a study: a row for every run, with its settings, its errors and what it cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Number = float | int
Value = Number | str | bool | None
COSTS = ("seconds", "steps", "particle_steps", "memory")
MEASURES = ("seconds", "compile_seconds", "steps", "n_particles", "particle_steps", "memory", "time_step")


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes:
        settings: {name: number, text, bool or None}.
        errors: {name: error}, NaN of a run that failed.
        seconds: of the run, without compiling; compile_seconds: of tracing, compiling and warming up.
        steps, n_particles: of time, and of all systems together.
        memory: by how much the process grew at most while it ran [bytes], NaN where the system does not tell.
        time_step: [s], NaN for solvers that choose their own.
        failure: why it failed, else empty.
    """

    settings: dict[str, Value]
    errors: dict[str, float]
    seconds: float
    compile_seconds: float = math.nan
    steps: int = 0
    n_particles: int = 0
    memory: float = math.nan
    time_step: float = math.nan
    failure: str = ""

    @property
    def particle_steps(self) -> int:
        """Steps times particles."""
        return self.steps * self.n_particles


@dataclass(frozen=True, eq=False)
class Results:
    """Rows of a study. `results["seconds"]` is a column: of a setting, an error or a measure.

    Attributes:
        rows: one per run.
        resolution: name of the setting that refines: larger is finer. None if there is none.
        title: of the study.
    """

    rows: tuple[Row, ...]
    resolution: str | None = "particles"
    title: str = ""

    def __post_init__(self):
        object.__setattr__(self, "rows", tuple(self.rows))

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __add__(self, other: Results) -> Results:
        return self._with([*self.rows, *other.rows])

    @property
    def settings(self) -> list[str]:
        """Names of the settings, in the order in which they came."""
        return list(dict.fromkeys(name for row in self.rows for name in row.settings))

    @property
    def errors(self) -> list[str]:
        """Names of the errors."""
        return list(dict.fromkeys(name for row in self.rows for name in row.errors))

    @property
    def varied(self) -> list[str]:
        """Names of the settings that are not the same in all rows."""
        return [name for name in self.settings if len({row.settings.get(name) for row in self.rows}) > 1]

    def __getitem__(self, name: str) -> np.ndarray:
        """A column. Raises KeyError if there is none of this name."""
        if name in self.settings:
            return _column([row.settings.get(name) for row in self.rows])
        if name in MEASURES or name == "failure":
            return np.array([getattr(row, name) for row in self.rows])
        if name in self.errors:
            return np.array([row.errors.get(name, math.nan) for row in self.rows])
        raise KeyError(f"no column {name!r}; there are {', '.join([*self.settings, *self.errors, *MEASURES])}")

    @property
    def table(self) -> np.ndarray:
        """All columns as one structured array."""
        names = [*self.settings, *self.errors, *MEASURES]
        columns = {name: self[name] for name in names}
        kinds = [(name, column.dtype) for name, column in columns.items()]
        out = np.empty(len(self), dtype=kinds)
        for name, column in columns.items():
            out[name] = column
        return out

    def where(self, **settings: Value) -> Results:
        """The rows with these settings."""
        return self._with(r for r in self.rows if all(r.settings.get(k) == v for k, v in settings.items()))

    def error_name(self, error: str | None) -> str:
        """The error that is meant: the first without a name. Raises KeyError if there is no such one."""
        if not self.errors:
            raise KeyError("this table has no error: no run was made")
        if error is not None and error not in self.errors:
            raise KeyError(f"no error {error!r}; there are {', '.join(self.errors)}")
        return self.errors[0] if error is None else error

    def families(self) -> dict[tuple, list[int]]:
        """Indices of the rows that differ in nothing but the resolution, from coarse to fine, by their settings."""
        out: dict[tuple, list[int]] = {}
        names = [name for name in self.settings if name != self.resolution]
        for index, row in enumerate(self.rows):
            out.setdefault(tuple((name, row.settings.get(name)) for name in names), []).append(index)
        if self.resolution is not None:
            for members in out.values():
                members.sort(key=lambda i: float(self.rows[i].settings.get(self.resolution) or 0))  # type: ignore[arg-type]
        return out

    def reliable(self, error: str | None = None) -> np.ndarray:
        """The largest error of a run and of all finer ones of its family.

        An error that changes its sign on the way is small by chance somewhere: whoever took such a run for accurate
        would get worse by refining. NaN where a run failed.
        """
        errors = self[self.error_name(error)]
        out = np.array(errors, float)
        if self.resolution is None:
            return out
        for members in self.families().values():
            worst = math.nan
            for index in reversed(members):
                worst = np.fmax(worst, errors[index])
                out[index] = worst if np.isfinite(errors[index]) else math.nan
        return out

    def pareto(self, error: str | None = None, cost: str = "seconds") -> Results:
        """The rows that no other one beats in both, from cheap to accurate; errors are the `reliable` ones."""
        if cost not in COSTS:
            raise ValueError(f"cost {cost!r} must be one of {', '.join(COSTS)}")
        errors, costs = self.reliable(error), np.array(self[cost], float)
        front, lowest = [], math.inf
        for index in np.lexsort((errors, costs)):
            if np.isfinite(errors[index]) and np.isfinite(costs[index]) and errors[index] < lowest:
                lowest = errors[index]
                front.append(self.rows[index])
        return self._with(front)

    def label(self, row: Row, names: Iterable[str] | None = None) -> str:
        """What sets a row apart: its settings of these names, by default of those that vary."""
        shown = []
        for name in self.varied if names is None else names:
            value = row.settings.get(name)
            if isinstance(value, str):
                shown.append(value)
            elif value is not None:
                spaced = name.replace("_", " ")
                shown.append(f"{spaced} {value:.4g}" if isinstance(value, float) else f"{spaced} {value}")
        return ", ".join(shown)

    def save(self, path: str | Path) -> Path:
        """Write `.csv` or HDF5 (`.h5`, `.hdf5`); `Results.load` gives back the same."""
        from jaxsph.accuracy.tables import save

        return save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Results:
        """Read what `save` wrote.

        Raises ValueError for another suffix, or a file that is no such table.
        """
        from jaxsph.accuracy.tables import load

        return load(Path(path))

    def plot(self, path: str | Path | None = None, **options: Any):
        """Draw error against cost with the Pareto front, and write it if a path is given; see `accuracy.picture`."""
        from jaxsph.accuracy.picture import work_precision

        return work_precision(self, path, **options)

    def __str__(self) -> str:
        names = [*self.settings, *self.errors, "seconds", "compile_seconds", "steps", "n_particles", "memory"]
        lines = [[name.replace("_", " ") for name in names]]
        for row in self.rows:
            cells = [row.settings.get(name) for name in self.settings]
            cells += [row.errors.get(name, math.nan) for name in self.errors]
            cells += [row.seconds, row.compile_seconds, row.steps, row.n_particles, row.memory]
            lines.append([_text(cell) for cell in cells] + ([f"! {row.failure}"] if row.failure else []))
        widths = [max(len(line[i]) for line in lines) for i in range(len(names))]
        shown = [" ".join(f"{c:>{w}}" for c, w in zip(line, widths, strict=False)) for line in lines]
        for text, line in zip(range(len(shown)), lines, strict=True):
            shown[text] += f"  {line[-1]}" if len(line) > len(names) else ""
        return "\n".join([self.title, *shown] if self.title else shown)

    def _with(self, rows: Iterable[Row]) -> Results:
        return Results(tuple(rows), self.resolution, self.title)


def _column(values: list) -> np.ndarray:
    kinds = {type(value) for value in values}
    if kinds <= {int, float} or kinds == {bool}:
        return np.array(values)
    return np.array(["" if value is None else str(value) for value in values])


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3g}"
    return str(value)
