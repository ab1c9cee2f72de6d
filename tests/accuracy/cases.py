"""What a case is made of, and what it hands back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxsph.accuracy import Results, Row, Study


@dataclass(frozen=True)
class Peer:
    """A case of another code: `name` in its program, the resolutions to run, and how a run of it is judged.

    errors_of: {array: values} as that program saves them -> {error: value}. package: of the code.
    """

    name: str
    resolutions: tuple[int, ...]
    errors_of: Callable[[dict[str, np.ndarray]], dict[str, float]]
    package: str = "pysph"


@dataclass(frozen=True)
class Case:
    """A study and its settings, or a function that makes the table itself; what its errors are called.

    Attributes:
        id: in the results.
        title: of the picture and the table.
        labels: {error: label of the axis}; the first is drawn.
        make: quick -> table.
        tolerances: for which the cheapest settings are looked up; seconds: for which the most accurate are.
        peers: the same case in other codes.
    """

    id: str
    title: str
    labels: dict[str, str]
    make: Callable[[bool], Results]
    tolerances: tuple[float, ...]
    seconds: tuple[float, ...] = (1.0, 10.0)
    peers: tuple[Peer, ...] = ()


def studied(study: Study, settings: list[dict], quick: bool, quick_settings: list[dict]) -> Results:
    """All runs of a study, with the code that made them as a setting."""
    results = study.run(quick_settings if quick else settings, progress=True)
    rows = [Row({**row.settings, "code": "jaxsph"}, *_rest(row)) for row in results]
    return Results(tuple(rows), study.resolution, study.title)


def _rest(row: Row) -> tuple:
    return (row.errors, row.seconds, row.compile_seconds, row.steps, row.n_particles, row.memory, row.time_step,
            row.failure)  # fmt: skip
