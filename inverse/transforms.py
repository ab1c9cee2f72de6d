"""Unknowns with bounds and a scale: the maps between a value and the internal coordinate z of a fit.

A fit moves in z, where a step of one is a bold but sensible step: a factor e for `log`, a quarter of the
range for `linear`. That makes one trust radius and one step tolerance fit moduli of 1e6 Pa and angles of .1
rad alike.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

STEPS_PER_RANGE = 4.0  # a step of one in the internal coordinate of `linear` is a quarter of the range


@dataclasses.dataclass(frozen=True, eq=False)
class Transform(ABC):
    """Bounds, start and scale of one unknown, a number or an array (then each entry is an unknown).

    lower, upper, start: arrays of the unknown's shape, in the unknown's unit.
    """

    lower: np.ndarray
    upper: np.ndarray
    start: np.ndarray
    unit: str = ""

    @property
    def shape(self) -> tuple[int, ...]:
        return self.start.shape

    @abstractmethod
    def internal(self, value: Any) -> np.ndarray:
        """Internal coordinate z of a value (same shape)."""

    @abstractmethod
    def value(self, z: Any) -> np.ndarray:
        """Value at the internal coordinate z (same shape)."""

    @abstractmethod
    def slope(self, z: Any) -> np.ndarray:
        """D value / d z, entry by entry (the delta method and the chain rule both need it)."""

    @abstractmethod
    def relative(self, z: Any, standard_error: Any) -> np.ndarray:
        """Standard error in z as a fraction: of the value for `log`, of the range for `linear`."""


class Log(Transform):
    """z = ln(value): steps are factors, and the value stays positive."""

    def internal(self, value: Any) -> np.ndarray:
        return np.asarray(np.log(np.asarray(value, dtype=float)))

    def value(self, z: Any) -> np.ndarray:
        # exp(log(bound)) may miss the bound by a rounding error, which a strict simulator would refuse
        return np.asarray(np.clip(np.exp(z), self.lower, self.upper))

    def slope(self, z: Any) -> np.ndarray:
        return np.asarray(np.exp(z))

    def relative(self, z: Any, standard_error: Any) -> np.ndarray:
        return np.asarray(standard_error)


class Linear(Transform):
    """z = 4 (value - lower) / (upper - lower): steps are fractions of the range."""

    @property
    def _scale(self) -> np.ndarray:
        return np.asarray((self.upper - self.lower) / STEPS_PER_RANGE)

    def internal(self, value: Any) -> np.ndarray:
        return np.asarray((np.asarray(value, dtype=float) - self.lower) / self._scale)

    def value(self, z: Any) -> np.ndarray:
        return np.asarray(np.clip(self.lower + self._scale * z, self.lower, self.upper))

    def slope(self, z: Any) -> np.ndarray:
        return np.asarray(self._scale * np.ones_like(z))

    def relative(self, z: Any, standard_error: Any) -> np.ndarray:
        return np.asarray(standard_error / STEPS_PER_RANGE)


def log(lower: Any, upper: Any, start: Any = None, unit: str = "") -> Log:
    """An unknown searched on a logarithmic scale: moduli, viscosities, anything positive of unknown
    magnitude.

    Args:
        lower: bound > 0, a number or an array of the shape of `start`, in the unknown's unit.
        upper: likewise, above `lower`.
        start: where the fit starts, a number or an array; the geometric mean of the bounds by default.
        unit: printed in reports.

    Raises:
        ValueError: bounds not positive, not finite or the wrong way round; a start outside of them.

    """
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if not np.all(low > 0):
        raise ValueError(
            f"log(lower={lower}): {np.min(low):g} is not > 0, and only positive values have a "
            "logarithm; give a positive lower bound, or use linear(...)"
        )
    _check_bounds("log", low, high)
    default = np.sqrt(low) * np.sqrt(high)
    return Log(*_check_start("log", low, high, default if start is None else start), unit)


def linear(lower: Any, upper: Any, start: Any = None, unit: str = "") -> Linear:
    """An unknown searched on a linear scale: angles, offsets, Poisson ratios, anything that may change sign.

    Args:
        lower: bound, a number or an array of the shape of `start`, in the unknown's unit.
        upper: likewise, above `lower`.
        start: where the fit starts, a number or an array; the middle of the bounds by default.
        unit: printed in reports.

    Raises:
        ValueError: bounds not finite or the wrong way round; a start outside of them.

    """
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    _check_bounds("linear", low, high)
    return Linear(*_check_start("linear", low, high, 0.5 * (low + high) if start is None else start), unit)


def _check_bounds(kind: str, lower: np.ndarray, upper: np.ndarray) -> None:
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper))):
        raise ValueError(
            f"{kind}(lower={lower}, upper={upper}): bounds must be finite numbers; give the widest "
            "range in which the simulator works"
        )
    wrong = np.asarray(lower >= upper)
    if np.any(wrong):
        low, high = np.broadcast_arrays(lower, upper)
        first = np.argmax(wrong.ravel())
        a, b = low.ravel()[first], high.ravel()[first]
        raise ValueError(
            f"{kind}(lower={a:g}, upper={b:g}): the lower bound must be below the upper one; "
            + ("give two different bounds" if a == b else f"did you mean ({b:g}, {a:g})?")
        )


def _check_start(kind: str, lower: np.ndarray, upper: np.ndarray, start: Any):
    start = np.array(start, dtype=float)
    try:
        low, high = np.broadcast_to(lower, start.shape).copy(), np.broadcast_to(upper, start.shape).copy()
    except ValueError:
        raise ValueError(
            f"{kind}: bounds of shapes {lower.shape} and {upper.shape} do not fit a start of shape "
            f"{start.shape}; give a start array of the shape of the unknown"
        ) from None
    outside = ~((start >= low) & (start <= high))
    if np.any(outside):
        first = np.argmax(outside.ravel())
        where = f"start[{first}]" if start.ndim else "start"
        raise ValueError(
            f"{kind}: {where} = {start.ravel()[first]:g} lies outside its bounds "
            f"[{low.ravel()[first]:g}, {high.ravel()[first]:g}]; move the start or widen the bounds"
        )
    return low, high, start
