"""Young's modulus of a rubber gate from the water that bends it: a fit to an experiment.

C. Antoci, M. Gallati, S. Sibilla (2007) filmed the free end of the gate (examples/data). The rubber's modulus is not
agreed on: 12 MPa by their test of it, 7.8 MPa in use by others. The fit says what the simulation makes of it, whether
one modulus explains the motion, and what is left unexplained.

    python examples/calibrate_gate.py --particles 20 --json out/calibrate_gate.json
"""

import argparse
import csv
import json
from pathlib import Path

import jax
import numpy as np

import inverse
import jaxsph as sph

LITERATURE = (7.8e6, 12e6)  # Pa
TIP = (0.1025, 0.0)  # free end
DATA = Path(__file__).parent / "data" / "antoci_elastic_gate.csv"
NAME = "gate.youngs_modulus"


def main(
    particles=20,
    across=5,
    precision="float32",
    window=0.36,
    reading=0.5e-3,
    start=12e6,
    method="secant",
    progress=True,
    out="out",
    json_path=None,
):
    """Fit the modulus; write calibrate_gate.png, .h5 into `out`, and a JSON summary.

    particles: over the width of the water; across: over the thickness of the gate. precision: float32 or float64.
    window: of the record [s]. reading: standard deviation assumed of a measured point, one percent of the peak [m].
    start: first guess [Pa]. method: of `inverse.fit`; "gauss-newton" stops near the start, misled by its tangents.
    """
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision {precision!r} must be float32 or float64")
    jax.config.update("jax_enable_x64", precision == "float64")
    scene = sph.scenes.elastic_gate(particles, across)
    data = measured(window, reading)
    unknown = {NAME: inverse.log(3e6, 3e7, start=start, unit="Pa")}
    problem = inverse.Problem(scene, tip, data, unknown)
    print(f"{scene}\n{len(data)} measured points to {data.times[-1]:g} s")
    fit = inverse.fit(problem, method, progress=progress)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    fit.plot(folder / "calibrate_gate.png")
    fit.save(folder / "calibrate_gate.h5")
    print(f"\n{fit}\n")

    peak = float(np.max(np.abs(data.values)))
    simulated = jax.jit(lambda values: problem.model(values, "forward"))
    rms = {f"{modulus:.3g}": root_mean_square(simulated(np.array([modulus])), data) / peak for modulus in LITERATURE}
    found = {"youngs_modulus": float(fit[NAME]), "standard_error": fit.standard_errors[NAME]}
    found["rms_over_peak"] = root_mean_square(fit.simulated, data) / peak
    uncertainty = fit.uncertainty
    assert uncertainty is not None and uncertainty.chi_square_interval is not None, "the data have deviations"
    explained = uncertainty.reduced_chi_square <= uncertainty.chi_square_interval[1]
    print(f"Young's modulus {found['youngs_modulus']:.4g} +- {found['standard_error']:.2g} Pa")
    print(f"rms {100 * found['rms_over_peak']:.1f} % of the peak; with E of", end=" ")
    print(", ".join(f"{modulus} Pa {100 * value:.1f} %" for modulus, value in rms.items()))
    times = uncertainty.reduced_chi_square**0.5
    print(f"One modulus {'explains' if explained else 'does not explain'} the motion: what is left is", end=" ")
    print(f"{times:.2g} times the {1e3 * reading:g} mm that a measured point is taken to be off.")
    summary = found | {
        "rms_over_reading": times,
        "rms_over_peak_literature": rms,
        "explained": bool(explained),
        "reduced_chi_square": float(uncertainty.reduced_chi_square),
        "verdict": fit.verdict,
        "messages": list(fit.messages),
        "iterations": fit.iterations,
        "simulation_runs": fit.simulation_runs,
        "seconds": fit.seconds,
        "compile_seconds": fit.compile_seconds,
        "particles": particles,
        "across": across,
        "precision": precision,
        "window": window,
        "reading": reading,
    }
    if json_path:
        Path(json_path).write_text(json.dumps(summary, indent=2) + "\n")
    return summary


def tip(run):
    """Horizontal displacement of the free end (T,) [m]."""
    return run.probe("gate", at=TIP).displacement[:, 0]


def measured(window, reading):
    """The points of the experiment up to some time [s], with the error that they are taken to have [m]."""
    with DATA.open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["dataset"].startswith("Antoci")]
    lines = [line for line in lines if line["component"] == "ux"]
    times, values = (np.array([float(line[column]) for line in lines]) for column in ("t_s", "disp_m"))
    data = inverse.Observations(times, values, reading, columns=["ux"], source="Antoci 2007")
    return data.select((0.0, window))


def root_mean_square(simulated, data):
    """Of simulated minus measured [m]."""
    return float(np.sqrt(np.mean((np.asarray(simulated, float) - data.values) ** 2)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="over the width of the water (20)")
    parser.add_argument("--across", type=int, default=5, help="particles over the thickness of the gate (5)")
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--window", type=float, default=0.36, help="how much of the record to fit [s] (0.36)")
    parser.add_argument("--reading", type=float, default=0.5e-3, help="error assumed of a measured point [m] (5e-4)")
    parser.add_argument("--start", type=float, default=12e6, help="first guess [Pa] (12e6)")
    parser.add_argument("--method", default="secant", choices=("secant", "gauss-newton"), help="of the fit")
    parser.add_argument("--out", default="out", help="folder for results")
    parser.add_argument("--json", dest="json_path", help="file for the summary")
    main(**vars(parser.parse_args()))
