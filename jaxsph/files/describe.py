"""The `/jaxsph` group: what the numbers of a file mean and what made them."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import h5py
import jax
import numpy as np

from jaxsph.files.check import FORMAT_VERSION
from jaxsph.files.columns import Column
from jaxsph.versions import __version__


def describe(
    file: h5py.File,
    reference: Mapping[str, np.ndarray],
    columns: Mapping[str, Column],
    precision: np.dtype,
    metadata: Mapping[str, Any],
    fingerprint: str | None,
) -> None:
    """Write versions, units, systems, reference positions [m], metadata and the scene's fingerprint."""
    about = file.create_group("jaxsph")
    about.attrs["format_version"] = np.int64(FORMAT_VERSION)
    about.attrs["jaxsph_version"] = __version__
    about.attrs["jax_version"] = jax.__version__
    about.attrs["numpy_version"] = np.__version__
    about.attrs["python_version"] = platform.python_version()
    about.attrs["precision"] = str(precision)
    about.attrs["created"] = datetime.now(UTC).isoformat(timespec="seconds")
    about.attrs["dimension"] = np.int64(next(iter(reference.values())).shape[1])
    fields = {
        name: {"field": c.field, "unit": c.unit, "components": c.components, "systems": c.systems}
        for name, c in columns.items()
    }
    about["systems"] = json.dumps({name: len(positions) for name, positions in reference.items()})
    about["fields"] = json.dumps(fields)
    about["metadata"] = json.dumps(metadata)
    for name, positions in reference.items():
        about[f"reference_positions/{name}"] = positions
    if fingerprint is not None:
        about["fingerprint"] = fingerprint


def plain(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata as it will come back from JSON: arrays become lists, tuples too."""

    def as_list(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return value.tolist()
        raise ValueError(
            f"metadata holds {value!r} of type {type(value).__name__}, expected what JSON holds, or an array"
        )

    return json.loads(json.dumps(dict(metadata), default=as_list))
