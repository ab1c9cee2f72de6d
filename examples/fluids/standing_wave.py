"""A wave swings in a tank half a length long, and viscosity takes its energy.

The amplitude of its mode, fitted over four periods, gives a frequency to compare with sqrt(g k tanh(k d)) of linear
theory, and a decay to compare with 2 nu k^2.

    python examples/fluids/standing_wave.py --particles 40
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np
from scipy.optimize import curve_fit

import jaxsph as sph
from jaxsph import plot

DEPTH, REYNOLDS, K = 1.0, 250.0, np.pi
FREQUENCY = np.sqrt(9.81 * K * np.tanh(K * DEPTH))  # rad/s


def main(particles=20, t_end=4.6, out=None, picture="out/standing_wave.png"):
    """Run the wave with `particles` over the depth to t_end [s]; return the run."""
    scene = sph.scenes.standing_wave(particles, reynolds=REYNOLDS, effects=[sph.DeltaDiffusion(0.1)])
    run = sph.simulate(scene, t_end, t_end / 160, progress=True, out=out)
    x, y = np.asarray(scene["water"].particles.positions, float).T
    mode = np.stack([-np.cosh(K * y) * np.sin(K * x), np.sinh(K * y) * np.cos(K * x)], axis=1)
    amplitude = np.sum(np.asarray(run["water"]["velocity"], float) * mode, axis=(1, 2))
    form = lambda t, size, w, rate, phase: size * np.exp(-rate * t) * np.cos(w * t + phase)  # noqa: E731
    times, start = np.asarray(run.times, float), (1.0, FREQUENCY, 0.1, 0.0)
    (_, frequency, rate, _), _ = curve_fit(form, times, amplitude / amplitude[0], start)
    decay = 2 * DEPTH * np.sqrt(9.81 * DEPTH) / REYNOLDS * K**2
    print(f"frequency {frequency:.3f} rad/s, theory {FREQUENCY:.3f}; decay {rate:.3f} 1/s, 2 nu k^2 = {decay:.3f}")
    draw(run, times, amplitude / amplitude[0], np.exp(-decay * times) * np.cos(FREQUENCY * times), picture)
    return run


def draw(run, times, found, known, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 3.6), layout="constrained", dpi=130)
    *panels, graph = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.5))
    period = 2 * np.pi / FREQUENCY
    plot.moments(run, np.minimum(period * np.array([0.25, 0.5, 0.75]), times[-1]), color="velocity", axes=panels)
    graph.plot(times, known, "k-", lw=1, label="linear theory")
    graph.plot(times[::2], found[::2], "o", ms=3, label="SPH")
    graph.set(xlabel="time [s]", ylabel="velocity of the mode / at the start")
    graph.legend(frameon=False)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="over the depth (20)")
    parser.add_argument("--t-end", type=float, default=4.6, help="[s] (4.6)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/standing_wave.png")
    main(**vars(parser.parse_args()))
