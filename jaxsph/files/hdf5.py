"""Typed access to what a file holds; what is missing is named instead of becoming a KeyError."""

from __future__ import annotations

import json
from typing import Any

import h5py
import numpy as np


def dataset(file: h5py.File, name: str) -> h5py.Dataset:
    """The dataset at `name`."""
    found = file.get(name)
    if not isinstance(found, h5py.Dataset):
        raise ValueError(_missing(file, "dataset", name))
    return found


def group(file: h5py.File, name: str) -> h5py.Group:
    """The group at `name`."""
    found = file.get(name)
    if not isinstance(found, h5py.Group):
        raise ValueError(_missing(file, "group", name))
    return found


def array(file: h5py.File, name: str) -> np.ndarray:
    """All numbers of a dataset, a scalar as an array of shape ()."""
    return np.asarray(dataset(file, name)[()])


def attribute(file: h5py.File, name: str, key: str) -> Any:
    """An attribute of the group or dataset at `name`."""
    attributes = file[name].attrs if name in file else {}
    if key not in attributes:
        raise ValueError(_missing(file, "attribute", f"{name}:{key}"))
    return attributes[key]


def from_json(file: h5py.File, name: str) -> Any:
    """What a dataset says in JSON."""
    return json.loads(str(dataset(file, name).asstr()[()]))


def _missing(file: h5py.File, kind: str, name: str) -> str:
    return (
        f"{file.filename}: {kind} /{name} is missing, expected a trajectory as this jaxsph writes it; "
        "another program has changed the file: copy it again or run again"
    )
