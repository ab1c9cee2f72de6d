"""Two meters of water on an aluminium plate that is clamped at both sides: how far does it bend?

It begins to carry the water at t = 0 and swings about its static deflection, which finite elements give as -.0726 mm.

    python examples/fsi/water_column_on_plate.py --across 5
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import jaxsph as sph
from jaxsph import plot

STATIC = -7.262081221520517e-05  # m, finite elements (Q9, plane strain), in the middle of the plate


def main(across=5, t_end=0.3, out=None, animation=None, picture="out/water_column_on_plate.png"):
    """Run with this many particles over the thickness of the plate; return the run."""
    import matplotlib.pyplot as plt

    scene = sph.scenes.water_column_on_plate(across, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 120, progress=True, out=out)
    middle, times = np.asarray(run.probe("plate", (0.5, -0.025)).displacement[:, 1]), np.asarray(run.times)
    late = times > 0.5 * t_end
    print(f"mean deflection {middle[late].mean() * 1e3:.4f} mm, static {STATIC * 1e3:.4f} mm")
    figure = plt.figure(figsize=(10, 5), layout="constrained")
    parts: Any = figure.subfigures(1, 2, width_ratios=[1, 1.6])
    left, right = parts
    plot.moments(run, [t_end], axes=[left.subplots()])
    axes = right.subplots()
    axes.axhline(1e3 * STATIC, color="0.5", label="finite elements, static")
    axes.plot(times, 1e3 * middle, label=f"jaxsph, {across} across")
    axes.set(xlabel="time [s]", ylabel="deflection of the middle [mm]", xlim=(0, t_end))
    axes.legend(frameon=False)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    if animation:
        run.animate(animation)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--across", type=int, default=5, help="over the thickness of the plate (5)")
    parser.add_argument("--t-end", type=float, default=0.3, help="[s] (0.3)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/water_column_on_plate.png")
    main(**vars(parser.parse_args()))
