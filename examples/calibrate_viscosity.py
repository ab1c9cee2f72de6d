"""A viscosity from velocities at points, with an error bar, and beside it what the solver's own viscosity does to it.

Three fits: of a Taylor-Green vortex to data of the solver itself (twin), of the same to the exact decay, and of the
start of a Poiseuille flow to its exact profiles. Each starts a factor 2 off.

    python examples/calibrate_viscosity.py --fits twin,analytic --particles 50 --out out --json out/viscosity.json
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

import inverse
import jaxsph as sph
from jaxsph.pytree import replace
from jaxsph.scenes.channel import poiseuille
from jaxsph.scenes.taylor_green import taylor_green

FITS = ("twin", "analytic", "poiseuille")
REYNOLDS = 100.0
HEIGHT, DENSITY, TOP_SPEED = 1e-3, 1000.0, 1.25e-5  # of the channel [m], [kg/m^3], [m/s]
DISORDER = 0.2  # of the vortices: see `vortices`
NAME = "water.viscosity"


@dataclass(frozen=True)
class Flow:
    """A flow whose exact velocity is known.

    exact: (viscosity [Pa s], points (P, 2) [m], time [s]) -> (P, 2) [m/s]. effective: a run at the true viscosity up to
    t_end -> the viscosity [Pa s] with which its particles move. components: of the velocity, that are measured.
    """

    name: str
    scene: sph.Scene
    points: np.ndarray
    times: np.ndarray
    t_end: float
    components: list[int]
    exact: Callable[[float, np.ndarray, float], np.ndarray]
    effective: Callable[[sph.Trajectory], float]

    @property
    def viscosity(self) -> float:
        """True viscosity [Pa s]."""
        return float(self.scene.get(NAME))

    def observe(self, run):
        """Velocities at the points, (T, P m) [m/s]."""
        seen = run.observe(
            lambda scene, state: sph.observe.interpolate(scene, state, "water", "velocity", self.points, order=1)
        )
        return seen[:, :, self.components].reshape(len(run.times), -1)

    def series(self, factor: float = 1.0):
        """The exact velocities at the points for a multiple of the true viscosity, as `observe` gives them."""
        exact = [self.exact(factor * self.viscosity, self.points, t)[:, self.components].ravel() for t in self.times]
        return np.array(exact)

    def observer_bias(self, carried) -> float:
        """By how much a fit to exact velocities misses the viscosity, relative to it, if it sees `carried` instead.

        To first order, by least squares, as `Fit.shift`; with the slope of the exact velocities, which has nothing of
        the disorder of the particles.
        """
        slope = (self.series(1.01) - self.series(0.99)) / 0.02
        return float(np.sum(slope * (self.series() - carried)) / np.sum(slope**2))

    def carried(self, run):
        """The run with the exact velocities on its particles: seen at the points, it has the observer's error alone."""
        fields = run["water"]
        position, old = np.asarray(fields["position"], float), np.asarray(fields["velocity"])
        velocity = [self.exact(self.viscosity, x, t) for x, t in zip(position, self.times, strict=True)]
        systems = {**run.states.systems, "water": {**fields, "velocity": np.array(velocity, old.dtype)}}
        return sph.Trajectory(run.scene, replace(run.states, systems=systems), run.time_step)


def vortices(particles: int = 25, t_end: float = 0.6, every: float = 0.01, dtype=None) -> Flow:
    """Taylor-Green vortices at Re 100 in the unit square, seen at 25 points from .1 s on.

    The particles start up to a fifth of a spacing off their lattice. Along the rows of a perfect one they flow until
    rounding breaks it, some time or other: runs of nearly equal viscosities part there, and the cost gets rough.
    """
    middle = (np.arange(5) + 0.5) / 5
    return Flow(
        "Taylor-Green",
        taylor_green(particles, reynolds=REYNOLDS, disorder=DISORDER, dtype=dtype),
        points=np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2),
        times=np.linspace(0.1, t_end, round((t_end - 0.1) / every) + 1),
        t_end=t_end,
        components=[0, 1],
        exact=lambda viscosity, x, t: np.exp(-8 * np.pi**2 * viscosity * t) * pattern(x),
        effective=decay,
    )


def pattern(x):
    """Velocity (N, 2) of the vortices at the start, at places (N, 2)."""
    x, y = 2 * np.pi * x.T
    return np.stack([-np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)], axis=1)


def decay(run) -> float:
    """Viscosity from the kinetic energy [Pa s], which falls like exp(-16 pi^2 nu t).

    By least squares from .1 s on, through the energy at the start, which the scene knows and does not fit: what is lost
    while the lattice breaks up counts.
    """
    times, speed = np.asarray(run.times, float), np.asarray(run["water"]["velocity"], float)
    energy, late = np.sum(speed**2, axis=(1, 2)), times > 0.099
    fallen = -np.log(energy / energy[0])[late]
    return float(np.sum(times[late] * fallen) / np.sum(times[late] ** 2) / (16 * np.pi**2))


