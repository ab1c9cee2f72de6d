"""Checks of what a user passes: the message names the value, the limit and the unit."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxsph.pytree import is_concrete


def _values(value):
    return np.asarray(value, dtype=float)


def check_positive(name: str, value, unit: str) -> None:
    """Raise ValueError unless all numbers in value are positive and finite. Traced values are let through."""
    if is_concrete(value) and not np.all((_values(value) > 0) & np.isfinite(_values(value))):
        raise ValueError(
            f"{name} = {_worst(value, lambda v: (v > 0) & np.isfinite(v))} must be positive and finite [{unit}]"
        )


def check_at_least(name: str, value, limit: float, unit: str) -> None:
    """Raise ValueError unless all numbers in value are finite and not below the limit."""
    if is_concrete(value) and not np.all((_values(value) >= limit) & np.isfinite(_values(value))):
        raise ValueError(
            f"{name} = {_worst(value, lambda v: (v >= limit) & np.isfinite(v))} must be >= {limit} [{unit}]"
        )


def check_kind(name: str, value, kind: type, example: str) -> None:
    """Raise ValueError unless value is an instance of a kind of law, as the example is; None is let through."""
    if value is None or isinstance(value, kind):
        return
    cure = "call it" if isinstance(value, type) and issubclass(value, kind) else "give one"
    raise ValueError(f"{name} = {value!r} is not a {kind.__name__}; {cure}, such as {example}")


def check_motion(system: Any, among=None) -> None:
    """Raise ValueError unless a system's motion is a function that is zero at t = 0 (`among` (N,) of the particles).

    A displacement at the start would put particles where nobody looked for what is there.
    """
    if system.motion is None:
        return
    if not callable(system.motion):
        raise ValueError(f"{system.name}.motion = {system.motion!r} is not a function motion(t, X) of displacements")
    positions = system.particles.positions
    if not is_concrete(positions):
        return
    start: Any = system.motion(jnp.zeros((), positions.dtype), jnp.asarray(positions))
    if not is_concrete(start):
        return
    check_shape_of_motion(system.name, start, positions)
    away = np.max(np.abs(np.asarray(start)[slice(None) if among is None else among]))
    if not away <= 1e-3 * system.particles.spacing:
        raise ValueError(
            f"{system.name}.motion displaces particles by {away:.4g} m at t = 0; it must start from zero: put the "
            "particles where they are at the start"
        )


def check_shape_of_motion(name: str, displacement, positions) -> None:
    """Raise ValueError unless what a motion returned has the shape of the positions (N, d)."""
    if np.shape(displacement) != np.shape(positions):
        raise ValueError(
            f"motion of {name!r} returned the shape {np.shape(displacement)}; it must be {np.shape(positions)}"
        )


def check_poisson_ratio(value) -> None:
    """Raise ValueError unless all Poisson ratios lie between -1 and 1/2, both excluded."""
    if is_concrete(value) and not np.all((_values(value) > -1) & (_values(value) < 0.5)):
        raise ValueError(
            f"poisson_ratio = {_worst(value, lambda v: (v > -1) & (v < 0.5))} must lie between -1 and 0.5, excluded: "
            "at 0.5 the p-wave speed is infinite; rubber is 0.45 to 0.499"
        )


def check_finite(name: str, value, shape: tuple[int | None, ...] | None = None) -> None:
    """Raise ValueError unless value is finite and has the shape (None matches any length)."""
    if shape is not None:
        found = np.shape(value)
        if len(found) != len(shape) or any(want not in (None, have) for want, have in zip(shape, found, strict=False)):
            raise ValueError(f"{name} has shape {found}; it must be {shape}")
    if is_concrete(value) and not np.all(np.isfinite(_values(value))):
        raise ValueError(f"{name} holds values that are not finite")


def _worst(value, good):
    values = _values(value)
    if values.ndim == 0:
        return values.item()
    index = np.unravel_index(int(np.argmin(good(values))), values.shape)
    return f"{values[index]} (at index {tuple(int(i) for i in index)})"


def check_time(name: str, value) -> None:
    """Raise ValueError unless a time is a positive finite number known now."""
    if not is_concrete(value):
        raise ValueError(f"{name} must be a plain number, not a traced one: the number of steps is compiled in")
    if not (math.isfinite(float(value)) and float(value) > 0):
        raise ValueError(f"{name} = {value} must be positive and finite [s]")


def check_name(name, number: str) -> None:
    """Raise ValueError unless a system's name can stand before that of a number, as in "beam.density"."""
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(f"name {name!r} must be a word that can stand in 'name.{number}'")
