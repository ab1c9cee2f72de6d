"""PySPH's weakly compressible dam break on given particles, timed: a peer of `dam_break`.

A program of its own, so that its OpenMP threads and those of JAX do not share a process. Scheme and kernel are those of
pysph.examples.dam_break_2d and _3d: `WCSPHScheme` with artificial viscosity and XSPH, `WendlandQuintic` (which is
Wendland's C2), h = 1.3 spacings. The integrator is `PECIntegrator`, which evaluates the forces once in a step as ours
does; the examples' `EPECIntegrator` evaluates them twice. The time step is fixed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from pysph.base.kernels import WendlandQuintic  # pyright: ignore[reportMissingImports]
from pysph.base.utils import get_particle_array  # pyright: ignore[reportMissingImports]
from pysph.solver.application import Application  # pyright: ignore[reportMissingImports]
from pysph.sph.integrator import PECIntegrator  # pyright: ignore[reportMissingImports]
from pysph.sph.scheme import WCSPHScheme  # pyright: ignore[reportMissingImports]

BLOCK = 10  # steps between two looks at the clock
SMOOTHING = 1.3  # smoothing length in spacings


class TimedDam(Application):
    """The dam break of a file of particles, with the time and the processor time [s] after every step."""

    def __init__(self, case, **options):
        self.case = case
        self.clock: list[float] = []
        self.processor: list[float] = []
        super().__init__(**options)

    def create_scheme(self):
        case, dimension = self.case, self.case["fluid"].shape[1]
        down = {("gy", "gz")[dimension - 2]: -9.81}
        scheme = WCSPHScheme(
            ["fluid"],
            ["boundary"],
            dim=dimension,
            rho0=1000.0,
            c0=float(case["sound_speed"]),
            h0=SMOOTHING * float(case["spacing"]),
            hdx=SMOOTHING,
            alpha=float(case["alpha"]),
            beta=0.0,
            gamma=7.0,
            hg_correction=True,
            **down,
        )
        step = float(case["time_step"])
        scheme.configure_solver(
            kernel=WendlandQuintic(dim=dimension),
            integrator_cls=PECIntegrator,
            dt=step,
            tf=1e3,
            adaptive_timestep=False,
        )
        return scheme

    def create_particles(self):
        spacing, made = float(self.case["spacing"]), []
        for name in ("fluid", "boundary"):
            axes = dict(zip("xyz", self.case[name].T.astype(np.float64), strict=False))
            dimension = len(axes)
            made.append(
                get_particle_array(name=name, **axes, m=1000.0 * spacing**dimension, rho=1000.0, h=SMOOTHING * spacing)
            )
        self.scheme.setup_properties(made)
        return made

    def post_step(self, solver):
        self.clock.append(time.perf_counter())
        self.processor.append(time.process_time())


def measure(path: Path, steps: int, cached: bool) -> dict:
    """Seconds of a step: the median over blocks, after a first block that is not counted."""
    with tempfile.TemporaryDirectory() as folder:
        dam = TimedDam(np.load(path), output_dir=folder, fname="dam")
        options = ["--quiet", "--disable-output", "--openmp", "--max-steps", str(BLOCK + steps)]
        dam.run([*options, "--cache-nnps"] if cached else options)
    fluid = dam.particles[0]
    if not np.isfinite(fluid.y).all():
        raise FloatingPointError("PySPH's dam break blew up: its time does not count")
    blocks = np.diff(dam.clock[BLOCK - 1 :: BLOCK]) / BLOCK
    return {
        "seconds_per_step": statistics.median(blocks.tolist()),
        "particles": fluid.get_number_of_particles(),
        "cached_neighbors": cached,
        "dtype": "float64",
        "cpu_per_wall": (dam.processor[-1] - dam.processor[BLOCK - 1]) / (dam.clock[-1] - dam.clock[BLOCK - 1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="time PySPH's dam break")
    parser.add_argument("--particles", type=Path, required=True, help="npz of fluid, boundary, numbers of the case")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--cached", action="store_true", help="let PySPH keep its neighbors within a step")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    result = measure(options.particles, options.steps, options.cached)
    options.out.write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main()
