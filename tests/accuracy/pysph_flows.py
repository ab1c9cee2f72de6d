"""PySPH's own examples, timed, with the fields at given moments: the peer of the work-precision studies.

A program of its own, so that its OpenMP threads and those of JAX do not share a process. Physics, kernels, schemes and
time steps are PySPH's, by the defaults of each example, but EDAC for the vortex, which serves it far better; only the
resolution and the end are changed, and nothing is written to disk. The time is that of all steps but the first, so that
compiling does not count.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from pysph.examples import (  # pyright: ignore[reportMissingImports]
    cavity,
    dam_break_2d,
    hydrostatic_tank,
    poiseuille,
    taylor_green,
)

Looks = dict[str, Any]


def timed(kind: type, moments: np.ndarray, names: str):
    """The example's class with a clock, and copies of the fluid's arrays at the first step after each moment."""

    class Timed(kind):
        def __init__(self, **options):
            self.looks: Looks = {name: [] for name in names}
            self.looks["times"] = []
            self.first = self.last = self.count = self.paused = 0.0
            super().__init__(**options)

        def post_step(self, solver):
            if len(self.looks["times"]) == len(moments):
                return  # what comes after the last moment does not count
            now = time.perf_counter()
            if self.count == 0:
                self.first = now
                self.looks["x_start"] = self.fluid().x.copy()
            self.count += 1
            self.last = now
            due = len(self.looks["times"])
            if solver.t >= moments[due] * (1 - 1e-9):
                for name in names:
                    self.looks[name].append(getattr(self.fluid(), name).copy())
                self.looks["times"].append(solver.t)
                self.paused += time.perf_counter() - now

        def fluid(self):
            return next(array for array in self.particles if array.name == "fluid")

    return Timed


def taylor_green_of(n: int):
    options = ["--nx", str(n), "--tf", "1.01", "--scheme", "edac"]
    return timed(taylor_green.TaylorGreen, np.array([1.0]), "xyuv"), options, {}


def cavity_of(n: int):
    moments = np.array([14.25, 14.5, 14.75, 15.0])
    return timed(cavity.LidDrivenCavity, moments, "xyuv"), ["--nx", str(n), "--tf", "15.05"], {"h": 1.0 / n}


def poiseuille_of(n: int):
    poiseuille.dx = 1.0 / n
    poiseuille.ghost_extent, poiseuille.h0 = 5 * poiseuille.dx, poiseuille.hdx * poiseuille.dx
    about = {"nu": 0.01, "top": 0.01 * 0.0125}
    return timed(poiseuille.PoiseuilleFlow, 2.25 * np.arange(1, 11), "yu"), ["--tf", "22.6"], about


def still_water_of(n: int):
    """Of the height .9 and the width 1, with Adami's walls, to 10 sqrt(H/g) with g = 1."""
    tank = hydrostatic_tank
    end = 10 * np.sqrt(tank.H)
    tank.Lx, tank.dx, tank.tf = 1.0, tank.H / n, end
    tank.ghost_extent, tank.h0 = 5.5 * tank.dx, tank.hdx * tank.dx
    limits = 0.25 * tank.h0 / (tank.c0 + tank.Vmax), 0.125 * tank.h0**2 / tank.nu, 0.25 * np.sqrt(tank.h0)
    tank.dt, tank.output_at_times = 0.75 * min(limits), ()
    return timed(tank.HydrostaticTank, np.array([end]), "yuvp"), ["--tf", str(1.01 * end)], {}


def dam_break_of(n: int):
    """A column of 1 m x 2 m; times to T = 2.5."""
    end = 2.5 / np.sqrt(2 * 9.81)
    moments = np.linspace(0, end, 51)[1:]
    return timed(dam_break_2d.DamBreak2D, moments, "x"), ["--dx", str(2.0 / n), "--tf", str(1.01 * end)], {}


EXAMPLES = {
    "taylor_green": taylor_green_of,
    "cavity": cavity_of,
    "poiseuille": poiseuille_of,
    "still_water": still_water_of,
    "dam_break": dam_break_of,
}


def measure(name: str, n: int) -> Looks:
    """Seconds, steps, particles, and the arrays at the moments of one run."""
    kind, options, about = EXAMPLES[name](n)
    with tempfile.TemporaryDirectory() as folder:
        app = kind(output_dir=folder, fname=name)
        app.run(["--quiet", "--disable-output", "--openmp", *options])
    everyone = sum(len(array.x) for array in app.particles)
    looks = {key: np.array(value) for key, value in app.looks.items()}
    if not all(np.isfinite(value).all() for value in looks.values()):
        raise FloatingPointError(f"PySPH's {name} at {n} blew up: its time does not count")
    seconds = (app.last - app.first - app.paused) * app.count / (app.count - 1)
    return {**looks, **about, "seconds": seconds, "steps": app.count, "n_particles": everyone}


def main() -> None:
    parser = argparse.ArgumentParser(description="time an example of PySPH")
    parser.add_argument("name", choices=EXAMPLES)
    parser.add_argument("--particles", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    np.savez(options.out, **measure(options.name, options.particles))


if __name__ == "__main__":
    main()
