"""Particle-steps per second of a breaking dam, beside PySPH and pySPlisHSPlasH.

Ours is a run of `jaxsph.simulate` with what belongs to it: neighbor lists built anew, particles sorted, states saved.
PySPH gets the same particles, the same kernel and support radius (Wendland C2, 2.6 spacings) and shorter time steps; it
computes in float64 and finds neighbors in every step. Its walls lack the outermost of our four layers, out of reach of
the water. pySPlisHSPlasH makes its own particles of the same column, has a support radius of two spacings, that is half
as many neighbors, and computes in float32. All evaluate forces once in a step.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measure import Timing, row, threads

import jaxsph

SMOOTHING = 1.3  # smoothing length in spacings: PySPH's
ALPHA = 0.1  # of the artificial viscosity
LENGTH, HEIGHT, COLUMN = 3.2196, 1.8, (1.2, 0.6)
STEPS_OF_SAVE = 64
ROUNDS = 5
PYSPH_STEP = 0.25  # of ours, at which its particles fly apart; steps are what is counted
UNIT = "M particle-steps/s"


@dataclass(frozen=True)
class Case:
    """A size: particles over the height, in 2D or 3D, and how many steps the peers are timed over."""

    name: str
    across: int
    depth: float | None
    saves: int
    peer_steps: int


CASES = (
    Case("2D, 10k", 71, None, 8, 100),
    Case("2D, 50k", 158, None, 3, 40),
    Case("3D, 64k", 32, 0.6, 1, 20),
)
QUICK_CASES = (Case("2D, quick", 30, None, 2, 20),)
LARGE = Case("2D, 1M", 707, None, 1, 0)


def scene_of(case: Case, dtype: str, *, diffusion: bool = False):
    """The dam; with PySPH's scheme, or with the diffusion of density that is our default."""
    effects: list = [jaxsph.ArtificialViscosity(ALPHA)]
    if diffusion:
        effects.append(jaxsph.DeltaDiffusion(0.1))
    return jaxsph.scenes.dam_break(
        case.across, depth=case.depth, effects=effects, smoothing=SMOOTHING, hydrostatic=False, dtype=dtype
    )


class Dam:
    """Runs of one save and of several: the same compiled steps, so that their difference is the steps' alone."""

    def __init__(self, scene, saves: int):
        self.scene, self.saves = scene, saves
        self.found = jaxsph.topologies(scene)
        self.time_step = jaxsph.stable_time_step(scene, self.found)
        self.particles = scene.fluids[0].n_particles
        self.walls = scene.walls[0].n_particles
        self.seconds: list[float] = []
        self.processor: list[float] = []
        first, second = self.run(1)[0], self.run(1)[0]
        self.compile_seconds = max(first - second, 0.0)

    def run(self, saves: int) -> tuple[float, float]:
        """Seconds on the clock and of the processor."""
        every = STEPS_OF_SAVE * self.time_step * (1 - 1e-6)  # a hair less, or rounding makes one step more
        cpu, wall = time.process_time(), time.perf_counter()
        run = jaxsph.simulate(
            self.scene, saves * every, every, time_step=self.time_step, topologies_of_scene=self.found
        )
        np.asarray(run.final.systems["water"]["position"])
        return time.perf_counter() - wall, time.process_time() - cpu

    def measure(self) -> None:
        """One round."""
        short, long = self.run(1), self.run(1 + self.saves)
        steps = self.saves * STEPS_OF_SAVE
        self.seconds.append((long[0] - short[0]) / steps)
        self.processor.append((long[1] - short[1]) / steps)

    def timing(self) -> Timing:
        wall, cpu = statistics.median(self.seconds), statistics.median(self.processor)
        return Timing(wall, min(self.seconds), self.compile_seconds, cpu / wall, tuple(self.seconds))

    @property
    def resolution(self) -> str:
        return f"{self.particles:,} particles, {self.walls:,} of walls"


class Peer(ABC):
    """Another code in a process of its own, timed in turn with ours; or the reason why it is not."""

    package, program, precision = "", "", ""
    step = 1.0  # of ours

    def __init__(self, case: Case, dam: Dam, folder: Path):
        self.case, self.dam, self.folder = case, dam, folder
        self.results: list[dict] = []
        self.reason = ""
        try:
            importlib.metadata.version(self.package)
        except importlib.metadata.PackageNotFoundError:
            self.reason = "not installed: pip install 'jaxsph[bench]'"
            return
        self.measure()  # compiles, if it compiles
        self.results.clear()

    @abstractmethod
    def arguments(self) -> list[str]:
        """Of the program's command line."""

    def environment(self) -> dict[str, str]:
        return {**os.environ, "OMP_NUM_THREADS": str(threads())}

    def measure(self) -> None:
        if self.reason:
            return
        out = self.folder / f"{self.package}.json"
        command = [sys.executable, str(Path(__file__).with_name(self.program)), "--out", str(out)]
        command += [*self.arguments(), "--steps", str(self.case.peer_steps)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False, env=self.environment())
        if finished.returncode or not out.is_file():
            lines = (finished.stderr or finished.stdout).strip().splitlines() or ["no message"]
            self.reason = f"does not run here: {lines[-1][:200]}"
            return
        self.results.append(json.loads(out.read_text(encoding="utf-8")))
        out.unlink()

    def timing(self) -> Timing:
        seconds = [result["seconds_per_step"] for result in self.results]
        cpu = statistics.median(result["cpu_per_wall"] for result in self.results)
        return Timing(statistics.median(seconds), min(seconds), None, cpu, tuple(seconds))


