"""A dam breaks against an elastic plate, which bends, and the water runs over it.

The tip is compared with published codes (`examples/data/dambreak_elastic_plate_tip.csv`), in gray.

    python examples/fsi/dam_break_plate.py --particles 30
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

import jaxsph as sph
from jaxsph import plot

DATA = Path(__file__).parents[1] / "data/dambreak_elastic_plate_tip.csv"


def published():
    """Times [s] and displacements [m] of the tip by code."""
    curves = {}
    with DATA.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            curves.setdefault(row["dataset"], []).append((float(row["t_s"]), float(row["ux_tip_m"])))
    return {name: np.array(sorted(points)).T for name, points in curves.items()}


def main(particles=20, across=5, t_end=0.7, out=None, animation=None, picture="out/dam_break_plate.png"):
    """Run with this many particles over the width of the column; return the run."""
    import matplotlib.pyplot as plt

    scene = sph.scenes.dam_break_plate(particles, across, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 140, progress=True, out=out)
    tip = np.asarray(run.probe("plate", (0.292, 0.08)).displacement[:, 0])
    times = np.asarray(run.times)
    print(f"the tip begins to move (5 mm) at {times[np.argmax(tip > 0.005)]:.3f} s")
    print(f"and gets furthest, {tip.max() * 1e3:.1f} mm, at {times[tip.argmax()]:.3f} s")
    figure = plt.figure(figsize=(10, 5.4), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[1, 1.1])
    above, below = parts
    panels = above.subplots(1, 4, sharey=True)
    plot.moments(run, t_end * np.array([0.2, 0.35, 0.6, 1.0]), axes=panels)
    axes = below.subplots()
    for name, (when, where) in published().items():
        axes.plot(when, 1e3 * where, color="0.7", lw=1, label="published codes" if "Idelsohn" in name else None)
    axes.plot(times, 1e3 * tip, color="C0", label=f"jaxsph, {particles} particles over the column's width")
    axes.set(xlabel="time [s]", ylabel="displacement of the tip [mm]", xlim=(0, t_end))
    axes.legend(frameon=False)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    if animation:
        run.animate(animation)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="over the width of the column (20)")
    parser.add_argument("--across", type=int, default=5, help="over the thickness of the plate (5)")
    parser.add_argument("--t-end", type=float, default=0.7, help="[s] (0.7)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/dam_break_plate.png")
    main(**vars(parser.parse_args()))
