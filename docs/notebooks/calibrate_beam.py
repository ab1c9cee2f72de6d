# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Young's modulus of a beam, from the motion of its tip
#
# An elastic beam, .35 m long and .02 m thick, is clamped at its left end and swings under its own weight. The
# motion of its tip is known from finite elements (Turek & Hron 2006, case CSM3), which took $E = 1.4\cdot10^6$ Pa.
# We forget that number, begin a factor 3 off, and ask the motion for it.
#
# `make calibrate` does the same from the command line.

# %%
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import inverse
import jaxsph as sph

sys.path.insert(0, str(Path(globals().get("__file__", "x")).resolve().parents[2] / "examples"))
import calibrate_beam

# %% [markdown]
# ## In one call
#
# Five particles across the thickness, in float32. Each line is one run of the simulation, with its derivative.
# `fitted up to` is the time window: while the modulus is far off, later periods would point the wrong way.

# %%
out = Path("../../out")
summary = calibrate_beam.main(particles=5, out=out)

# %%
Image(out / "calibrate_beam.png", width=640)

# %% [markdown]
# The standard error holds what looks like noise in the residual, and nothing else. What five particles across the
# thickness get wrong is a bias on top of it. One run at half the spacing estimates it (page "The fit").
#
# ## The same by hand, with noise
#
# A scene says what is in the world. An observation says what was measured, and how well. We add noise
# of 5 % of the amplitude.

# %%
scene = sph.scenes.turek_hron_beam(5)
data = inverse.Observations.from_csv(
    calibrate_beam.DATA, time="t_s", columns=["ux_m", "uy_m"], window=(0.01, 0.9), every=2
).with_noise(relative=0.05, seed=0)


def tip(run):
    """Displacement of the tip, (T, 2) [m]."""
    return run.probe("beam", at=(0.35, 0.0)).displacement


modulus = inverse.log(1e6, 4.5e6, start=4.2e6, unit="Pa")
problem = inverse.Problem(scene, tip, data, {"beam.youngs_modulus": modulus})
fit = inverse.fit(problem)
print(fit)

# %% [markdown]
# The fit keeps every value that it tried. We run the first and the last one again, and draw them over the data.

# %%
figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
axes.plot(data.times, data.values[:, 1], ".", color="0.6", label="measured, with noise")
for value, label in ((4.2e6, "start"), (float(fit["beam.youngs_modulus"]), "fit")):
    run = sph.simulate(scene.replace({"beam.youngs_modulus": value}), t_end=0.9, save_every=0.01)
    axes.plot(run.times, tip(run)[:, 1], label=f"{label}, E = {value:.4g} Pa")
axes.set(xlabel="time [s]", ylabel="uy of the tip [m]")
_ = axes.legend()

# %% [markdown]
# Is the residual noise? Then it has no structure, and the reduced chi-square is near one.

# %%
figure, axes = plt.subplots(figsize=(8, 2.2), layout="constrained")
axes.plot(fit.times, fit.residuals, ".", label=fit.columns)
axes.axhline(0, color="0.6")
axes.set(xlabel="time [s]", ylabel="residual / noise")
_ = axes.legend()
print(f"reduced chi-square {fit.uncertainty.reduced_chi_square:.3f}")
print(f"lag-one autocorrelation {np.round(fit.uncertainty.lag_one, 2)}")

# %% [markdown]
# ## Asking for too much
#
# A bending tip knows $E/(1-\nu^2)$. Asked for Young's modulus $E$ and the Poisson ratio $\nu$ together, a fit should
# not just return two numbers. This one says that the data cannot tell them apart.

# %%
both = {
    "beam.youngs_modulus": inverse.log(7e5, 2.8e6, start=1.6e6, unit="Pa"),
    "beam.poisson_ratio": inverse.linear(0.2, 0.45, start=0.35),
}
asked = inverse.fit(inverse.Problem(scene, tip, data.select((0.01, 0.5)), both), step_tolerance=1e-2)
print(asked)

# %% [markdown]
# Which combination is known? $E/(1-\nu^2)$ of the fit, beside the true one:

# %%
e, nu = float(asked["beam.youngs_modulus"]), float(asked["beam.poisson_ratio"])
print(f"fit:  E = {e:.4g} Pa, Poisson ratio {nu:.3f}, E / (1 - nu^2) = {e / (1 - nu**2):.4g} Pa")
print(f"true: E = 1.4e+06 Pa, Poisson ratio 0.400, E / (1 - nu^2) = {1.4e6 / (1 - 0.4**2):.4g} Pa")

# %% [markdown]
# ## Stresses
#
# The fitted beam at its lowest point. Von Mises stress is largest at the clamp.

# %%
found = scene.replace({"beam.youngs_modulus": float(fit["beam.youngs_modulus"])})
run = sph.simulate(found, t_end=0.5, save_every=0.5)
stress = sph.observe.stresses(run.scene, run.final, "beam")["von_mises"]
place = np.asarray(run.positions("beam")[-1])
figure, axes = plt.subplots(figsize=(8, 2.8), layout="constrained")
points = axes.scatter(*place.T, c=np.asarray(stress) / 1e3, s=12)
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
_ = figure.colorbar(points, label="von Mises stress [kPa]")