def channel(particles: int = 20, t_end: float = 0.5, every: float = 0.02, dtype=None) -> Flow:
    """Poiseuille flow from rest between plates, seen at 19 points across the middle; the default of the scene."""
    scene = poiseuille(particles, height=HEIGHT, density=DENSITY, top_speed=TOP_SPEED, dtype=dtype)
    y = HEIGHT * np.arange(1, 20) / 20
    force = float(np.asarray(scene.gravity)[0])  # stays, whatever the viscosity

    def exact(viscosity, x, t):
        u = start_up(viscosity / DENSITY, force, HEIGHT, x[:, 1], t)
        return np.stack([u, np.zeros_like(u)], axis=1)

    def effective(run):
        """Viscosity from the profile in the end."""
        fields = run["water"]
        s = np.asarray(fields["position"][-1, :, 1], float) / HEIGHT
        shape = 4 * s * (1 - s)
        top = np.sum(shape * np.asarray(fields["velocity"][-1, :, 0], float)) / np.sum(shape**2)
        return float(DENSITY * force * HEIGHT**2 / (8 * top))

    return Flow(
        "Poiseuille",
        scene,
        points=np.stack([np.full_like(y, 0.5 * HEIGHT * max(10, particles // 2) / particles), y], axis=1),
        times=np.arange(1, round(t_end / every) + 1) * every,
        t_end=1.0,  # where exp(-pi^2 nu t / H^2), the last that is missing, is 5e-5
        components=[0],
        exact=exact,
        effective=effective,
    )


def start_up(nu, force, height, y, t, terms: int = 50):
    """Velocity [m/s] at heights y [m] of a channel at a time t [s] after a force per mass [m/s^2] set in.

    J. P. Morris, P. J. Fox, Y. Zhu (1997), J. Comput. Phys. 136, 214, eq. 21: the parabola less a series of sines,
    each with the decay of its own.
    """
    y = np.asarray(y, float)
    u = 0.5 * force / nu * y * (height - y)
    for n in range(1, 2 * terms, 2):
        amplitude = 4 * force * height**2 / (nu * np.pi**3 * n**3)
        u = u - amplitude * np.sin(np.pi * y * n / height) * np.exp(-((n * np.pi / height) ** 2) * nu * t)
    return u


def calibrate(flow: Flow, twin: bool, noise: float = 0.05, start: float = 2.0, seed: int = 0, progress: bool = True):
    """Fit the viscosity of a flow; the fit, and what is to be said of it.

    twin: data from the solver itself at the true viscosity; else the exact ones. noise: standard deviation of what is
    added, relative to the root mean square of the data. start: factor by which the first guess is off.
    """
    begin, true = time.perf_counter(), flow.viscosity
    every = flow.times[1] - flow.times[0]
    run = sph.simulate(flow.scene, flow.t_end, every)
    effective = flow.effective(run)
    seen = run.at(flow.times)
    simulated, exact = np.asarray(flow.observe(seen), float), flow.series()
    carried = np.asarray(flow.observe(flow.carried(seen)), float)
    data = inverse.Observations(flow.times, simulated if twin else exact, columns=names(flow))
    if noise:
        data = data.with_noise(absolute=noise * float(np.sqrt(np.mean(data.values**2))), seed=seed)
    # the upper bound sets the time step
    unknown = {NAME: inverse.log(true / 3, true * 3, start=start * true, unit="Pa s")}
    fit = inverse.fit(
        inverse.Problem(flow.scene, flow.observe, data, unknown, save_every=every),
        step_tolerance=1e-4,  # a hundredth of what is asked of the value
        progress=progress,
    )
    value = float(fit[NAME])
    summary = {
        "viscosity": value,
        "standard_error": fit.standard_errors[NAME],
        "true": true,
        "bias": value / true - 1,
        "numerical": effective / true - 1,
        # the fit takes as much off as the solver adds
        "from_numerical": 0.0 if twin else true / effective - 1,
        "from_observer": 0.0 if twin else flow.observer_bias(carried),
        "iterations": fit.iterations,
        "simulation_runs": fit.simulation_runs,
        "seconds": time.perf_counter() - begin,
        "fit_seconds": fit.seconds,
        "compile_seconds": fit.compile_seconds,
        "particles": flow.scene["water"].n_particles,
        "samples": int(data.values.size),
        "noise": noise,
        "twin": twin,
        "verdict": fit.verdict,
    }
    return fit, summary


def names(flow: Flow) -> list[str]:
    """Of the columns of the data."""
    return [f"{'uv'[i]}{point}" for point in range(len(flow.points)) for i in flow.components]


def report(flow: Flow, s: dict) -> str:
    """A few lines on a fit."""
    percent = lambda part: f"{100 * part:+.2f} %"  # noqa: E731
    lines = [
        f"{flow.name}, {s['particles']} particles, {'twin' if s['twin'] else 'exact'} data, "
        f"{s['samples']} velocities, noise {100 * s['noise']:g} %",
        f"  viscosity            {s['viscosity']:.5g} +- {s['standard_error']:.2g} Pa s, true {s['true']:.5g}: "
        f"{percent(s['bias'])} (+- {100 * s['standard_error'] / s['true']:.2f} %)",
        f"  numerical viscosity  {percent(s['numerical'])} of the true one: what the solver adds at this spacing",
    ]
    if s["twin"]:
        lines.append("                       the data have it as well, so it is not in the value")
    else:
        left = s["bias"] - s["from_numerical"] - s["from_observer"]
        lines.append(
            f"  of the {percent(s['bias'])}:  {percent(s['from_numerical'])} make up for it, "
            f"{percent(s['from_observer'])} come from the interpolation to the points, {percent(left)} are left"
        )
    lines.append(f"  {s['simulation_runs']} runs, {s['seconds']:.1f} s, {s['compile_seconds']:.1f} s of them compiling")
    return "\n".join(lines)


def main(
    fits=FITS,
    particles=None,
    precision="float32",
    noise=0.05,
    start=2.0,
    seed=0,
    t_end=0.6,
    progress=True,
    out="out",
    json_path=None,
):
    """Fit viscosities; write calibrate_viscosity.png into `out`, and a JSON summary. Returns {fit: summary}.

    fits: some of FITS. particles: along an edge, across the channel; None takes 25 and 20. precision: float32 or
    float64. noise: standard deviation of what is added to the data, relative to their root mean square. start: factor
    by which the first guess is off. t_end: of the vortices [s].
    """
    strange = [name for name in fits if name not in FITS]
    if strange:
        raise ValueError(f"no fit is called {strange[0]!r}; there are {', '.join(FITS)}")
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision {precision!r} must be float32 or float64")
    jax.config.update("jax_enable_x64", precision == "float64")
    done, summaries = [], {}
    for name in fits:
        if name == "poiseuille":
            flow = channel(particles or 20, dtype=precision)
        else:
            flow = vortices(particles or 25, t_end, dtype=precision)
        fit, summaries[name] = calibrate(flow, name == "twin", noise, start, seed, progress)
        summaries[name]["precision"] = precision
        done.append((flow, fit, summaries[name]))
        print(("\n" if progress else "") + report(flow, summaries[name]) + "\n", flush=True)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"picture {draw(folder / 'calibrate_viscosity.png', done)}")
    if json_path:
        Path(json_path).write_text(json.dumps(summaries, indent=2) + "\n")
    return summaries


def draw(path: Path, done: list) -> Path:
    """One panel per fit: the strength of the vortices over time, profiles of the channel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(done), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (flow, fit, summary) in zip(figure.subplots(1, len(done), squeeze=False)[0], done, strict=True):
        if flow.name == "Poiseuille":
            y = flow.points[:, 1] / HEIGHT
            for i, row in enumerate((0, 2, 5, len(flow.times) - 1)):
                axes.plot(fit.observed[row] / TOP_SPEED, y, ".", color=f"C{i}")
                axes.plot(fit.simulated[row] / TOP_SPEED, y, "-", color=f"C{i}", label=f"{flow.times[row]:.2g} s")
            axes.set(xlabel="velocity / top speed", ylabel="height / channel")
        else:
            base = pattern(flow.points).ravel()
            strength = lambda series, base=base: series @ base / np.sum(base**2)  # noqa: E731
            axes.plot(flow.times, strength(fit.observed), ".", color="C0", label="data")
            axes.plot(flow.times, strength(fit.simulated), "-", color="C1", label="fit")
            axes.plot(flow.times, strength(flow.series()), "--", color="0.4", label="exact, true viscosity")
            axes.set(xlabel="time [s]", ylabel="strength of the vortices")
        axes.legend(fontsize=8)
        kind = "twin" if summary["twin"] else "exact data"
        axes.set_title(
            f"{flow.name}, {kind}: {summary['viscosity']:.4g} +- {summary['standard_error']:.1g} Pa s, "
            f"true {summary['true']:.4g}",
            fontsize=9,
        )
    figure.savefig(path, dpi=150)
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fits", type=lambda text: text.split(","), default=FITS, help=f"some of {','.join(FITS)}")
    parser.add_argument("--particles", type=int, help="along an edge (25), across the channel (20)")
    parser.add_argument("--precision", default="float32", choices=("float32", "float64"))
    parser.add_argument("--noise", type=float, default=0.05, help="standard deviation added, of the data's rms (0.05)")
    parser.add_argument("--start", type=float, default=2.0, help="factor by which the first guess is off (2)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--t-end", type=float, default=0.6, help="how long the vortices are seen [s] (0.6)")
    parser.add_argument("--out", default="out", help="folder for results")
    parser.add_argument("--json", dest="json_path", help="file for the summary")
    main(**vars(parser.parse_args()))
