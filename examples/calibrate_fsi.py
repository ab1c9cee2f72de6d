"""Young's modulus of a plate from the motion of its tip in a dam break, with an error bar.

Water breaks against an elastic plate (`sph.scenes.dam_break_plate`, E = 1e6 Pa). The fits, each started a factor off:
"twin" to the simulation's own tip with noise, "Idelsohn2008" and "Meduri2018" to curves that others computed by finite
elements (examples/data, sources named there), "joint" to a twin of viscous water, for viscosity and modulus together.
The tip alone ("joint_tip") does not tell them apart, less of both looks alike: "joint" also sees the water's front.

    python examples/calibrate_fsi.py --fits twin Idelsohn2008 Meduri2018 --json out/calibrate_fsi.json
"""

import argparse
import csv
import json
import resource
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import inverse
import jaxsph as sph

TRUE_MODULUS, TRUE_VISCOSITY = 1e6, 5.0  # Pa; Pa s, of "joint" and "joint_tip": the solver's own is that of some tenths
PLATE = 0.292  # left face [m]
TIP = (PLATE, 0.08)  # upper left corner
DATA = Path(__file__).parent / "data" / "dambreak_elastic_plate_tip.csv"
FITS = ("twin", "Idelsohn2008", "Meduri2018", "joint", "joint_tip")
MODULUS, VISCOSITY = "plate.youngs_modulus", "water.viscosity"


def main(
    fits=("twin",),
    particles=20,
    across=5,
    precision="float32",
    noise=0.05,
    window=0.3,
    every=0.0025,
    seed=0,
    start=3.0,
    method="secant",
    growth=False,
    progress=True,
    out="out",
    json_path=None,
):
    """Run fits; write calibrate_fsi_<fit>.png and .h5 into `out`, and a JSON summary.

    fits: some of FITS. particles: over the width of the column; across: over the thickness of the plate. precision:
    float32 or float64. noise: of the twins, standard deviation relative to the amplitude. window: of the record [s]; a
    little more than the peak, after it the splash is chaotic. every: interval of samples of the twins [s]. start:
    factor by which the first guess is off. method: of `inverse.fit`; tangents lead nowhere once water has splashed
    ("gauss-newton"), slopes over a fifth of the modulus follow the trend ("secant"). growth: measure how far the
    gradient can be trusted, before the fit.
    """
    unknown_fits = set(fits) - set(FITS)
    if unknown_fits:
        raise ValueError(f"no fit is called {', '.join(sorted(unknown_fits))}; there are {', '.join(FITS)}")
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision {precision!r} must be float32 or float64")
    jax.config.update("jax_enable_x64", precision == "float64")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    summary = {}
    for name in fits:
        problem = problem_of(name, particles, across, noise, window, every, seed, start)
        seen = " and ".join(problem.data.columns)
        print(f"\n{name}: {len(problem.data)} samples of {seen} to {problem.data.times[-1]:g} s")
        reach = inverse.tangent_growth(problem, difference_step=1e-2) if growth else None
        if reach is not None:
            print(reach)
            reach.plot(folder / f"tangent_growth_{name}.png")
        fit = inverse.fit(problem, method, progress=progress)
        fit.plot(folder / f"calibrate_fsi_{name}.png")
        fit.save(folder / f"calibrate_fsi_{name}.h5")
        print(f"\n{fit}\n")
        summary[name] = about(fit, reach) | {"particles": particles, "across": across, "precision": precision}
        modulus = summary[name]["youngs_modulus"]
        error = summary[name]["standard_error"]
        print(f"Young's modulus {modulus:.5g} +- {error:.2g} Pa: {100 * (modulus / TRUE_MODULUS - 1):+.2f} %")
    if json_path:
        Path(json_path).write_text(json.dumps(summary, indent=2) + "\n")
    return summary


