"""Water with a surface: at rest, and as a breaking dam, whose front and whose pressure on the far wall are judged."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from cases import Case, Peer, studied
from reference import table  # pyright: ignore

import jaxsph
from jaxsph.accuracy import Results, Study, grid
from jaxsph.geometry import tank
from jaxsph.pytree import replace

GRAVITY = 9.81


def still_water(quick: bool) -> Results:
    height, density = 0.9, 1000.0
    unit, speed = np.sqrt(height / GRAVITY), np.sqrt(GRAVITY * height)

    def error_of(run):
        found = np.asarray(jaxsph.observe.pressure(run.scene, run.final, "water"), float)
        position, velocity = (np.asarray(run["water"][name][-1], float) for name in ("position", "velocity"))
        exact = density * GRAVITY * (height - position[:, 1])
        fastest = float(np.max(np.linalg.norm(velocity, axis=1))) / speed
        return {"pressure": float(np.linalg.norm(found - exact) / np.linalg.norm(exact)), "speed": fastest}

    def scene_of(particles=20, diffusion="delta"):
        other = [jaxsph.DensityDiffusion(0.1), jaxsph.ArtificialViscosity(0.02)]
        effects = None if diffusion == "delta" else other
        return jaxsph.scenes.still_water(particles, height=height, effects=effects)

    study = Study(scene_of, 10 * unit, unit, error_of=error_of, title="Still water, to t = 10 sqrt(H/g)")
    two = {"particles": (10, 20), "precision": ("float32",)}
    settings = [
        *grid(precision=["float32"], particles=(10, 14, 20, 28, 40)),
        *grid(precision=["float64"], particles=(10, 20)),
        *grid(**two, step_fraction=(0.45,)),
        *grid(**two, neighbors=(28,)),
        *grid(**two, diffusion=("Molteni-Colagrossi",)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(10, 14)))


def still_water_of_peer(arrays) -> dict[str, float]:
    height, density, gravity = 0.9, 1000.0, 1.0
    exact = density * gravity * (height - arrays["y"][-1])
    error = float(np.linalg.norm(arrays["p"][-1] - exact) / np.linalg.norm(exact))
    fastest = float(np.max(np.hypot(arrays["u"][-1], arrays["v"][-1]))) / np.sqrt(gravity * height)
    return {"pressure": error, "speed": fastest}


def front_error(times, front) -> float:
    """Mean over the experiment's moments 1 < T < 2.5 of the relative error of the front Z = x / a."""
    lines = [line for line in table("fluid/dambreak_front.csv") if line["dataset"].endswith("2.25in")]
    at, place = (np.array([float(line[key]) for line in lines]) for key in ("T=t*sqrt(2g/a)", "Z=x/a"))
    inside = (at > 1) & (at < 2.5)
    return float(np.mean(np.abs(np.interp(at[inside], times, front) / place[inside] - 1)))


def dam_break_front(quick: bool) -> Results:
    """Of Martin and Moyce's column of height 2 a, T = t sqrt(2 g / a)."""
    a = 0.05715
    unit = np.sqrt(a / (2 * GRAVITY))
    see = jax.jit(jax.vmap(lambda scene, s: jaxsph.observe.surge_front(scene, s, "water"), (None, 0)))

    def front_of(run):
        return np.asarray(see(run.scene, run.states), float) / a

    def scene_of(particles=20, alpha=0.02):
        effects = [jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(alpha)]
        return jaxsph.scenes.dam_break(
            particles, height=2 * a, width=a, tank_length=4 * a, tank_height=3 * a, effects=effects
        )

    finest = 28 if quick else 80
    start = Study(scene_of, 2.5 * unit, 0.05 * unit, observe=front_of)
    _, finer = start.measure({"particles": finest, "precision": "float32"})

    def error_of(run):
        front, times = front_of(run), np.asarray(run.times, float) / unit
        late = times > 1
        own = float(np.mean(np.abs(front[late] / finer[late] - 1)))
        return {"experiment": front_error(times, front), "finest": own}

    title = "Dam break, surge front, 1 < T < 2.5"
    study = Study(scene_of, 2.5 * unit, 0.05 * unit, error_of=error_of, title=title)
    two = {"particles": (20, 40), "precision": ("float32",)}
    settings = [
        *grid(precision=["float32"], particles=(10, 14, 20, 28, 40, 56)),
        *grid(precision=["float64"], particles=(20, 40)),
        *grid(**two, step_fraction=(0.45,)),
        *grid(**two, neighbors=(28,)),
        *grid(**two, alpha=(0.1,)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(10, 14)))


def front_of_peer(arrays) -> dict[str, float]:
    front = 1 + np.array([np.max(x) for x in arrays["x"]])
    start = float(np.max(arrays["x_start"]))
    return {"experiment": front_error(arrays["times"] * np.sqrt(2 * GRAVITY), front - start), "finest": float("nan")}


def front_of_splash(arrays) -> dict[str, float]:
    """Its column begins with the first particle a spacing off the wall, as PySPH's; it saves the front itself."""
    front = 1 + arrays["front"] - arrays["front"][0]
    return {"experiment": front_error(arrays["times"] * np.sqrt(2 * GRAVITY), front), "finest": float("nan")}


