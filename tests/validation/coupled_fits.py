"""I09, I10, fsi_published, fsi_joint: fits through fluid and structure, by calibrate_fsi.py and calibrate_gate.py."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
from rows import Case, Row

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

import calibrate_fsi  # pyright: ignore[reportMissingImports]
import calibrate_gate  # pyright: ignore[reportMissingImports]


def summary_of(example: Callable[..., dict], **options: Any) -> dict:
    """What an example returns. It runs in float32 and switches float64 off, which other validations need."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            return example(progress=False, out=folder, **options)
    finally:
        jax.config.update("jax_enable_x64", True)


def plate(quick: bool) -> Iterator[list[Row]]:
    """Twins with 5 % noise, from three times the modulus; a seed for each row, since splashes make the cost rough."""
    for seed in (0,) if quick else (0, 1, 2, 3):
        found = summary_of(calibrate_fsi.main, seed=seed)["twin"]
        where = (f"a / dx = {found['particles']}, seed {seed}", "float32")
        modulus = found["youngs_modulus"]
        yield [
            Row("relative error of E, from three times E", found["relative_error"], 0.02, *where),
            Row("relative standard error of E", found["standard_error"] / modulus, None, *where),
            Row("simulation runs", found["simulation_runs"], None, *where),
            Row("time without compiling [s]", found["seconds"] - found["compile_seconds"], None, *where),
            Row("peak memory of the process [MiB]", found["peak_memory_MiB"], None, *where),
        ]


def published(quick: bool) -> Iterator[list[Row]]:
    """The tips of the plate that two finite-element codes computed, with a modulus of 1 MPa.

    The fine fit, whose runs take long, starts at that modulus, the others at three times.
    """
    runs = (("Idelsohn2008", 20, 5, 3.0), ("Meduri2018", 20, 5, 3.0), ("Idelsohn2008", 45, 7, 1.0))
    for name, particles, across, start in runs[:1] if quick else runs:
        options = {"particles": particles, "across": across, "start": start}
        found = summary_of(calibrate_fsi.main, fits=(name,), **options)[name]
        where = (f"a / dx = {found['particles']}, {name}", "float32")
        modulus = found["youngs_modulus"]
        yield [
            Row("Young's modulus [MPa]", modulus / 1e6, None, *where),
            Row("relative standard error of E", found["standard_error"] / modulus, None, *where),
            Row("rms of ux / its peak, fitted E", found["rms_over_peak"], None, *where),
            Row("simulation runs", found["simulation_runs"], None, *where),
        ]


def joint(quick: bool) -> Iterator[list[Row]]:
    """Modulus and viscosity of viscous water together, a twin with 5 % noise, both from three times off.

    From the tip and the front of the water, and from the tip alone.
    """
    for name, seen in (("joint", "tip and front"), ("joint_tip", "tip alone"))[: 1 if quick else None]:
        found = summary_of(calibrate_fsi.main, fits=(name,))[name]
        where = (f"a / dx = {found['particles']}, {seen}", "float32")
        modulus, viscosity = found["youngs_modulus"], found["viscosity"]
        of_viscosity = abs(viscosity / calibrate_fsi.TRUE_VISCOSITY - 1)
        stated = found["standard_error_viscosity"] / viscosity
        yield [
            Row("relative error of E", found["relative_error"], None, *where),
            Row("relative error of the viscosity", of_viscosity, None, *where),
            Row("relative standard error of E", found["standard_error"] / modulus, None, *where),
            Row("relative standard error of the viscosity", stated, None, *where),
            Row("correlation of E and viscosity", found["correlation"], None, *where),
            Row("simulation runs", found["simulation_runs"], None, *where),
        ]


def gate(quick: bool) -> Iterator[list[Row]]:
    """The measured motion of Antoci's gate, from two moduli in use."""
    for start in (7.8e6,) if quick else (7.8e6, 12e6):
        found = summary_of(calibrate_gate.main, start=start)
        where = (f"20 over the width, from {start / 1e6:g} MPa", "float32")
        yield [
            Row("Young's modulus [MPa]", found["youngs_modulus"] / 1e6, None, *where),
            Row("rms of ux / its peak, fitted E", found["rms_over_peak"], 0.18, *where),
            Row("misfit / error of reading", found["rms_over_reading"], None, *where),
            Row("simulation runs", found["simulation_runs"], None, *where),
        ]


CASES = [
    Case("I09", "Young's modulus of a plate from its tip in a dam break, twin with 5 % noise", plate),
    Case("I10", "Young's modulus of Antoci's rubber gate, experiment", gate),
    Case("fsi_published", "Young's modulus of a plate from tips that others computed", published),
    Case("fsi_joint", "Young's modulus of a plate and viscosity of the water, twin with 5 % noise", joint),
]
