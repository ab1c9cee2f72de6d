"""Water behind a gate that is pulled up within .1 s: it leaves below the gate first, and drags along what is above.

Tank, column and motion of the gate are those of Liao, Hu and Sueyoshi (2015), whose elastic plate is left out. The
front is compared with that of a column that is free at once: the gate delays it.

    python examples/fluids/dam_break_gate.py --spacing 0.01
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import observe, plot


def main(spacing=0.0125, t_end=0.36, out=None, picture="out/dam_break_gate.png"):
    """Run the gate with particles at this spacing [m] to t_end [s]; return the run."""
    scene = sph.scenes.dam_break_gate(spacing)
    free = sph.Scene(
        *(system for system in scene.systems if system.name != "gate"),
        gravity=scene.gravity,
        effects=scene.effects,
        smoothing_length=scene.smoothing_length,
        domain=scene.domain,
    )
    runs, fronts = [], []
    for each, file in ((scene, out), (free, None)):
        runs.append(sph.simulate(each, t_end, t_end / 40, progress=True, out=file))
        front = runs[-1].observe(lambda scene, state: observe.surge_front(scene, state, "water"))
        fronts.append(np.maximum.accumulate(np.asarray(front, float)))
    run = runs[0]
    for x in (0.3, 0.5, 0.7):
        if fronts[0][-1] > x:
            late, early = (float(np.interp(x, front, run.times)) for front in fronts)
            print(f"front at {x} m after {late:.3f} s, without the gate {early:.3f} s")
    figure = plot.moments(run, t_end * np.array([0.125, 0.25, 0.5, 1]), color="velocity", columns=4)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--spacing", type=float, default=0.0125, help="[m], a divisor of 0.2 (0.0125)")
    parser.add_argument("--t-end", type=float, default=0.36, help="[s] (0.36)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/dam_break_gate.png")
    main(**vars(parser.parse_args()))