PLACES, WIDE = {"P1": 0.01, "P2": 0.05}, 0.014
"""Centers of the sensors over the floor, and their width, in heights of the column."""


def pressure_errors(times, found) -> dict[str, float]:
    """Rms error over 2.36 < T < 7 of pressures (n, 2) in rho g H."""
    errors, inside = {}, (times > 2.36) & (times < 7)
    for index, name in enumerate(PLACES):
        lines = [line for line in table("fluid/dambreak_pressure.csv") if line["dataset"].endswith(f"sim_{name}")]
        at, value = (np.array([float(line[key]) for line in lines]) for key in ("T", "p_over_rho_g_H"))
        difference = found[inside, index] - np.interp(times[inside], at, value)
        errors[name] = float(np.sqrt(np.mean(difference**2)))
    return errors


def dam_break_pressure(quick: bool) -> Results:
    """On the far wall .01 H and .05 H over the floor, by sensors .014 H wide, as in row F17 of the validation."""
    height = 0.6
    unit, scale = np.sqrt(height / GRAVITY), 1000 * GRAVITY * height

    def error_of(run):
        spacing = run.scene.spacing
        far = round(3.2196 / spacing) * spacing
        points = np.array([[far, place * height] for place in PLACES.values()])
        sensor = partial(
            jaxsph.observe.wall_pressure, wall_name="tank", points=points, width=WIDE * height, normal=(-1.0, 0.0)
        )
        found = np.asarray(run.observe(lambda scene, state: sensor(scene, state)), float) / scale
        return pressure_errors(np.asarray(run.times, float) / unit, found)

    def scene_of(particles=20, alpha=0.02, damper=0.0):
        effects = [jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(alpha)]
        effects += [jaxsph.AcousticDamper(damper)] if damper else []
        return jaxsph.scenes.dam_break(particles, height=height, effects=effects)

    title = "Dam break, pressure on the far wall, 2.36 < T < 7"
    study = Study(scene_of, 7 * unit, unit / 50, error_of=error_of, title=title)
    settings = [
        *grid(precision=["float32"], particles=(10, 14, 20, 28, 40)),
        *grid(precision=["float64"], particles=(20,)),
        *grid(precision=["float32"], particles=(14, 20), neighbors=(28,)),
        *grid(precision=["float32"], particles=(14, 20), alpha=(0.1,)),
        *grid(precision=["float32"], particles=(10, 14, 20, 28, 40), damper=(1.0,)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(8,)))


def pressure_of_peer(arrays) -> dict[str, float]:
    """By our own sensors: a scene of its particles, of water so stiff that pressures leave the volumes as they are."""
    height, stiff, half = 2.0, 1e5, float(arrays["floor"])  # its walls begin half a spacing before their face
    spacing, length = 2 * half, float(arrays["face"]) - half
    places = np.stack([arrays["x"], arrays["y"]], axis=2) - half
    particles = jaxsph.Particles(places[0], np.full(places.shape[1], spacing**2), spacing)
    water = jaxsph.Fluid("water", particles, 1000.0, stiff)
    walls = jaxsph.Wall("tank", tank((0, 0), (length, 3 * height), spacing, 4, dtype=np.float64))
    scene = jaxsph.Scene(water, walls, gravity=(0.0, -GRAVITY), smoothing_length=float(arrays["h"]))
    points = np.array([[length, place * height] for place in PLACES.values()])
    start = jaxsph.initial_state(scene)

    @jax.jit
    def read(place, pressure):
        fields = {**start.systems["water"], "position": place, "density_deviation": pressure / stiff**2}
        state = replace(start, systems={**start.systems, "water": fields})
        return jaxsph.observe.wall_pressure(scene, state, "tank", points, width=WIDE * height, normal=(-1.0, 0.0))

    found = np.array([read(place, pressure) for place, pressure in zip(places, arrays["p"], strict=True)])
    return pressure_errors(arrays["times"] * np.sqrt(GRAVITY / height), found / (1000.0 * GRAVITY * height))


CASES = [
    Case(
        "still_water",
        "Still water",
        {"pressure": "relative L2 error of the pressure", "speed": "largest speed / sqrt(g H)"},
        still_water,
        (0.02, 0.01),
        peers=(Peer("still_water", (10, 20, 40), still_water_of_peer),),
    ),
    Case(
        "dam_break_front",
        "Dam break, front",
        {
            "experiment": "mean relative error of the front, beside the experiment",
            "finest": "mean relative error of the front, beside H / dx = 80",
        },
        dam_break_front,
        (0.2, 0.1),
        peers=(
            Peer("dam_break", (20, 40, 60), front_of_peer),
            Peer("dam_break", (20, 40, 80), front_of_splash, "pysplishsplash"),
        ),
    ),
    Case(
        "dam_break_pressure",
        "Dam break, pressure",
        {"P1": "rms error of P1 / (rho g H)", "P2": "rms error of P2 / (rho g H)"},
        dam_break_pressure,
        (0.3, 0.2),
        peers=(Peer("dam_break_pressure", (10, 20, 40), pressure_of_peer),),
    ),
]  # fmt: skip
