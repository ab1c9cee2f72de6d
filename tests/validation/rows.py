"""Cases, the rows that they make, and the file of all rows."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One figure of a case. `limit` bounds `value` from above; None shows the value without judging it."""

    figure: str
    value: float
    limit: float | None
    resolution: str
    precision: str


@dataclass(frozen=True)
class Case:
    """A validation: `run(quick)` yields lists of rows, each list from one simulation (or one set of them)."""

    id: str
    title: str
    run: Callable[[bool], Iterator[list[Row]]]


def precision(dtype: Any) -> str:
    """Name of a floating type."""
    return np.dtype(dtype).name


def across(particles: int) -> str:
    """Resolution of a beam: the particles over its thickness."""
    return f"{particles} across"


def machine() -> str:
    """Model of the processor and the number of its cores."""
    model, path = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} core{'' if cores == 1 else 's'}"


def as_record(case: Case, row: Row, seconds: float) -> dict[str, Any]:
    """A row as it stands in the file; a value that is not finite becomes null."""
    value = float(row.value)
    return {
        "id": case.id,
        "case": case.title,
        "figure": row.figure,
        "value": value if math.isfinite(value) else None,
        "limit": None if row.limit is None else float(row.limit),
        "resolution": row.resolution,
        "precision": row.precision,
        "seconds": round(seconds, 2),
        "machine": machine(),
    }


def holds(record: dict[str, Any]) -> bool:
    """Whether a row keeps its limit. A value that is missing (not finite) does not."""
    return record["value"] is not None and (record["limit"] is None or record["value"] <= record["limit"])


def load(path: Path) -> list[dict[str, Any]]:
    """Rows of a file, none if there is no file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []


def merge(old: Iterable[dict], new: Sequence[dict], finished: Iterable[str], order: Sequence[str]) -> list[dict]:
    """Old rows with the new ones in their place, in the order of the cases.

    Of a finished case only new rows remain; of one that is still running also the old rows not yet made anew.
    """

    def key(row):
        return row["id"], row["figure"], row["resolution"], row["precision"]

    done, made = set(finished), {key(row) for row in new}
    rows = [row for row in old if row["id"] not in done and key(row) not in made] + list(new)
    places = {name: place for place, name in enumerate(order)}
    return sorted(rows, key=lambda row: places.get(row["id"], len(places)))


def save(path: Path, rows: Sequence[dict]) -> None:
    """Write all rows at once: a run that is killed leaves the last whole file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


COLUMNS = (
    ("id", 10),
    ("figure", 52),
    ("value", 10),
    ("limit", 9),
    ("resolution", 16),
    ("precision", 9),
    ("seconds", 8),
)


def heading() -> str:
    """First line of the printed table."""
    return " ".join(f"{name:<{width}}" for name, width in COLUMNS)


def line(record: dict[str, Any]) -> str:
    """A row of the printed table, marked if it misses its limit."""

    def cell(name):
        value = record[name]
        if value is None:
            return "-"
        return f"{value:.3g}" if isinstance(value, float) and name != "seconds" else str(value)

    cells = " ".join(f"{cell(name):<{width}}" for name, width in COLUMNS)
    return cells.rstrip() + ("" if holds(record) else "   <- misses its limit")
