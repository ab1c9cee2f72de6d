"""PySPH's own oscillating plate, timed: the peer of the structure benchmark.

A program of its own, so that its OpenMP threads and those of JAX do not share a process. Physics, kernel (cubic
spline, h = 1.3 spacings), search and integrator are those of pysph.examples.solid_mech.oscillating_plate; only the
spacing and, in proportion, the time step are changed, and nothing is written to disk.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from pysph.examples.solid_mech.oscillating_plate import OscillatingPlate  # pyright: ignore[reportMissingImports]
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

SUPPORT = 2.0  # support radius of PySPH's cubic spline in smoothing lengths
BLOCK = 20  # steps between two looks at the clock


class TimedPlate(OscillatingPlate):
    """The example at another spacing, with the time and the processor time [s] after every step."""

    def __init__(self, spacing: float, **options):
        self.asked_spacing = spacing
        self.clock: list[float] = []
        self.processor: list[float] = []
        super().__init__(**options)

    def initialize(self):
        super().initialize()
        self.dt *= self.asked_spacing / self.dx_plate
        self.dx_plate = self.asked_spacing
        self.h = 1.3 * self.dx_plate

    def post_step(self, solver):
        self.clock.append(time.perf_counter())
        self.processor.append(time.process_time())


def measure(spacing: float, steps: int, cached: bool) -> dict:
    """Seconds of a step: the median over blocks, after a first block that is not counted."""
    with tempfile.TemporaryDirectory() as folder:
        plate = TimedPlate(spacing, output_dir=folder, fname="plate")
        options = ["--quiet", "--disable-output", "--max-steps", str(BLOCK + steps)]
        plate.run([*options, "--cache-nnps"] if cached else options)
    blocks = np.diff(plate.clock[BLOCK - 1 :: BLOCK]) / BLOCK
    arrays = {array.name: array for array in plate.particles}
    everyone = np.concatenate([np.stack([array.x, array.y], 1) for array in arrays.values()])
    moving = arrays["plate"]
    tree = cKDTree(everyone)
    near = tree.query_ball_point(np.stack([moving.x, moving.y], 1), SUPPORT * plate.h, return_length=True)
    if not np.isfinite(moving.y).all():
        raise FloatingPointError("PySPH's plate blew up: its time does not count")
    return {
        "seconds_per_step": statistics.median(blocks.tolist()),
        "particles": len(everyone),
        "neighbors": float(np.mean(near)) - 1.0,
        "cached_neighbors": cached,
        "cpu_per_wall": (plate.processor[-1] - plate.processor[BLOCK - 1]) / (plate.clock[-1] - plate.clock[BLOCK - 1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="time PySPH's oscillating plate")
    parser.add_argument("--spacing", type=float, default=0.001)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--cached", action="store_true", help="let PySPH keep its neighbors within a step")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.write_text(json.dumps(measure(options.spacing, options.steps, options.cached)), encoding="utf-8")


if __name__ == "__main__":
    main()
