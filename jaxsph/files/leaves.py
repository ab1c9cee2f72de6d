"""Leaves of a pytree as arrays, each named by where it stands."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax.tree_util import SequenceKey, keystr

Leaves = list[tuple[str, np.ndarray]]
"""Leaves of a pytree with where each stands."""


def named_leaves(tree: Any) -> list[tuple[str, Any]]:
    """All leaves with their names: `plate.youngs_modulus`, `gravity`, `systems.plate.velocity`.

    A thing in a sequence goes by its `name`, or by its class, as `Scene.get` finds it; numbers and plain
    containers in a sequence go by their index.
    """
    return [(_name(tree, path), leaf) for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]]


def array_leaves(tree: Any) -> Leaves:
    """All leaves as arrays that HDF5 holds.

    Raises:
        ValueError: a leaf of a type that HDF5 does not hold; two leaves of one name.

    """
    named: Leaves = []
    for name, leaf in named_leaves(tree):
        if isinstance(leaf, jax.Array) and not isinstance(leaf.dtype, np.dtype):
            raise ValueError(f"leaf {name} is of type {leaf.dtype}: store the numbers that it is made of")
        value = np.asarray(leaf)
        if value.dtype.kind not in "biufc":
            raise ValueError(f"leaf {name} is of type {value.dtype}, HDF5 holds booleans, integers, floats and complex")
        named.append((name.replace("/", "|"), value))
    names = [name for name, _ in named]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ValueError(f"leaves of the tree share a name: {', '.join(twice)}; rename one of them")
    return named


def _name(tree: Any, path: tuple[Any, ...]) -> str:
    words: list[str] = []
    item = tree
    for key in path:
        item = _child(item, key)
        described = item is not None and not isinstance(item, list | tuple | dict) and hasattr(item, "__dict__")
        if isinstance(key, SequenceKey) and described and words:
            own = getattr(item, "name", None)
            words[-1] = own if isinstance(own, str) else type(item).__name__
        else:
            words.append(keystr((key,), simple=True))
    return ".".join(words) or "value"


def _child(item: Any, key: Any) -> Any:
    """What stands at a key; None when the tree has its own way to find it."""
    if item is None:
        return None
    if hasattr(key, "idx"):
        return item[key.idx]
    if hasattr(key, "name"):
        return getattr(item, key.name, None)
    return item[key.key] if isinstance(item, dict) else None
