"""Young's modulus of the Turek-Hron beam from the motion of its tip, with an error bar.

The data are the finite-element tip trajectory of CSM3 (examples/data, source named there), made with
E = 1.4e6 Pa. The fit starts a factor 3 off and simulates the beam by total-Lagrangian SPH.

    python examples/calibrate_beam.py --particles 9 --noise 0.05 --out out --json out/calibrate_beam.json
    python examples/calibrate_beam.py --coarse 5,9 --particles 17      # the answer of 17, from fits at 5 and 9
"""

import argparse
import json
from pathlib import Path

import jax

import inverse
import jaxsph as sph

TRUE_MODULUS = 1.4e6  # Pa, with which the data were made
TIP = (0.35, 0.0)
DATA = Path(__file__).parent / "data" / "csm3_tip.csv"


def main(
    particles=5,
    precision="float32",
    noise=0.0,
    window=0.9,
    every=0.01,
    seed=0,
    start=3.0,
    bias_check=True,
    coarse=(),
    out="out",
    json_path=None,
):
    """Fit Young's modulus; write calibrate_beam.png, .h5 and beam.png into `out`, and a JSON summary.

    particles: across the thickness. precision: float32 or float64. noise: standard deviation of what is added
    to the data, relative to their amplitude. window: how much of the record [s]. every: interval of samples [s].
    start: factor by which the first guess is off. bias_check: estimate the bias of the resolution by one run at
    twice the resolution. coarse: particles across of coarser beams to fit instead of this one, whose answer is then
    extrapolated and confirmed (`inverse.coarse_to_fine`).
    """
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision {precision!r} must be float32 or float64")
    jax.config.update("jax_enable_x64", precision == "float64")
    data = inverse.Observations.from_csv(
        DATA, time="t_s", columns=["ux_m", "uy_m"], window=(every, window), every=round(every / 0.005)
    )
    if noise:
        data = data.with_noise(relative=noise, seed=seed)

    def problem_of(resolution):
        """Thickness over spacing is one less than the particles across."""
        return inverse.Problem(
            sph.scenes.turek_hron_beam(round(resolution) + 1),
            observe=lambda run: run.probe("beam", at=TIP).displacement,
            data=data,
            unknown={"beam.youngs_modulus": inverse.log(2e5, 6e6, start=start * TRUE_MODULUS, unit="Pa")},
        )

    problem = problem_of(particles - 1)
    print(f"{problem.scene}\n{len(data.times)} samples of the tip's ux, uy to {window:g} s, noise {noise:g}")
    if coarse:
        found = inverse.coarse_to_fine(problem_of, [n - 1 for n in (*coarse, particles)], progress=True)
        print(f"\n{found}")
        fit = found.fit
    else:
        fit = inverse.fit(problem, progress=True)
    modulus, error = float(fit["beam.youngs_modulus"]), fit.standard_errors["beam.youngs_modulus"]
    relative = modulus / TRUE_MODULUS - 1
    bias = discretization_bias(fit, particles, data.times) if bias_check else None

    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    picture = fit.plot(folder / "calibrate_beam.png")
    fit.save(folder / "calibrate_beam.h5")
    print(f"\n{fit}\n")
    print(f"Young's modulus {modulus:.5g} +- {error:.2g} Pa, true {TRUE_MODULUS:.5g} Pa: {100 * relative:+.2f} %")
    print("The standard error is that of the noise in the data.", end=" ")
    if bias is not None:
        print(f"The resolution adds an estimated bias of {bias:+.2g} Pa ({100 * bias / modulus:+.2f} %):")
        print(f"corrected for it {modulus - bias:.5g} Pa, {100 * ((modulus - bias) / TRUE_MODULUS - 1):+.2f} %")
    print(f"picture {picture}, data {folder / 'calibrate_beam.h5'}")
    summary = {
        "youngs_modulus": modulus,
        "standard_error": error,
        "relative_error": abs(relative),
        "iterations": fit.iterations,
        "simulation_runs": fit.simulation_runs,
        "discretization_bias": bias,
        "seconds": fit.seconds,
        "compile_seconds": fit.compile_seconds,
        "particles": particles,
        "precision": precision,
        "noise": noise,
        "window": window,
    }
    if json_path:
        Path(json_path).write_text(json.dumps(summary, indent=2) + "\n")
    return summary


def discretization_bias(fit, particles, times):
    """What the modulus found has too much because of the spacing [Pa]: from one run at half the spacing.

    The error is of second order in the spacing, so the change to half of it is three quarters of all of it.
    """
    fine = sph.scenes.turek_hron_beam(2 * particles - 1, youngs_modulus=float(fit["beam.youngs_modulus"]))
    run = sph.simulate(fine, t_end=times[-1], save_every=times[1] - times[0])
    return -4 / 3 * fit.shift(run.at(times).probe("beam", at=TIP).displacement)["beam.youngs_modulus"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=5, help="across the thickness (5)")
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation added, of the amplitude (0)")
    parser.add_argument("--window", type=float, default=0.9, help="how much of the record to fit [s] (0.9)")
    parser.add_argument("--every", type=float, default=0.01, help="interval of samples [s], a multiple of 0.005")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--start", type=float, default=3.0, help="factor by which the first guess is off (3)")
    parser.add_argument("--no-bias", dest="bias_check", action="store_false", help="no run at twice the resolution")
    parser.add_argument("--coarse", type=lambda text: [int(n) for n in text.split(",")], default=(), help="such as 5,9")
    parser.add_argument("--out", default="out", help="folder for results")
    parser.add_argument("--json", dest="json_path", help="file for the summary")
    main(**vars(parser.parse_args()))
