"""cost: time and memory of derivatives over thousands of steps, as multiples of a forward run."""

from __future__ import annotations

import ctypes
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import jax

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)

import numpy as np
from motion import TIP
from rows import Case, Row, across, precision

import inverse
import jaxsph

STEPS = 5000
REPEATS, COUPLED_REPEATS = 5, 3
ONE_LEVEL_BUDGET = 2**30  # bytes: enough to keep the states of 5,000 steps at 9 across
MEMORY_STEPS = (1000, 4000, 16000)
MEMORY_BUDGET = 2**24  # bytes: passed by all three
MEMORY_PARTICLES = 9
SLACK = 1.5  # on the growth like sqrt(steps) and on time per step: block lengths are whole numbers, clocks are noisy


def tip_after(particles: int, dtype, steps: int, mode: str, memory_budget: int) -> tuple[Callable, np.ndarray]:
    """Function E -> tip uy after some steps, and the value of E to ask it at."""
    scene = jaxsph.scenes.turek_hron_beam(particles, dtype=dtype)
    step = jaxsph.stable_time_step(scene)
    modulus = np.asarray(scene["beam"].youngs_modulus)

    def tip(youngs_modulus):
        changed = scene.replace({"beam.youngs_modulus": youngs_modulus})
        run = jaxsph.simulate(
            changed, steps * step, time_step=step * (1 + 1e-6), mode=mode, memory_budget=memory_budget
        )
        return run.probe("beam", TIP).displacement[-1, 1]

    return tip, modulus


def derivative_cost(quick: bool) -> Iterator[list[Row]]:
    """Medians over rounds, in each of which every program runs once, in one process."""
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        particles = 5 if quick else 9
        forward, modulus = tip_after(particles, dtype, STEPS, "forward", ONE_LEVEL_BUDGET)
        kept, _ = tip_after(particles, dtype, STEPS, "reverse", ONE_LEVEL_BUDGET)
        blocks, _ = tip_after(particles, dtype, STEPS, "reverse", 0)
        one = np.ones_like(modulus)
        programs = {
            "forward run": jax.jit(forward),
            "tangent": jax.jit(lambda e, forward=forward, one=one: jax.jvp(forward, (e,), (one,))[1]),
            "gradient": jax.jit(jax.grad(kept)),
            "gradient in blocks": jax.jit(jax.grad(blocks)),
        }
        seconds, ratios = timed(programs, modulus, REPEATS)
        where = (f"{across(particles)}, {STEPS} steps", precision(dtype))
        yield [
            Row("forward run [s]", seconds, None, *where),
            Row("one forward-mode tangent / forward run", ratios["tangent"], 2.5, *where),
            Row("reverse-mode gradient / forward run", ratios["gradient"], 4.0, *where),
            Row("the same beyond the memory budget, in blocks", ratios["gradient in blocks"], None, *where),
        ]


def timed(programs: dict, argument: np.ndarray, repeats: int) -> tuple[float, dict[str, float]]:
    """Median seconds of "forward run", and of each program the median of its time over that."""
    compiled = {name: program.lower(argument).compile() for name, program in programs.items()}
    seconds = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in compiled.items():
            begin = time.perf_counter()
            jax.block_until_ready(program(argument))
            seconds[name].append(time.perf_counter() - begin)
    # ratios within a round: what else the machine does then falls on both
    ratios = {name: float(np.median(np.divide(each, seconds["forward run"]))) for name, each in seconds.items()}
    return float(np.median(seconds["forward run"])), ratios


