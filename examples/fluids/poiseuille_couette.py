"""Flow between two plates that starts from rest: driven by a force (Poiseuille), or by the upper plate (Couette).

The velocity of every particle is compared with the exact series; at the end it is almost the steady profile.

    python examples/fluids/poiseuille_couette.py --particles 40
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np

import jaxsph as sph

HEIGHT, TOP, NU = 1e-3, 1.25e-5, 1e-6  # m, m/s, m^2/s: those of Morris et al. (1997)
ACROSS = np.linspace(0, HEIGHT, 200)


def exact(flow, y, time):
    n, s = np.arange(1, 200)[:, None], y / HEIGHT
    decay = np.exp(-NU * (n * np.pi / HEIGHT) ** 2 * time)
    if flow == "couette":
        return TOP * (s + np.sum(2 / (n * np.pi) * (-1.0) ** n * np.sin(n * np.pi * s) * decay, axis=0))
    return TOP * (4 * s * (1 - s) - np.sum((n % 2) * 32 / (n * np.pi) ** 3 * np.sin(n * np.pi * s) * decay, axis=0))


def main(particles=20, t_end=0.8, out=None, picture="out/poiseuille_couette.png"):
    """Run both flows with `particles` across to t_end [s]; return the runs by name."""
    runs = {}
    for flow in ("poiseuille", "couette"):
        scene = getattr(sph.scenes, flow)(particles, height=HEIGHT, viscosity=1000 * NU, top_speed=TOP)
        run = runs[flow] = sph.simulate(scene, t_end, t_end / 40, progress=True, out=out and out.format(flow))
        moments = zip(run["water"]["position"][..., 1], run["water"]["velocity"][..., 0], run.times, strict=True)
        errors = [np.max(np.abs(u - exact(flow, np.asarray(y), float(t)))) / TOP for y, u, t in moments]
        print(f"{flow}: largest error / top speed {max(errors[1:]):.4f}, at the end {errors[-1]:.4f}")
    figure = matplotlib.figure.Figure((10, 4), dpi=130, layout="constrained")
    for axes, (flow, run) in zip(figure.subplots(1, 2), runs.items(), strict=True):
        for color, index in enumerate((1, 4, 10, 40)):
            time = float(run.times[index])
            axes.plot(1e6 * exact(flow, ACROSS, time), 1e3 * ACROSS, "k-", lw=1, label=None if color else "exact")
            u, y = 1e6 * run["water"]["velocity"][index, :, 0], 1e3 * run["water"]["position"][index, :, 1]
            axes.plot(u, y, "o", ms=4, color=f"C{color}", label=f"t = {time:g} s")
        axes.set(title=flow.capitalize(), xlabel="velocity [µm/s]", ylabel="y [mm]")
    axes.legend(frameon=False, loc="lower right")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    return runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="across the channel (20)")
    parser.add_argument("--t-end", type=float, default=0.8, help="[s] (0.8)")
    parser.add_argument("--out", help="VTKHDF file to write, with {} for the flow")
    parser.add_argument("--picture", default="out/poiseuille_couette.png")
    main(**vars(parser.parse_args()))
