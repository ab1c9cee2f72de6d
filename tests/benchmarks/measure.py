"""Timing that is fair on a machine with other work on it, and the rows that come out of it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import jax

import jaxsph

Name = TypeVar("Name")
VERSIONS_SHOWN = ("jax", "jax-md", "pysph", "pysplishsplash")


@dataclass(frozen=True)
class Timing:
    """Seconds of one call: median and fastest of the repetitions; compilation apart, None where it is not known.

    `cpu_per_wall` is the processor time of the process over the time on the clock: how many cores worked. Below one,
    others had the processor.
    """

    seconds: float
    fastest: float
    compile_seconds: float | None
    cpu_per_wall: float
    rounds: tuple[float, ...]

    @property
    def repetitions(self) -> int:
        return len(self.rounds)

    def over(self, other: Timing) -> float:
        """How many times as long as another call: the median of the ratios within each round.

        What slows down a whole round leaves its ratio alone, so this holds on a busy machine where times do not.
        """
        return statistics.median(a / b for a, b in zip(self.rounds, other.rounds, strict=True))

    def line(self, name: str, pairs: float | None = None) -> str:
        """For the screen; with the number of pairs also pairs per second."""
        speed = "" if pairs is None else f"  {pairs / self.seconds / 1e6:8.1f} M pairs/s"
        compiled = "" if self.compile_seconds is None else f"  compiled in {self.compile_seconds:5.2f} s"
        return (
            f"  {name:<36} {self.seconds * 1e3:9.3f} ms (fastest {self.fastest * 1e3:9.3f}, {self.repetitions} times)"
            + f"{speed}  cpu/wall {self.cpu_per_wall:4.2f}{compiled}"
        )


def compiled(function: Callable, *arguments: Any) -> tuple[Callable[[], Any], float]:
    """A call of the compiled function that waits for its result, and the seconds of tracing and compiling."""
    begin = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    seconds = time.perf_counter() - begin
    return lambda: jax.block_until_ready(program(*arguments)), seconds


def interleaved(calls: Mapping[Name, tuple[Callable[[], Any], float]], budget: float) -> dict[Name, Timing]:
    """Time calls in turn, A B C A B C ..., so that whatever slows the machine down meets all of them.

    In each turn a call is made twice and the second one counts: it finds its own data in the caches, as in a run,
    and not that of the others.

    Args:
        calls: by name a call, and the seconds that its compilation took.
        budget: seconds to spend, repetitions permitting: there are at least 5 and at most 101.
    """
    begin = time.perf_counter()
    for call, _ in calls.values():
        call()  # the first one touches new memory
    once = time.perf_counter() - begin
    repetitions = int(min(max(0.5 * budget / max(once, 1e-9), 5), 101))
    walls: dict[Name, list[float]] = {name: [] for name in calls}
    processor = dict.fromkeys(calls, 0.0)
    for _ in range(repetitions):
        for name, (call, _) in calls.items():
            call()
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            walls[name].append(time.perf_counter() - wall)
            processor[name] += time.process_time() - cpu
    return {
        name: Timing(statistics.median(w), min(w), calls[name][1], processor[name] / sum(w), tuple(w))
        for name, w in walls.items()
    }


def steps_of(scene: jaxsph.Scene, steps: int, step: float, state: Any, topologies: dict) -> tuple[Callable, float]:
    """A run of some steps [s] from a state on, None for the start, and the seconds of its first call: it compiles."""

    def run():
        # a hair less than the whole of them, or rounding makes one more
        out = jaxsph.simulate(
            scene, steps * step * (1 - 1e-6), state=state, time_step=step, topologies_of_scene=topologies
        )
        return jax.block_until_ready(out.final)

    begin = time.perf_counter()
    run()
    return run, time.perf_counter() - begin


def threads() -> int:
    """Cores that this process may use; XLA and OpenMP start that many threads."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> str:
    """Processor, cores, and the versions of Python and of all codes that are measured."""
    model, path = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    versions = [f"Python {platform.python_version()}"]
    for package in VERSIONS_SHOWN:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"without {package}")
    return f"{model}, {threads()} cores, {', '.join(versions)}"


def row(
    identity: str,
    case: str,
    figure: str,
    value: float | None,
    unit: str,
    resolution: str,
    precision: str,
    peer: str = "jaxsph",
    timing: Timing | None = None,
) -> dict[str, Any]:
    """A row of benchmark.json. With the timing behind it also what the tables do not show.

    Args:
        identity: begins with the name of the part, "pair_sum.2d"; the rest of the id is made here.
        peer: the code that was measured.
    """
    about = {} if timing is None else {
        "seconds": timing.seconds,
        "compile_seconds": timing.compile_seconds and round(timing.compile_seconds, 3),
        "cpu_per_wall": round(timing.cpu_per_wall, 3),
        "repetitions": timing.repetitions,
    }  # fmt: skip
    return {
        "id": identity,
        "case": case,
        "figure": figure,
        "value": value,
        "unit": unit,
        "resolution": resolution,
        "precision": precision,
        "peer": peer,
        "threads": threads(),
        "machine": machine(),
        **about,
    }
