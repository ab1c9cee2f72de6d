"""pySPlisHSPlasH's weakly compressible dam break: where its front is, and how long it takes.

A program of its own. The shared library of the wheel wants the system's libGLdispatch loaded before it, which `peers`
sees to. Its support radius is two spacings, and it computes in single precision. The column is 1 m x 2 m in a tank of
4 m; the sound speed is ten times the speed of free fall, as in PySPH's example, the step a quarter of the time in which
sound crosses the support.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

WIDTH, HEIGHT, TANK, GRAVITY = 1.0, 2.0, 4.0, 9.81
SOUND = 10 * np.sqrt(2 * GRAVITY * HEIGHT)
WCSPH, AKINCI = 0, 0  # its numbers of the method and of boundaries made of particles
BOX = "v -.5 -.5 -.5\nv .5 -.5 -.5\nv -.5 .5 -.5\nv .5 .5 -.5\nv -.5 -.5 .5\nv .5 -.5 .5\nv -.5 .5 .5\nv .5 .5 .5\n"
FACES = "1 3 2,2 3 4,5 6 7,6 8 7,1 2 5,2 6 5,3 7 4,4 7 8,1 5 3,3 5 7,2 4 6,4 8 6"


def description(spacing: float, time_step: float, folder: Path) -> Path:
    """Its scene file, height along y."""
    mesh = folder / "box.obj"
    mesh.write_text(BOX + "".join(f"f {face}\n" for face in FACES.split(",")), encoding="utf-8")
    half = spacing / 2
    scene = {
        "Configuration": {
            "pause": False,
            "sim2D": True,
            "particleRadius": half,
            "simulationMethod": WCSPH,
            "gravitation": [0, -GRAVITY, 0],
            "cflMethod": 0,
            "timeStepSize": time_step,
            "boundaryHandlingMethod": AKINCI,
            "WCSPH": {"stiffness": 1000 * SOUND**2 / 7, "exponent": 7},
        },
        "Materials": [
            {"id": "Fluid", "density0": 1000, "viscosityMethod": 1, "Standard viscosity": {"viscosity": 0.01}}
        ],
        "RigidBodies": [
            {
                "geometryFile": str(mesh),
                "translation": [TANK / 2, TANK / 2, 0],
                "scale": [TANK, TANK, 1.0],
                "isDynamic": False,
                "isWall": True,
                "mapInvert": True,
            }
        ],
        "FluidBlocks": [{"denseMode": 0, "start": [half, half, -1.0], "end": [WIDTH + half, HEIGHT + half, 1.0]}],
    }
    path = folder / "scene.json"
    path.write_text(json.dumps(scene), encoding="utf-8")
    return path


def measure(n: int) -> dict:
    """Times, front [m], seconds, steps and particles of one run to T = 2.5."""
    import pysplishsplash as splash  # pyright: ignore[reportMissingImports]

    spacing = HEIGHT / n
    time_step = 0.25 * 2 * spacing / SOUND
    end = 2.5 / np.sqrt(2 * GRAVITY / WIDTH)
    looks = {"times": [], "front": []}
    clock = {"first": 0.0, "last": 0.0, "paused": 0.0, "steps": 0}

    def front():
        model = splash.Simulation.getCurrent().getFluidModel(0)
        return max(float(model.getPosition(i)[0]) for i in range(model.numActiveParticles()))

    def after_step():
        now, when = time.perf_counter(), splash.TimeManager.getCurrent().getTime()
        clock["first"] = clock["first"] or now
        clock["last"], clock["steps"] = now, clock["steps"] + 1
        if when >= len(looks["times"]) * end / 50:
            looks["times"].append(when)
            looks["front"].append(front())
            clock["paused"] += time.perf_counter() - now

    with tempfile.TemporaryDirectory() as folder:
        base = splash.Exec.SimulatorBase()
        base.init(
            sceneFile=str(description(spacing, time_step, Path(folder))),
            outputDir=folder,
            useGui=False,
            initialPause=False,
            useCache=False,
            stopAt=1.01 * end,
        )
        base.setTimeStepCB(after_step)
        base.initSimulation()
        base.runSimulation()
        simulation = splash.Simulation.getCurrent()
        count = simulation.numberOfPointSets()
        models = simulation.numberOfFluidModels()
        particles = sum(simulation.getFluidModel(i).numActiveParticles() for i in range(models))
        walls = sum(simulation.getBoundaryModelFromPointSet(i).numberOfParticles() for i in range(models, count))
        base.cleanup()
    steps = clock["steps"]
    seconds = (clock["last"] - clock["first"] - clock["paused"]) * steps / (steps - 1)
    if not np.isfinite(looks["front"]).all():
        raise FloatingPointError(f"the dam of pySPlisHSPlasH at {n} blew up: its time does not count")
    return {**looks, "seconds": seconds, "steps": steps, "n_particles": particles + walls}


def main() -> None:
    parser = argparse.ArgumentParser(description="time pySPlisHSPlasH's dam break")
    parser.add_argument("name", choices=["dam_break"])
    parser.add_argument("--particles", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    found: dict = {name: np.array(value) for name, value in measure(options.particles).items()}
    np.savez(options.out, **found)
    sys.stdout.flush()
    os._exit(0)  # its own end of the process waits for a window that was never opened


if __name__ == "__main__":
    main()
