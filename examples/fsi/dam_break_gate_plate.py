"""A gate is pulled up, the water breaks against an elastic plate: the poster's scene.

The plate is that of the experiment of Liao, Hu and Sueyoshi (2015), 4 mm thick; `--thick` takes the one that
TrixiParticles.jl runs, ten times thicker and softer.

    python examples/fsi/dam_break_gate_plate.py --thick
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import plot

THICK: dict = {"thickness": 0.04, "youngs_modulus": 3.5e5, "place": 0.56}


def main(spacing=0.01, thick=False, t_end=0.6, out=None, animation=None, picture="out/dam_break_gate_plate.png"):
    """Run with water at this spacing [m] to t_end [s]; return the run."""
    scene = sph.scenes.dam_break_gate_plate(spacing, **(THICK if thick else {}), dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 60, progress=True, out=out)
    foot = THICK["place"] if thick else 0.6
    tip = np.asarray(run.probe("plate", (foot, 0.09)).displacement[:, 0])
    print(f"the tip gets {1e3 * tip.max():.1f} mm far, at {np.asarray(run.times)[tip.argmax()]:.3f} s")
    figure = plot.moments(run, t_end * np.array([0.2, 0.5, 0.75, 1]), columns=4)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    if animation:
        run.animate(animation)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--spacing", type=float, default=0.01, help="of the water [m], a divisor of 0.2 (0.01)")
    parser.add_argument("--thick", action="store_true", help="a plate of 40 mm and 0.35 MPa")
    parser.add_argument("--t-end", type=float, default=0.6, help="[s] (0.6)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/dam_break_gate_plate.png")
    main(**vars(parser.parse_args()))
