"""pySPlisHSPlasH's weakly compressible dam break, timed through its callback after every step: a peer of `dam_break`.

A program of its own. The shared library of the wheel wants the system's libGLdispatch loaded before it, which
`dam_break` sees to. Its support radius is two spacings and cannot be chosen, and it computes in single precision.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

BLOCK = 10  # steps between two looks at the clock
WCSPH, AKINCI = 0, 0  # its numbers of the method and of boundaries made of particles
BOX = "v -.5 -.5 -.5\nv .5 -.5 -.5\nv -.5 .5 -.5\nv .5 .5 -.5\nv -.5 -.5 .5\nv .5 -.5 .5\nv -.5 .5 .5\nv .5 .5 .5\n"
FACES = "1 3 2,2 3 4,5 6 7,6 8 7,1 2 5,2 6 5,3 7 4,4 7 8,1 5 3,3 5 7,2 4 6,4 8 6"


def description(options, folder: Path) -> Path:
    """Its scene file: the same column and tank, height along y."""
    spacing, flat = options.spacing, options.depth == 0
    mesh = folder / "box.obj"
    mesh.write_text(BOX + "".join(f"f {face}\n" for face in FACES.split(",")), encoding="utf-8")
    depth = spacing if flat else options.depth
    length, height = options.tank
    scene = {
        "Configuration": {
            "pause": False,
            "sim2D": flat,
            "particleRadius": spacing / 2,
            "simulationMethod": WCSPH,
            "gravitation": [0, -9.81, 0],
            "cflMethod": 0,
            "timeStepSize": options.time_step,
            "boundaryHandlingMethod": AKINCI,
            "WCSPH": {"stiffness": options.stiffness, "exponent": 7},
        },
        "Materials": [
            {"id": "Fluid", "density0": 1000, "viscosityMethod": 1, "Standard viscosity": {"viscosity": 0.01}}
        ],
        "RigidBodies": [
            {
                "geometryFile": str(mesh),
                "translation": [length / 2, height / 2, depth / 2 if not flat else 0],
                "scale": [length, height, depth if not flat else 1.0],
                "isDynamic": False,
                "isWall": True,
                "mapInvert": True,
            }
        ],
        "FluidBlocks": [
            {
                "denseMode": 0,
                "start": [spacing / 2, spacing / 2, -1.0 if flat else spacing / 2],
                "end": [options.column[0] + spacing / 2, options.column[1] + spacing / 2, 1.0 if flat else depth],
            }
        ],
    }
    path = folder / "scene.json"
    path.write_text(json.dumps(scene), encoding="utf-8")
    return path


def measure(options) -> dict[str, Any]:
    """Seconds of a step: the median over blocks, after a first one that is not counted."""
    import pysplishsplash as splash  # pyright: ignore[reportMissingImports]

    clock: list[float] = []
    processor: list[float] = []
    steps = BLOCK + options.steps

    def after_step():
        clock.append(time.perf_counter())
        processor.append(time.process_time())

    with tempfile.TemporaryDirectory() as folder:
        base = splash.Exec.SimulatorBase()
        base.init(
            sceneFile=str(description(options, Path(folder))),
            outputDir=folder,
            useGui=False,
            initialPause=False,
            useCache=False,
            stopAt=(steps + 0.5) * options.time_step,
        )
        base.setTimeStepCB(after_step)
        base.initSimulation()
        base.runSimulation()
        model = splash.Simulation.getCurrent().getFluidModel(0)
        position = np.asarray(model.getFieldBuffer("position") if hasattr(model, "getFieldBuffer") else np.zeros(1))
        particles = int(model.numActiveParticles())
        base.cleanup()
    blocks = np.diff(clock[BLOCK - 1 :: BLOCK]) / BLOCK
    return {
        "seconds_per_step": statistics.median(blocks.tolist()),
        "particles": particles,
        "dtype": str(position.dtype),
        "cpu_per_wall": (processor[-1] - processor[BLOCK - 1]) / (clock[-1] - clock[BLOCK - 1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="time pySPlisHSPlasH's dam break")
    parser.add_argument("--spacing", type=float, required=True)
    parser.add_argument("--column", type=float, nargs=2, required=True, help="length and height [m]")
    parser.add_argument("--tank", type=float, nargs=2, required=True, help="length and height [m]")
    parser.add_argument("--depth", type=float, default=0.0, help="of column and tank [m]; 0 is 2D")
    parser.add_argument("--time-step", type=float, required=True)
    parser.add_argument("--stiffness", type=float, default=50000.0)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.write_text(json.dumps(measure(options)), encoding="utf-8")
    sys.stdout.flush()
    os._exit(0)  # its own end of the process waits for a window that was never opened


if __name__ == "__main__":
    main()