class PySPH(Peer):
    package, program, precision = "pysph", "pysph_dam.py", "float64"
    step = PYSPH_STEP

    def __init__(self, case: Case, dam: Dam, folder: Path):
        scene = dam.scene
        water = np.asarray(scene.fluids[0].particles.positions)
        walls = np.asarray(scene.walls[0].particles.positions)
        upper = np.array([LENGTH, HEIGHT] if case.depth is None else [LENGTH, case.depth, HEIGHT])
        away = np.max(np.maximum(-walls, walls - upper), axis=1)
        np.savez(
            folder / "particles.npz",
            fluid=water,
            boundary=walls[away < 3 * scene.spacing],
            spacing=scene.spacing,
            sound_speed=scene.fluids[0].sound_speed,
            time_step=PYSPH_STEP * dam.time_step,
            alpha=ALPHA,
        )
        super().__init__(case, dam, folder)

    def arguments(self):
        return ["--particles", str(self.folder / "particles.npz")]


class SPlisHSPlasH(Peer):
    package, program, precision = "pysplishsplash", "splishsplash_dam.py", "float32"

    def arguments(self):
        spacing, numbers = float(self.dam.scene.spacing), [*COLUMN, LENGTH, HEIGHT]
        column_and_tank = ["--column", *map(str, numbers[:2]), "--tank", *map(str, numbers[2:])]
        shape = [] if self.case.depth is None else ["--depth", str(self.case.depth)]
        return ["--spacing", str(spacing), *column_and_tank, *shape, "--time-step", str(self.dam.time_step)]

    def environment(self):
        return {**super().environment(), "LD_PRELOAD": "libGLdispatch.so.0"}


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one size after the other."""
    cost = {}
    for case in QUICK_CASES if quick else CASES:
        with tempfile.TemporaryDirectory() as folder:
            dams = {"speed": Dam(scene_of(case, precision), case.saves)}
            dams["speed with density diffusion"] = Dam(scene_of(case, precision, diffusion=True), case.saves)
            dam = dams["speed"]
            peers = [PySPH(case, dam, Path(folder)), SPlisHSPlasH(case, dam, Path(folder))]
            for _ in range(ROUNDS):
                for turn in [*dams.values(), *peers]:
                    turn.measure()
        cost[case.name] = dam.timing().seconds / dam.particles
        yield rows_of(case, precision, dams, peers)
    if not quick:
        yield [large(precision, cost[CASES[0].name])]
        yield [simulated_second(precision)]


def rows_of(case: Case, precision: str, dams: dict[str, Dam], peers: list[Peer]) -> list[dict]:
    """Speeds of ours and of the peers, and ours over theirs."""
    about = (f"dam_break.{case.name.replace(', ', '.')}.{precision}", f"dam break, {case.name}")
    made = []
    for figure, dam in dams.items():
        timing = dam.timing()
        print(timing.line(f"{case.name}, {figure}"), flush=True)
        speed = dam.particles / timing.seconds / 1e6
        made.append(row(*about, figure, speed, UNIT, dam.resolution, precision, timing=timing))
    ours = dams["speed"]
    for peer in peers:
        if peer.reason:
            print(f"  {peer.package} {peer.reason}", flush=True)
            made.append(row(*about, f"speed ({peer.reason})", None, UNIT, "", peer.precision, peer=peer.package))
            continue
        timing, particles = peer.timing(), peer.results[0]["particles"]
        print(timing.line(f"{case.name}, {peer.package}, {particles:,} particles"), flush=True)
        speed = particles / timing.seconds / 1e6
        resolution = f"{particles:,} particles"
        made.append(
            row(*about, "speed", speed, UNIT, resolution, peer.precision, peer=type(peer).__name__, timing=timing)
        )
        ratio = timing.over(ours.timing()) * ours.particles / particles
        figure = f"speed / speed of {type(peer).__name__}"
        made.append(row(*about, figure, ratio, "times", ours.resolution, precision))
        if peer.step != 1:
            figure = f"simulated time in the same time / that of {type(peer).__name__}"
            made.append(row(*about, figure, ratio / peer.step, "times", ours.resolution, precision))
    return made


def large(precision: str, cost: float) -> dict:
    """What a particle-step costs at a million particles, over what it costs at ten thousand."""
    dam = Dam(scene_of(LARGE, precision), LARGE.saves)
    dam.measure()
    timing = dam.timing()
    print(timing.line(LARGE.name), flush=True)
    return row(
        f"dam_break.cost.{precision}",
        f"dam break, {LARGE.name}",
        "cost of a particle-step / cost at 10k",
        timing.seconds / dam.particles / cost,
        "times",
        dam.resolution,
        precision,
        timing=timing,
    )


def simulated_second(precision: str) -> dict:
    """A whole run of the smallest case to t = 1 s, 50 states saved, without what was compiled before."""
    scene = scene_of(CASES[0], precision)
    jaxsph.simulate(scene, 0.02, 0.02)
    begin = time.perf_counter()
    run = jaxsph.simulate(scene, 1.0, 0.02)
    np.asarray(run.final.systems["water"]["position"])
    seconds = time.perf_counter() - begin
    print(f"  one simulated second: {seconds:.2f} s in steps of {run.time_step:.3g} s", flush=True)
    return row(
        f"dam_break.second.{precision}",
        f"dam break, {CASES[0].name}",
        "time of a simulated second, 50 states saved",
        seconds,
        "s",
        f"{scene.fluids[0].n_particles:,} particles, steps of {run.time_step:.3g} s",
        precision,
    )