def problem_of(name, particles, across, noise, window, every, seed, start):
    """The problem of one of FITS."""
    joint = name.startswith("joint")
    scene = sph.scenes.dam_break_plate(particles, across, viscosity=TRUE_VISCOSITY if joint else None)
    unknown = {MODULUS: inverse.log(2e5, 5e6, start=start * TRUE_MODULUS, unit="Pa")}
    if joint:
        unknown[VISCOSITY] = inverse.log(0.5, 50.0, start=TRUE_VISCOSITY / start, unit="Pa s")
    if joint or name == "twin":
        times = every * np.arange(1, round(window / every) + 1)
        run = sph.simulate(scene, times[-1], every)
        observe, columns = (tip_and_front, ["ux", "front"]) if name == "joint" else (tip, ["ux"])
        data = inverse.Observations(times, np.asarray(observe(run), float)[1:], columns=columns)
        data = data.with_noise(relative=noise, seed=seed)
    else:
        observe, data = tip, published(name, window)
    return inverse.Problem(scene, observe, data, unknown)


def tip(run):
    """Horizontal displacement of the tip (T,) [m]."""
    return run.probe("plate", at=TIP).displacement[:, 0]


def tip_and_front(run):
    """Beside the tip the front of the water, until it has reached the plate (T, 2) [m]."""
    front = run.observe(lambda scene, state: sph.observe.surge_front(scene, state, "water"))
    return jnp.stack([tip(run), jnp.minimum(front, PLATE)], axis=1)


def published(name, window):
    """A curve of DATA up to some time [s]; how far it is off is not stated."""
    with DATA.open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["dataset"].startswith(name)]
    times, values = (np.array([float(line[column]) for line in lines]) for column in ("t_s", "ux_tip_m"))
    return inverse.Observations(times, values, columns=["ux"], source=name).select((0.0, window))


def about(fit, reach):
    """What is to be kept of a fit."""
    values = {"youngs_modulus": float(fit[MODULUS]), "standard_error": fit.standard_errors[MODULUS]}
    if VISCOSITY in fit.values:
        values |= {"viscosity": float(fit[VISCOSITY]), "standard_error_viscosity": fit.standard_errors[VISCOSITY]}
        values["correlation"] = float(fit.uncertainty.correlation[0, 1])
    if reach is not None:
        values |= {
            "growth_rate": float(reach.rate[0]),
            "horizon": float(reach.horizon()[0]),
            "agrees_until": float(reach.agrees_until()[0]),
        }
    simulated, observed = (np.reshape(series, (len(fit.times), -1))[:, 0] for series in (fit.simulated, fit.observed))
    misfit = float(np.sqrt(np.mean((simulated - observed) ** 2)))
    return values | {
        "relative_error": abs(values["youngs_modulus"] / TRUE_MODULUS - 1),
        "rms_over_peak": misfit / float(np.max(np.abs(observed))),
        "verdict": fit.verdict,
        "messages": list(fit.messages),
        "converged": fit.converged,
        "iterations": fit.iterations,
        "simulation_runs": fit.simulation_runs,
        "seconds": fit.seconds,
        "compile_seconds": fit.compile_seconds,
        "peak_memory_MiB": peak_memory(),
        "samples": len(fit.times),
    }


def peak_memory():
    """Largest resident memory of this process so far [MiB]: compiler and libraries included."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fits", nargs="+", default=["twin"], choices=FITS)
    parser.add_argument("--particles", type=int, default=20, help="over the width of the column (20)")
    parser.add_argument("--across", type=int, default=5, help="particles over the thickness of the plate (5)")
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--noise", type=float, default=0.05, help="of the twins, of the amplitude (0.05)")
    parser.add_argument("--window", type=float, default=0.3, help="how much of the record to fit [s] (0.3)")
    parser.add_argument("--every", type=float, default=0.0025, help="interval of samples of the twins [s] (0.0025)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--start", type=float, default=3.0, help="factor by which the first guess is off (3)")
    parser.add_argument("--method", default="secant", choices=("secant", "gauss-newton"), help="of the fit")
    parser.add_argument("--growth", action="store_true", help="measure how far the gradient can be trusted")
    parser.add_argument("--out", default="out", help="folder for results")
    parser.add_argument("--json", dest="json_path", help="file for the summary")
    main(**vars(parser.parse_args()))
