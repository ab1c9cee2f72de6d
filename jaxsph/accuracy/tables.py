"""Files of results: HDF5 and CSV, each with every value as it was."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxsph.accuracy.results import MEASURES, Results, Row

PLAIN = [name for name in MEASURES if name != "particle_steps"]  # what is not computed from others
HDF5 = (".h5", ".hdf5")


def save(results: Results, path: Path) -> Path:
    """Write a table; the folder is made if it is not there. Raises ValueError for another suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _writer_and_reader(path)[0](results, path)
    return path


def load(path: Path) -> Results:
    """Read a table. Raises ValueError for another suffix, or a file that is none."""
    return _writer_and_reader(path)[1](path)


def _writer_and_reader(path: Path):
    if path.suffix == ".csv":
        return _save_csv, _load_csv
    if path.suffix in HDF5:
        return _save_hdf5, _load_hdf5
    raise ValueError(f"{path}: a table is written as .csv, {' or '.join(HDF5)}")


def _columns(results: Results) -> dict[str, list]:
    """All that a table holds, by "setting:name", "error:name" and the name of a measure."""
    columns: dict[str, list] = {}
    for name in results.settings:
        columns[f"setting:{name}"] = [row.settings.get(name) for row in results]
    for name in results.errors:
        columns[f"error:{name}"] = [row.errors.get(name, math.nan) for row in results]
    for name in [*PLAIN, "failure"]:
        columns[name] = [getattr(row, name) for row in results]
    return columns


def _results(columns: dict[str, list], about: dict[str, Any], path: Path) -> Results:
    missing = [name for name in [*PLAIN, "failure"] if name not in columns]
    if missing:
        raise ValueError(f"{path} has no column {missing[0]!r}: it is not a table of a study")
    rows = []
    for index in range(len(columns["failure"])):
        named = {
            kind: {key[len(kind) + 1 :]: values[index] for key, values in columns.items() if key.startswith(kind + ":")}
            for kind in ("setting", "error")
        }
        measures = {name: columns[name][index] for name in PLAIN}
        measures |= {name: int(measures[name]) for name in ("steps", "n_particles")}
        errors = {name: float(value) for name, value in named["error"].items()}
        rows.append(Row(named["setting"], errors, **measures, failure=columns["failure"][index]))
    return Results(tuple(rows), about["resolution"], about["title"])


def _about(results: Results) -> str:
    return json.dumps({"title": results.title, "resolution": results.resolution})


def _save_csv(results: Results, path: Path) -> None:
    columns = _columns(results)
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {_about(results)}\n")
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in line] for line in zip(*columns.values(), strict=True))


def _cell(value: Any) -> str:
    """A text as it is, unless it could be taken for something else; all else as JSON; None as nothing."""
    if value is None:
        return ""
    if isinstance(value, str):
        return json.dumps(value) if value == "" or _is_json(value) else value
    return json.dumps(value)


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except json.JSONDecodeError:
        return False
    return True


def _load_csv(path: Path) -> Results:
    with path.open(newline="", encoding="utf-8") as file:
        first = file.readline()
        if not first.startswith("# {"):
            raise ValueError(f"{path} does not begin with the line of a table of a study")
        header, *lines = list(csv.reader(file))
    cells = [[None if c == "" else json.loads(c) if _is_json(c) else c for c in line] for line in lines]
    columns = {name: [line[i] for line in cells] for i, name in enumerate(header)}
    return _results(columns, json.loads(first[2:]), path)


def _save_hdf5(results: Results, path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["study"] = _about(results)
        for name, values in _columns(results).items():
            kinds = {type(value) for value in values}
            if len(kinds) == 1 and kinds <= {int, float, bool, str}:
                file.create_dataset(name.replace(":", "/"), data=values)
            else:
                # numbers among texts, or nothing in some rows
                data = file.create_dataset(name.replace(":", "/"), data=[json.dumps(value) for value in values])
                data.attrs["encoding"] = "json"


def _load_hdf5(path: Path) -> Results:
    import h5py

    with h5py.File(path, "r") as file:
        if "study" not in file.attrs:
            raise ValueError(f"{path} has no attribute 'study': it is not a table of a study")
        order = json.loads(str(file.attrs["study"]))
        columns: dict[str, list] = {}

        def read(name, item):
            if not isinstance(item, h5py.Dataset):
                return
            values = np.asarray(item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]).tolist()
            columns[name.replace("/", ":", 1)] = (
                [json.loads(value) for value in values] if item.attrs.get("encoding") == "json" else values
            )

        file.visititems(read)
    return _results(columns, order, path)
