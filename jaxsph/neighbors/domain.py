"""The box in which neighbors are searched: its bounds, and which axes repeat."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Numbers = Sequence[float | int] | np.ndarray


@dataclasses.dataclass(frozen=True, init=False)
class Domain:
    """An axis-parallel box, free or periodic along each axis. Hashable: it is compiled in, never traced.

    A free axis has bounds too, because the cells of the search need them: a particle beyond them is reported
    as outside, never moved. Choose them as wide as the particles can go (`Domain.around`); empty space costs
    next to nothing. Along a periodic axis particles may be up to one period beyond the box.

    Attributes:
        lower: smallest coordinate along each axis [m]; two or three numbers.
        upper: largest coordinate along each axis [m].
        periodic: whether the axis repeats with the period upper - lower; one bool for all axes or one each.

    Raises:
        ValueError: bounds that are not finite, of unequal or unsupported number, or the wrong way round.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...] = (False,)

    def __init__(self, lower: Numbers, upper: Numbers, periodic: bool | Sequence[bool] = False):
        lower, upper = tuple(map(float, lower)), tuple(map(float, upper))
        if len(lower) not in (2, 3) or len(upper) != len(lower):
            raise ValueError(
                f"a domain has 2 or 3 axes, the same number in both bounds; got lower={lower}, upper={upper}"
            )
        periodic = (
            (bool(periodic),) * len(lower) if isinstance(periodic, (bool, np.bool_)) else tuple(map(bool, periodic))
        )
        if len(periodic) != len(lower):
            raise ValueError(f"periodic={periodic} needs one entry for each of the {len(lower)} axes, or one bool")
        for axis, (low, high) in enumerate(zip(lower, upper, strict=True)):
            if not (math.isfinite(low) and math.isfinite(high)):
                raise ValueError(
                    f"axis {axis} of the domain reaches from {low} to {high}; give finite bounds, along a free axis "
                    "as wide as the particles can go"
                )
            if low >= high:
                raise ValueError(f"axis {axis} of the domain has lower={low} >= upper={high}; swap or widen them")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)
        object.__setattr__(self, "periodic", periodic)

    @classmethod
    def around(cls, positions, margin: float | int) -> Domain:
        """The free box that holds positions (d, N) and `margin` [m] more on every side.

        Raises ValueError if there are no positions, one is not finite, or the margin is negative.
        """
        positions = np.asarray(positions, float)
        if positions.ndim != 2 or positions.shape[1] == 0 or not np.isfinite(positions).all():
            raise ValueError(f"positions must be finite and (d, N) with N >= 1, got shape {positions.shape}")
        if not margin >= 0:
            raise ValueError(f"margin={margin} must not be negative")
        # A flat set of particles (a wall) still needs a box with a volume.
        widening = np.where(np.ptp(positions, axis=1) + margin > 0, margin, 0.5)
        return cls(tuple(positions.min(1) - widening), tuple(positions.max(1) + widening))

    @property
    def dimension(self) -> int:
        """Number of axes, 2 or 3."""
        return len(self.lower)

    @property
    def lengths(self) -> tuple[float, ...]:
        """Edge lengths [m]."""
        return tuple(high - low for low, high in zip(self.lower, self.upper, strict=True))

    def displacement(self, a: Array, b: Array) -> Array:
        """The vector a - b [m], along periodic axes to the nearest image of b.

        Component first: a and b are (d, ...) and broadcast. displacement(b, a) is exactly the opposite, also in
        floating point, which is what keeps neighbor lists symmetric.
        """
        return jnp.stack([self.component(axis, a[axis], b[axis]) for axis in range(self.dimension)])

    def component(self, axis: int, a, b):
        """One component of `displacement`, for arrays of that coordinate."""
        difference = a - b
        if self.periodic[axis]:
            length = self.lengths[axis]
            # Rounding half to even is odd, so exchanging a and b changes nothing but the sign.
            difference = difference - length * jnp.round(difference * (1.0 / length))
        return difference

    def wrap(self, positions: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Positions with periodic coordinates brought back into the box; free ones are left alone."""
        rows = list(positions)
        for axis, (low, length) in enumerate(zip(self.lower, self.lengths, strict=True)):
            if self.periodic[axis]:
                rows[axis] = rows[axis] - length * jnp.floor((rows[axis] - low) / length)
        return jnp.stack(rows)

    def for_tree(self, positions) -> tuple[np.ndarray, np.ndarray | None]:
        """Positions (N, d) [m] as SciPy's `KDTree` wants them, and its boxsize; of NumPy, in float64.

        Along periodic axes they are counted from the lower bound, within one period; without any the boxsize is None.
        """
        positions, period = np.asarray(positions, np.float64), np.where(self.periodic, self.lengths, 0.0)
        wrapped = np.mod(positions - np.asarray(self.lower), np.where(period > 0, period, 1.0))
        # what is left of zero by less than rounding comes out as the whole period
        wrapped = np.where(wrapped < period, wrapped, 0.0)
        return np.where(period > 0, wrapped, positions), period if any(self.periodic) else None

    def contains(self, positions: Array | np.ndarray) -> Array | np.ndarray:
        """Whether each particle is where the search can find it; False for NaN.

        Along a free axis: within the bounds. Along a periodic one: not more than one period beyond them,
        because the rounding of coordinates further away could cost a neighbor. (d, N) gives (N,), of NumPy or JAX.
        """
        inside = np.ones(positions.shape[1:], bool)
        for axis in range(self.dimension):
            slack = self.lengths[axis] if self.periodic[axis] else 0.0
            coordinate = positions[axis]
            inside = inside & (coordinate >= self.lower[axis] - slack) & (coordinate <= self.upper[axis] + slack)
        return inside
