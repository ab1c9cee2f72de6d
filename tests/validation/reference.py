"""Reference data: tables in tests/reference by column."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "reference"


def table(name: str) -> list[dict[str, str]]:
    """Lines of a CSV file as dictionaries of text."""
    with (FOLDER / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def column(name: str, heading: str) -> np.ndarray:
    """A column of numbers."""
    return np.array([float(line[heading]) for line in table(name)])


def number(name: str, heading: str, **where: str) -> float:
    """The one number of a column in the line whose other columns have these texts.

    Raises LookupError unless there is exactly one such line.
    """
    found = [line for line in table(name) if all(line[key] == text for key, text in where.items())]
    if len(found) != 1:
        raise LookupError(f"{name} has {len(found)} lines with {where}; one is needed")
    return float(found[0][heading])
