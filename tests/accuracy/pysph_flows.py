"""PySPH's own examples, timed, with the fields at given moments: the peer of the work-precision studies.

A program of its own, so that its OpenMP threads and those of JAX do not share a process. Physics, kernels, schemes and
time steps are PySPH's, by the defaults of each example, but EDAC for the vortex, which serves it far better; only the
resolution, the end and, for the pressure of the dam break, the sizes of its tank are changed, and nothing is written to
disk. The time is that of all steps but the first, so that compiling does not count.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from pysph.base.utils import get_particle_array  # pyright: ignore[reportMissingImports]
from pysph.examples import (  # pyright: ignore[reportMissingImports]
    cavity,
    dam_break_2d,
    hydrostatic_tank,
    poiseuille,
    taylor_green,
)
from pysph.tools.geometry import get_2d_tank  # pyright: ignore[reportMissingImports]

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
    moments = np.arange(41, 61) / 4  # 10.25 to 15: those of `fluid_cases.LAST`
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
    return timed(dam_break_2d.DamBreak2D, moments, "x"), _dam_options(2.0 / n, end), {}


def dam_break_pressure_of(n: int):
    """A column of 4 m x 2 m in a tank of 5.366 times its height, the end of the longest record."""
    spacing = 2.0 / n
    length = round(5.366 * n) * spacing

    class LongTank(dam_break_2d.DamBreak2D):
        def create_particles(self):
            """As the example places them: the first fluid particles a spacing off the first ones of the wall."""
            x, y = get_2d_tank(dx=spacing, length=length + spacing, height=6.0, base_center=[0, 0], num_layers=4)
            column = np.meshgrid(spacing * np.arange(1, 2 * n + 1), spacing * np.arange(1, n + 1))
            same = {"h": dam_break_2d.h, "m": dam_break_2d.m, "rho": dam_break_2d.ro}
            fluid = get_particle_array(name="fluid", x=column[0].ravel(), y=column[1].ravel(), **same)
            boundary = get_particle_array(name="boundary", x=x - x.min() - 3 * spacing, y=y, **same)
            self.scheme.setup_properties([fluid, boundary])
            return [fluid, boundary]

    moments = np.arange(2.34, 7.01, 0.02) * np.sqrt(2.0 / 9.81)
    about = {"h": dam_break_2d.hdx * spacing, "face": length + 0.5 * spacing, "floor": 0.5 * spacing}
    return timed(LongTank, moments, "xyp"), _dam_options(spacing, moments[-1]), about


def _dam_options(spacing: float, end: float) -> list[str]:
    """The example takes the spacing from its options, the mass and the smoothing length from its globals."""
    dam = dam_break_2d
    dam.dx, dam.h, dam.m = spacing, dam.hdx * spacing, spacing**2 * dam.ro
    return ["--dx", str(spacing), "--tf", str(1.01 * end)]


EXAMPLES = {
    "taylor_green": taylor_green_of,
    "cavity": cavity_of,
    "poiseuille": poiseuille_of,
    "still_water": still_water_of,
    "dam_break": dam_break_of,
    "dam_break_pressure": dam_break_pressure_of,
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
