"""I03, I04, I05: viscosities from velocities at points, by the fits of examples/calibrate_viscosity.py."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from reference import table
from rows import Case, Row, precision

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

import calibrate_viscosity as example  # pyright: ignore[reportMissingImports]


def about(summary: dict, limit: float | None, where: tuple[str, str]) -> list[Row]:
    """Rows on a fit: its error, and where it comes from."""
    sign = "high" if summary["bias"] > 0 else "low"
    rows = [
        Row(f"relative error of the viscosity (too {sign})", abs(summary["bias"]), limit, *where),
        Row("relative standard error", summary["standard_error"] / summary["true"], None, *where),
        Row("effective / physical viscosity - 1 of the solver", summary["numerical"], None, *where),
    ]
    if not summary["twin"]:
        parts = summary["from_numerical"], summary["from_observer"]
        rows += [
            Row("part of the error by the solver's viscosity", parts[0], None, *where),
            Row("part of the error by the interpolation", parts[1], None, *where),
            Row("rest of the error", summary["bias"] - sum(parts), None, *where),
        ]
    return [*rows, Row("simulation runs", summary["simulation_runs"], 15, *where)]


def twin(quick: bool) -> Iterator[list[Row]]:
    """5 % noise on velocities of the solver itself, from a factor 2 off to both sides."""
    flow, where = example.vortices(25, dtype=np.float32), ("25 x 25", precision(np.float32))
    for seed, start in enumerate((2.0,) if quick else (2.0, 0.5)):
        _, summary = example.calibrate(flow, twin=True, noise=0.05, start=start, seed=seed, progress=False)
        name = "from twice" if start > 1 else "from half"
        rows = about(summary, 0.01, where)
        yield [Row(f"{row.figure}, {name}", row.value, row.limit, row.resolution, row.precision) for row in rows]


def exact_vortices(quick: bool) -> Iterator[list[Row]]:
    """The exact decay: what is left is the bias by the resolution, of the solver and of the interpolation.

    The disorder of the particles makes the cost rough, see docs/fit.md: where the fit came to a stop is in the rest.
    """
    for particles in (25,) if quick else (25, 50):
        flow, where = example.vortices(particles, dtype=np.float32), (f"{particles} x {particles}", "float32")
        _, summary = example.calibrate(flow, twin=False, noise=0.0, progress=False)
        yield about(summary, 0.03 if particles == 50 else None, where)


def exact_channel(quick: bool) -> Iterator[list[Row]]:
    """The exact profiles, and whether they are those of the table."""
    lines = table("fluid/startup_morris_SI.csv")
    force = 8 * 1e-6 * example.TOP_SPEED / example.HEIGHT**2
    apart = [
        float(line["u_poiseuille_mps"])
        - example.start_up(1e-6, force, example.HEIGHT, float(line["y_m"]), float(line["t_s"]))
        for line in lines
    ]
    # the table has ten digits
    yield [Row("series from the table / top speed", np.max(np.abs(apart)) / example.TOP_SPEED, 1e-8, "-", "float64")]
    for particles in (10,) if quick else (10, 20):
        flow, where = example.channel(particles, dtype=np.float32), (f"{particles} across", "float32")
        _, summary = example.calibrate(flow, twin=False, noise=0.0, progress=False)
        yield about(summary, 0.05 if particles == 20 else None, where)


CASES = [
    Case("I03", "Viscosity of Taylor-Green vortices, Re 100, twin with 5 % noise", twin),
    Case("I04", "Viscosity of Taylor-Green vortices, Re 100, exact velocities", exact_vortices),
    Case("I05", "Viscosity of a Poiseuille flow from rest, exact velocities", exact_channel),
]
