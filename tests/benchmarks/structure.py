"""Particle-steps per second of the total-Lagrangian solid, beside PySPH's oscillating plate.

Ours is a run of `jaxsph.simulate` with its default time step: a plate as thick as PySPH's and of its material, with
about as many particles. The two differ in what a step is. Ours keeps the list of the reference configuration and
evaluates forces once; PySPH's example follows the current configuration (Gray, Monaghan, Swift 2001): it finds the
neighbors anew, and carries density, stress rate, artificial viscosity and stress. Both are what one would
run for the same plate.
"""

from __future__ import annotations

import importlib.metadata
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measure import Timing, row

import jaxsph

ACROSS = 21  # particles over the thickness of .02 m: a spacing of 1 mm
LENGTH = 0.272  # [m]; with the clamped root 276 columns
QUICK_ACROSS = 11
STEPS_OF_BLOCK = 250
BLOCKS = 16
ROUNDS = 3


def plate(across: int, penalty: float, dtype: str):
    """A cantilever of the material of PySPH's plate, under gravity so that it moves."""
    return jaxsph.scenes.cantilever(
        LENGTH,
        0.02,
        across,
        density=1000.0,
        youngs_modulus=2e6,
        poisson_ratio=0.3975,
        gravity=(0.0, -9.81),
        penalty=penalty,
        dtype=dtype,
    )


class Plate:
    """A run in blocks of steps: one block and many have the same compiled step, their difference is the steps'."""

    def __init__(self, across: int, penalty: float, dtype: str, blocks: int):
        self.scene = plate(across, penalty, dtype)
        self.found = jaxsph.topologies(self.scene)
        self.time_step = jaxsph.stable_time_step(self.scene, self.found)
        self.blocks = blocks
        self.particles = self.scene.systems[0].n_particles
        self.neighbors = float(np.mean(self.found["beam"].neighbors.count))
        self.seconds: list[float] = []
        self.processor: list[float] = []
        first, second = self.run(1)[0], self.run(1)[0]
        self.compile_seconds = max(first - second, 0.0)

    def run(self, blocks: int) -> tuple[float, float]:
        """Seconds on the clock and of the processor."""
        every = STEPS_OF_BLOCK * self.time_step
        cpu, wall = time.process_time(), time.perf_counter()
        run = jaxsph.simulate(
            self.scene, blocks * every, every, time_step=self.time_step, topologies_of_scene=self.found
        )
        run.final.systems["beam"]["displacement"].block_until_ready()
        return time.perf_counter() - wall, time.process_time() - cpu

    def measure(self) -> None:
        """One round: a run of one block and a run of many."""
        short, long = self.run(1), self.run(1 + self.blocks)
        steps = self.blocks * STEPS_OF_BLOCK
        self.seconds.append((long[0] - short[0]) / steps)
        self.processor.append((long[1] - short[1]) / steps)

    def timing(self) -> Timing:
        wall, cpu = statistics.median(self.seconds), statistics.median(self.processor)
        return Timing(wall, min(self.seconds), self.compile_seconds, cpu / wall, tuple(self.seconds))


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of both variants of ours and of PySPH, measured in turn."""
    across, blocks = (QUICK_ACROSS, 2) if quick else (ACROSS, BLOCKS)
    runs = {
        "with penalty force": Plate(across, 0.05, precision, blocks),
        "without penalty force": Plate(across, 0.0, precision, blocks),
    }
    peer = Peer(0.02 / (across - 1), 40 if quick else 200) if precision == "float64" else None
    for _ in range(ROUNDS):
        for run in runs.values():
            run.measure()
        if peer is not None:
            peer.measure()
    made = []
    for name, run in runs.items():
        timing = run.timing()
        print(timing.line(f"solid, {run.particles:,} particles, {name}"), flush=True)
        made.append(
            row(
                f"structure.{name.replace(' ', '_')}.{run.particles}.{precision}",
                "elastic plate, total-Lagrangian",
                f"speed {name}",
                run.particles / timing.seconds / 1e6,
                "M particle-steps/s",
                f"{run.particles:,} particles, {run.neighbors:.1f} neighbors",
                precision,
                timing=timing,
            )
        )
    yield made if peer is None else [*made, peer.row()]


class Peer:
    """PySPH's oscillating plate in a process of its own; compiled in a run that does not count."""

    def __init__(self, spacing: float, steps: int):
        self.spacing, self.steps = spacing, steps
        self.results: list[dict] = []
        self.reason = ""
        try:
            importlib.metadata.version("pysph")
        except importlib.metadata.PackageNotFoundError:
            self.reason = "not installed: pip install 'jaxsph[bench]', with a C++ compiler"
            return
        for cached in (False, True):
            self.call(cached, 20)
        self.results.clear()

    def measure(self) -> None:
        """One round: with and without PySPH's cache of neighbors."""
        for cached in (False, True):
            self.call(cached, self.steps)

    def call(self, cached: bool, steps: int) -> None:
        if self.reason:
            return
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "plate.json"
            command = [sys.executable, str(Path(__file__).with_name("pysph_plate.py")), "--out", str(out)]
            command += ["--spacing", str(self.spacing), "--steps", str(steps), *(["--cached"] if cached else [])]
            finished = subprocess.run(command, capture_output=True, text=True, check=False)
            if finished.returncode:
                lines = (finished.stderr or finished.stdout).strip().splitlines() or ["no message"]
                self.reason = f"does not run here: {lines[-1]}"
                return
            self.results.append(json.loads(out.read_text(encoding="utf-8")))

    def row(self) -> dict:
        """Its row: the faster of its two settings, or why there is no value."""
        about = ("structure.peer.float64", "oscillating plate, updated Lagrangian")
        unit = "M particle-steps/s"
        if self.reason:
            print(f"  PySPH {self.reason}", flush=True)
            return row(*about, f"speed ({self.reason})", None, unit, "", "float64", peer="PySPH")
        by_setting = {}
        for cached in (False, True):
            results = [result for result in self.results if result["cached_neighbors"] == cached]
            timings = [result["seconds_per_step"] for result in results]
            cpu = statistics.median(result["cpu_per_wall"] for result in results)
            by_setting[cached] = Timing(statistics.median(timings), min(timings), None, cpu, tuple(timings))
            print(by_setting[cached].line(f"PySPH, neighbors cached: {cached}"), flush=True)
        cached = min(by_setting, key=lambda setting: by_setting[setting].seconds)
        particles, neighbors = self.results[0]["particles"], self.results[0]["neighbors"]
        return row(
            *about,
            f"speed ({'with' if cached else 'without'} its neighbor cache, the faster)",
            particles / by_setting[cached].seconds / 1e6,
            unit,
            f"{particles:,} particles, {neighbors:.1f} neighbors",
            "float64",
            peer="PySPH",
            timing=by_setting[cached],
        )
