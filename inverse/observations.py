"""What was measured: times, values and standard deviations, from arrays, CSV or HDF5."""

from __future__ import annotations

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from inverse.tables import CsvTable, Hdf5Table, Table, read_noise, read_times, read_values


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Observations:
    """A measured time series.

    Args:
        times: (T,) strictly increasing, >= 0 [s].
        values: (T,) or (T, m), in the unit of the observed quantity.
        standard_deviations: of the noise, same unit: a number, (m,), (T,), (T, m), or None where it is
            unknown (the fit then estimates it from the residual).
        columns: m names, for reports.
        source: where the numbers come from, for messages.

    Raises:
        ValueError: shapes that do not fit, values that are not finite, times that do not increase, standard
            deviations that are not positive.

    """

    times: np.ndarray
    values: np.ndarray
    standard_deviations: np.ndarray | None
    columns: tuple[str, ...]
    source: str

    def __init__(
        self,
        times: Any,
        values: Any,
        standard_deviations: Any = None,
        columns: Sequence[str] = (),
        source: str = "observations",
    ) -> None:
        object.__setattr__(self, "source", source)
        times = np.array(times, dtype=float)
        values = np.array(values, dtype=float)
        if times.ndim != 1 or times.size == 0:
            raise ValueError(f"{self.source}: times have shape {times.shape}; give a vector (T,) with T >= 1")
        if values.ndim not in (1, 2) or len(values) != len(times):
            raise ValueError(
                f"{self.source}: values of shape {values.shape} do not fit {len(times)} times; "
                f"give ({len(times)},) or ({len(times)}, m)"
            )
        _check_finite(self.source, "times", times)
        _check_finite(self.source, "values", values)
        if times[0] < 0:
            raise ValueError(
                f"{self.source}: times[0] = {times[0]:g} s is before the run starts at 0 s; shift the "
                "times or leave those samples out with window=(0, ...)"
            )
        late = np.flatnonzero(np.diff(times) <= 0)
        if late.size:
            i = late[0] + 1
            raise ValueError(
                f"{self.source}: times must increase, but times[{i}] = {times[i]:g} s follows "
                f"times[{i - 1}] = {times[i - 1]:g} s; sort the samples and drop repeated ones"
            )
        width = 1 if values.ndim == 1 else values.shape[1]
        columns = tuple(columns) or (("value",) if width == 1 else tuple(f"value[{i}]" for i in range(width)))
        if len(columns) != width:
            raise ValueError(f"{self.source}: {len(columns)} column names {columns} for {width} columns of values")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "columns", columns)
        if standard_deviations is not None:
            standard_deviations = self._checked_deviations(standard_deviations, values)
        object.__setattr__(self, "standard_deviations", standard_deviations)

    def _checked_deviations(self, given: Any, values: np.ndarray) -> np.ndarray:
        given = np.array(given, dtype=float)
        if values.ndim == 2 and given.shape == (len(values),) and given.shape != (values.shape[1],):
            given = given[:, None]
        try:
            deviations = np.broadcast_to(given, values.shape).copy()
        except ValueError:
            raise ValueError(
                f"{self.source}: standard deviations of shape {given.shape} do not fit values of shape "
                f"{values.shape}; give a number, one per column or one per value"
            ) from None
        wrong = ~(np.isfinite(deviations) & (deviations > 0))
        if np.any(wrong):
            where = [int(i) for i in np.argwhere(wrong)[0]]
            raise ValueError(
                f"{self.source}: standard deviation {deviations[tuple(where)]:g} at sample {where[0]} "
                "must be a finite number > 0; leave it out (None) where the noise is unknown"
            )
        return deviations

    def __len__(self) -> int:
        return len(self.times)

    @property
    def amplitude(self) -> np.ndarray:
        """(m,) half the range of each column: what relative noise refers to."""
        return 0.5 * np.ptp(self.values.reshape(len(self), -1), axis=0)

    def with_noise(self, relative: float | None = None, absolute: float | None = None, seed: int = 0) -> Observations:
        """A noisy twin: independent normal noise added, its standard deviation recorded.

        Args:
            relative: standard deviation as a fraction of the amplitude (half the range) of each column.
            absolute: standard deviation in the unit of the values, instead.
            seed: of NumPy's generator.

        """
        if (relative is None) == (absolute is None):
            raise ValueError(f"with_noise(relative={relative}, absolute={absolute}): give one of the two")
        level: Any = absolute if relative is None else relative
        if not (np.isfinite(level) and level > 0):
            raise ValueError(f"with_noise: a noise level of {level} must be a finite number > 0")
        deviations = np.broadcast_to(
            level if relative is None else relative * self.amplitude, self.values.reshape(len(self), -1).shape
        ).reshape(self.values.shape)
        noise = np.random.default_rng(seed).standard_normal(self.values.shape)
        return dataclasses.replace(self, values=self.values + deviations * noise, standard_deviations=deviations)

    def select(self, window: tuple[float, float] | None = None, every: int = 1) -> Observations:
        """The samples with t0 <= t <= t1 [s], and of those every `every`-th."""
        if int(every) != every or every < 1:
            raise ValueError(f"{self.source}: every={every} must be a whole number >= 1")
        first, last = (self.times[0], self.times[-1]) if window is None else window
        if not first < last and len(self) > 1:
            raise ValueError(f"{self.source}: window=({first}, {last}) must begin before it ends")
        slack = 1e-9 * abs(self.times[-1])  # a sample at the edge that was written with few digits still counts
        if window is not None and last > self.times[-1] + max(slack, np.max(np.diff(self.times), initial=0.0)):
            raise ValueError(
                f"{self.source}: window=({first:g}, {last:g}) s ends after the last sample at "
                f"{self.times[-1]:g} s; end the window there"
            )
        keep = np.flatnonzero((self.times >= first - slack) & (self.times <= last + slack))[:: int(every)]
        if keep.size == 0:
            raise ValueError(
                f"{self.source}: no sample in window=({first:g}, {last:g}) s; the times run from "
                f"{self.times[0]:g} to {self.times[-1]:g} s"
            )
        deviations = self.standard_deviations
        return dataclasses.replace(
            self,
            times=self.times[keep],
            values=self.values[keep],
            standard_deviations=None if deviations is None else deviations[keep],
        )

    @classmethod
    def from_csv(
        cls,
        path: Any,
        time: str = "t_s",
        columns: Sequence[str] | str | None = None,
        noise: Any = None,
        window: tuple[float, float] | None = None,
        every: int = 1,
    ) -> Observations:
        """Read a CSV file with one header line; empty lines and lines that start with # are passed over.

        Args:
            path: the file.
            time: name of the column of times [s].
            columns: names of the observed columns: a list gives values (T, m), a single name (T,); by
                default every other column, in the order of the file.
            noise: standard deviation: a number, the name of a column, a list of either (one per observed
                column), or None.
            window: (t0, t1) [s], the part of the record to keep.
            every: keep every n-th sample of the window.

        Raises:
            ValueError: names the file, the column and the line.

        """
        table = CsvTable(pathlib.Path(path))
        return cls._from_table(table, time, columns, noise).select(window, every)

    @classmethod
    def from_hdf5(
        cls,
        path: Any,
        time: str = "t_s",
        columns: Sequence[str] | str | None = None,
        noise: Any = None,
        window: tuple[float, float] | None = None,
        every: int = 1,
    ) -> Observations:
        """Read vectors (T,) from an HDF5 file; arguments as for `from_csv`, names are paths of datasets."""
        table = Hdf5Table(pathlib.Path(path))
        return cls._from_table(table, time, columns, noise).select(window, every)

    @classmethod
    def _from_table(cls, table: Table, time: str, columns: Any, noise: Any) -> Observations:
        times = read_times(table, time)
        chosen, values = read_values(table, time, columns, noise, len(times))
        deviations = None if noise is None else read_noise(table, noise, chosen, len(times))
        if isinstance(columns, str):
            values = values[:, 0]
            deviations = None if deviations is None else deviations[:, 0]
        return cls(times, values, deviations, tuple(chosen), str(table.path))


def _check_finite(source: str, what: str, numbers: np.ndarray) -> None:
    wrong = np.argwhere(~np.isfinite(numbers))
    if wrong.size:
        where = tuple(int(i) for i in wrong[0])
        raise ValueError(f"{source}: {what}{list(where)} = {numbers[where]} is not finite; drop that sample")
