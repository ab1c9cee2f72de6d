"""The last state of a run, every leaf bit for bit, and the fingerprint of the scene that it belongs to.

Two slots are written in turn; the number of the whole one is stored last. A run that is killed while it
writes slot 1 restarts from slot 0.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import json
import os
import re
import types
from collections.abc import Iterator
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.files import hdf5
from jaxsph.files.check import open_for_reading
from jaxsph.files.leaves import Leaves, array_leaves

_NO_STATE = -1


def create_slots(file: h5py.File, leaves: Leaves) -> None:
    """Lay out both slots for a state with these leaves."""
    group = file.require_group("jaxsph/restart")
    group.attrs["slot"] = np.int64(_NO_STATE)
    group.create_dataset("leaves", data=json.dumps([name for name, _ in leaves]))
    for slot in ("0", "1"):
        for name, value in leaves:
            group.create_dataset(f"{slot}/{name}", data=np.zeros_like(value))


def write_slot(file: h5py.File, leaves: Leaves) -> int:
    """Write a state into the slot that is not in use and return its number, for `commit_slot`."""
    slot = 1 if int(hdf5.attribute(file, "jaxsph/restart", "slot")) == 0 else 0
    for name, value in leaves:
        if value.size:
            hdf5.dataset(file, f"jaxsph/restart/{slot}/{name}")[...] = value
    return slot


def commit_slot(file: h5py.File, slot: int) -> None:
    """Declare a slot whole. The number is overwritten where it stands, in one write."""
    hdf5.group(file, "jaxsph/restart").attrs.modify("slot", np.int64(slot))


def changed_leaves(then: Leaves, now: Leaves) -> list[str]:
    """Names of leaves that only one of two states has, or that differ in shape or type."""
    kinds = ({(name, str(v.dtype), v.shape) for name, v in leaves} for leaves in (then, now))
    before, after = kinds
    return sorted({name for name, _, _ in before ^ after})


def fingerprint(tree: Any) -> dict[str, Any]:
    """Fingerprint of a scene: one hash of everything, and one line per leaf so that a difference can be
    named.

    Returns `{"hash": str, "structure": str, "leaves": {name: {"dtype", "shape", "hash", "value"}}}`; `value`
    is there for single numbers. `structure` is the tree without its leaves, with the static fields in it;
    addresses of functions are left out, so that two processes agree; the numbers that a function is made of,
    such as the speed of a wall's motion, are among the leaves.
    """
    leaves = {}
    for name, value in array_leaves(tree):
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
        leaves[name] = {"dtype": str(value.dtype), "shape": list(value.shape), "hash": content}
        if value.size == 1 and value.dtype.kind in "biuf":
            leaves[name]["value"] = repr(value.item())
    for name, made_of in _functions(tree):
        leaves[name] = {"dtype": "function", "shape": [], "hash": hashlib.sha256(made_of.encode()).hexdigest()[:16]}
    structure = re.sub(r" at 0x[0-9a-fA-F]+", "", str(jax.tree_util.tree_structure(tree)))
    whole = hashlib.sha256(json.dumps([structure, leaves], sort_keys=True).encode()).hexdigest()
    return {"hash": whole, "structure": structure, "leaves": leaves}


def _functions(item: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Where functions stand among the fields of dataclasses, and what each is made of."""
    if isinstance(item, (tuple, list)):
        for number, part in enumerate(item):
            yield from _functions(part, f"{path}.{getattr(part, 'name', None) or number}")
    elif dataclasses.is_dataclass(item) and not isinstance(item, type):
        for field in dataclasses.fields(item):
            value = getattr(item, field.name, None)
            if callable(value) and not dataclasses.is_dataclass(value):
                yield f"{path}.{field.name}".lstrip("."), _made_of(value)
            else:
                yield from _functions(value, f"{path}.{field.name}")


def _made_of(value: Any, depth: int = 4) -> str:
    """Names, constants, defaults and enclosed values of a function, without addresses; objects to some depth."""
    parts: list[Any] = []
    if isinstance(value, functools.partial):
        parts = [value.func, *value.args, *(part for item in sorted(value.keywords.items()) for part in item)]
    elif isinstance(value, (np.ndarray, jax.Array)):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    elif isinstance(value, types.CodeType) or hasattr(inspect.unwrap(value) if callable(value) else 0, "__code__"):
        function = value if isinstance(value, types.CodeType) else inspect.unwrap(value)
        code = getattr(function, "__code__", function)
        parts = [code.co_names, *(constant for constant in code.co_consts if not isinstance(constant, str))]
        parts += getattr(function, "__defaults__", None) or ()
        parts += [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    elif hasattr(value, "__dict__") and not isinstance(value, (type, types.ModuleType)):
        parts = [type(value).__qualname__, *(part for item in sorted(vars(value).items()) for part in item)]
    if not parts or depth == 0:
        return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value))
    return repr([_made_of(part, depth - 1) for part in parts])