def coupled_cost(quick: bool) -> Iterator[list[Row]]:
    """The dam break on an elastic plate over its whole second: derivative of the tip's mean by Young's modulus."""
    particles, end = (10, 0.1) if quick else (15, 1.0)
    scene = jaxsph.scenes.dam_break_plate(particles, 5, dtype=np.float32)
    times = end / 20 * np.arange(1, 21)
    unknown = {"plate.youngs_modulus": inverse.log(8e5, 1.2e6, start=1e6, unit="Pa")}
    observe = lambda run: run.probe("plate", (0.292, 0.08)).displacement[:, 0]  # noqa: E731
    problem = inverse.Problem(scene, observe, inverse.Observations(times, np.zeros(20)), unknown)
    problem.simulate._options["memory_budget"] = ONE_LEVEL_BUDGET
    modulus = np.array([1e6], np.float32)

    def tip(mode):
        return lambda values: problem.model(values, mode).mean()

    programs = {
        "forward run": jax.jit(tip("forward")),
        "tangent": jax.jit(lambda e: jax.jvp(tip("forward"), (e,), (e,))[1]),
        "gradient": jax.jit(jax.grad(tip("reverse"))),
    }
    seconds, ratios = timed(programs, modulus, COUPLED_REPEATS)
    where = (f"{particles} over the width, {end:g} s", "float32")
    yield [
        Row("forward run [s]", seconds, None, *where),
        Row("one forward-mode tangent / forward run", ratios["tangent"], 2.5, *where),
        Row("reverse-mode gradient / forward run", ratios["gradient"], 4.0, *where),
    ]


def memory(quick: bool) -> Iterator[list[Row]]:
    """Gradients beyond the budget, each in a fresh process."""
    seconds, peaks = {}, {}
    for steps in MEMORY_STEPS[:2] if quick else MEMORY_STEPS:
        asked = [sys.executable, str(Path(__file__).resolve()), str(steps)]
        answer = subprocess.run(asked, capture_output=True, text=True)
        if answer.returncode:
            raise RuntimeError(f"the gradient over {steps} steps failed:\n{answer.stderr}")
        measured = json.loads(answer.stdout.splitlines()[-1])
        seconds[steps], peaks[steps] = measured["seconds"], measured["bytes"]
        where = (f"{across(MEMORY_PARTICLES)}, {steps} steps", "float32")
        budget = f"budget {MEMORY_BUDGET >> 20} MiB"
        yield [
            Row(f"peak memory of a gradient, {budget} [MiB]", peaks[steps] / 2**20, None, *where),
            Row(f"processor time of a gradient, {budget} [s]", seconds[steps], None, *where),
        ]
    few, many = min(peaks), max(peaks)
    where = (f"{across(MEMORY_PARTICLES)}, {few} to {many} steps", "float32")
    root = np.sqrt(many / few)
    yield [
        Row("growth of the memory / growth of sqrt(steps)", peaks[many] / peaks[few] / root, SLACK, *where),
        Row(
            "growth of the processor time / growth of the steps",
            seconds[many] / seconds[few] / (many / few),
            SLACK,
            *where,
        ),
    ]


def measure(steps: int) -> dict[str, float]:
    """Processor seconds of a compiled gradient, and by how many bytes it raises the process's memory at its peak."""
    tip, modulus = tip_after(MEMORY_PARTICLES, np.float32, steps, "reverse", MEMORY_BUDGET)
    gradient = jax.jit(jax.grad(tip)).lower(modulus).compile()
    before = start_peak()
    begin = time.process_time()  # of all threads: what else runs meanwhile does not count
    jax.block_until_ready(gradient(modulus))
    return {"seconds": time.process_time() - begin, "bytes": peak() - before}


def start_peak() -> int:
    """Forget the peak that compiling left behind, where the system can, and return the memory in use now [bytes]."""
    if Path("/proc/self/clear_refs").exists():
        ctypes.CDLL(None).malloc_trim(0)  # what compiling freed would be used again without a trace
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return peak()


def peak() -> int:
    """Largest resident memory of this process [bytes]."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


CASES = [
    Case("cost", "Cost of derivatives", derivative_cost),
    Case("cost_fsi", "Cost of derivatives, dam break on an elastic plate", coupled_cost),
    Case("memory", "Memory of a gradient beyond the budget", memory),
]

if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]))))
