"""Water flows out below a rubber gate that is clamped at its top: Antoci's experiment.

The free end is compared with what Antoci, Gallati and Sibilla (2007) measured: `examples/data/antoci_elastic_gate.csv`.

    python examples/fsi/elastic_gate.py --youngs-modulus 12e6
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

import jaxsph as sph
from jaxsph import plot

DATA = Path(__file__).parents[1] / "data/antoci_elastic_gate.csv"


def measured():
    """Times [s] and horizontal displacements [m] of the free end."""
    with DATA.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["dataset"] == "Antoci2007_experiment"]
    return np.array([(float(r["t_s"]), float(r["disp_m"])) for r in rows if r["component"] == "ux"]).T


def main(
    particles=40, across=5, youngs_modulus=7.8e6, t_end=0.4, out=None, animation=None,
    picture="out/elastic_gate.png",
):  # fmt: skip
    """Run with this many particles over the width of the water; return the run."""
    import matplotlib.pyplot as plt

    scene = sph.scenes.elastic_gate(particles, across, youngs_modulus=youngs_modulus, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 80, progress=True, out=out)
    end, times = np.asarray(run.probe("gate", (0.1025, 0.0)).displacement), np.asarray(run.times)
    when, where = measured()
    seen = when <= t_end
    if seen.any():
        difference = np.interp(when[seen], times, end[:, 0]) - where[seen]
        print(f"rms of ux - measured: {np.sqrt(np.mean(difference**2)) / where.max():.1%} of the largest ux")
    figure = plt.figure(figsize=(10, 5.4), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[1, 1.1])
    above, below = parts
    panels = above.subplots(1, 4, sharey=True)
    plot.moments(run, t_end * np.array([0.1, 0.3, 0.6, 1.0]), axes=panels)
    for panel in panels:
        panel.set(xlim=(-0.02, 0.26), ylim=(-0.02, 0.18))  # what falls off the floor is far away
    axes = below.subplots()
    for k, component in enumerate(("ux", "uy")):
        axes.plot(times, 1e3 * end[:, k], color=f"C{k}", label=f"jaxsph, {component}")
    axes.plot(when, 1e3 * where, "o", color="C0", label="measured, ux")
    top = 1.4e3 * max(np.max(end), np.max(where))  # room for the legend
    axes.set(xlabel="time [s]", ylabel="displacement of the free end [mm]", xlim=(0, t_end), ylim=(0, top))
    axes.legend(frameon=False, ncols=3)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    if animation:
        run.animate(animation)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=40, help="over the width of the water (40)")
    parser.add_argument("--across", type=int, default=5, help="over the thickness of the gate (5)")
    parser.add_argument("--youngs-modulus", type=float, default=7.8e6, help="[Pa] (7.8e6)")
    parser.add_argument("--t-end", type=float, default=0.4, help="[s] (0.4)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/elastic_gate.png")
    main(**vars(parser.parse_args()))
