"""Frozen dataclasses that are pytrees: the one way in which jaxsph describes things."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

T = TypeVar("T")


def static(**keywords: Any) -> Any:
    """Mark a field as part of the structure: it is compiled in, never traced or differentiated."""
    return dataclasses.field(metadata={"static": True}, **keywords)


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
def pytree_dataclass(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass and register it as a pytree.

    Fields marked with `static` go into the structure and must be hashable; all others are children.
    `__post_init__` checks what a user passes. It does not run when JAX rebuilds the object, because then
    the leaves may be tracers, shapes or placeholders.
    """
    cls = dataclasses.dataclass(frozen=True, eq=False)(cls)
    fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    children = tuple(f.name for f in fields if not f.metadata.get("static"))
    structure = tuple(f.name for f in fields if f.metadata.get("static"))

    def flatten(item: T):
        return tuple(getattr(item, name) for name in children), tuple(getattr(item, name) for name in structure)

    def flatten_with_keys(item: T):
        pairs = tuple((jax.tree_util.GetAttrKey(name), getattr(item, name)) for name in children)
        return pairs, tuple(getattr(item, name) for name in structure)

    def unflatten(auxiliary, values):
        item = object.__new__(cls)
        for name, value in zip(children, values, strict=True):
            object.__setattr__(item, name, value)
        for name, value in zip(structure, auxiliary, strict=True):
            object.__setattr__(item, name, value)
        return item

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    return cls


def replace(item: T, **changes: Any) -> T:
    """A copy of a pytree dataclass with some fields changed, without running its checks.

    Raises AttributeError if a name is not a field.
    """
    known = {f.name for f in dataclasses.fields(item)}  # type: ignore[arg-type]
    for name in changes:
        if name not in known:
            raise AttributeError(f"{type(item).__name__} has no field {name!r}; it has {sorted(known)}")
    copy = object.__new__(type(item))
    for name in known:
        object.__setattr__(copy, name, changes.get(name, getattr(item, name)))
    return copy


def is_concrete(*values: Any) -> bool:
    """Whether every leaf is a number that can be looked at now, not a tracer or a placeholder."""
    return all(
        not isinstance(leaf, (Tracer, jax.ShapeDtypeStruct)) and leaf is not object for leaf in jax.tree.leaves(values)
    )


def one_if_alike(values: Any) -> Any:
    """Values (N,) that are known and alike to rounding as their mean, one number; all others as they are.

    A number is not gathered in the sums over neighbors.
    """
    if not is_concrete(values) or np.ndim(values) != 1:
        return values
    known = np.asarray(values)
    return np.mean(known, dtype=np.float64).astype(known.dtype) if np.ptp(known) <= 1e-6 * np.max(known) else values


def as_real(value: Any, dtype: Any) -> Any:
    """A number or array in a precision: of NumPy if it is known now, else traced."""
    return np.asarray(value, dtype) if is_concrete(value) else jnp.asarray(value, dtype)