def _differences(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """What differs between the fingerprint in a file and that of the scene in hand, one phrase per leaf."""
    said = []
    for name in sorted(found["leaves"].keys() | expected["leaves"].keys()):
        there, here = found["leaves"].get(name), expected["leaves"].get(name)
        if there is None or here is None:
            said.append(f"{name} is only in {'this scene' if there is None else 'the file'}")
        elif there != here:
            kind = next((key for key in ("shape", "dtype", "value") if there.get(key) != here.get(key)), None)
            was, now = (there.get(kind), here.get(kind)) if kind else ("other numbers", "")
            said.append(f"{name}: {kind} {was} in the file, {now} in this scene" if kind else f"{name}: {was}")
    if not said and found["structure"] != expected["structure"]:
        said.append(f"the structure: {found['structure']} in the file, {expected['structure']} in this scene")
    return said


def read_state(path: str | os.PathLike[str], like: Any, scene: Any = None) -> Any:
    """Read the last state of a run for an exact restart: every leaf has the bits that were written.

    Args:
        path: file that `simulate(..., out=...)` or `TrajectoryWriter` wrote.
        like: a state of the same scene (an initial state will do); it gives the structure, dtypes and shapes.
        scene: the scene that continues the run; compared with the fingerprint in the file when given.

    Returns: a pytree like `like`; jax leaves come back as jax arrays, NumPy ones and Python numbers as what
    they were.

    Raises:
        FileNotFoundError, ValueError: see `read_trajectory`; no state in the file; another scene (says which
            leaves differ); other names, shapes or dtypes than `like` has.

    """
    with open_for_reading(path) as file:
        if scene is not None:
            _check_scene(path, file, scene)
        held = "jaxsph/restart" in file
        slot = int(hdf5.attribute(file, "jaxsph/restart", "slot")) if held else _NO_STATE
        if slot == _NO_STATE:
            raise ValueError(
                f"{path}: holds a trajectory but no state to restart from; expected /jaxsph/restart with a "
                "whole state: save with TrajectoryWriter.append(..., state=state)"
            )
        template = array_leaves(like)
        stored, wanted = hdf5.from_json(file, "jaxsph/restart/leaves"), [name for name, _ in template]
        if stored != wanted:
            missing = [name for name in wanted if name not in stored]
            extra = [name for name in stored if name not in wanted]
            raise ValueError(
                f"{path}: the state in the file has other leaves than `like`: missing {missing or 'none'}, "
                f"not asked for {extra or 'none'}; give the initial state of the scene that wrote the file"
            )
        values = []
        for name, expected in template:
            value = hdf5.array(file, f"jaxsph/restart/{slot}/{name}")
            if value.shape != expected.shape or value.dtype != expected.dtype:
                raise ValueError(
                    f"{path}: {name} has shape {value.shape} and type {value.dtype}, `like` has "
                    f"{expected.shape} and {expected.dtype}; build the scene with the resolution and the "
                    "precision of the file"
                )
            values.append(value)
    leaves, structure = jax.tree_util.tree_flatten(like)
    return jax.tree_util.tree_unflatten(structure, [_as(leaf, v) for leaf, v in zip(leaves, values, strict=True)])


def ends_with(path: str | os.PathLike[str], state: Any) -> bool:
    """Whether a file holds a run that ends with a state, after the same number of steps at the same time."""
    try:
        with h5py.File(path, "r") as file:
            if "jaxsph/restart" not in file:
                return False
            slot = int(hdf5.attribute(file, "jaxsph/restart", "slot"))
            held = [hdf5.array(file, f"jaxsph/restart/{slot}/{name}") for name in ("step", "time")]
    except (OSError, KeyError, ValueError):  # no file, or none of ours: what it holds is not continued
        return False
    return bool(held[0] == np.asarray(state.step) and held[1] == np.asarray(state.time))


def _as(leaf: Any, value: np.ndarray) -> Any:
    if isinstance(leaf, jax.Array):
        return jnp.asarray(value)
    if isinstance(leaf, np.ndarray):
        return value
    return value[()] if isinstance(leaf, np.generic) else type(leaf)(value.item())


def _check_scene(path: str | os.PathLike[str], file: h5py.File, scene: Any) -> None:
    if "jaxsph/fingerprint" not in file:
        raise ValueError(f"{path}: no fingerprint of the scene to compare with; read the state without `scene`")
    found, expected = hdf5.from_json(file, "jaxsph/fingerprint"), fingerprint(scene)
    if found["hash"] != expected["hash"]:
        said = _differences(found, expected)
        more = f" and {len(said) - 5} more" if len(said) > 5 else ""
        raise ValueError(
            f"{path}: written by another scene than this one; {'; '.join(said[:5])}{more}. An exact restart "
            "needs the same scene; to go on with other values on purpose, leave out `scene`"
        )
