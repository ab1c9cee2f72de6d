"""What derivatives through a whole run cost: the Turek-Hron beam at 9 across, in forward runs."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
from measure import compiled, interleaved, row

import jaxsph

ACROSS = 9
STEPS, QUICK_STEPS = 5000, 200


def tip_after(steps: int, across: int, dtype: str):
    """The tip's final deflection [m] as a function of Young's modulus [Pa], and the modulus."""
    scene = jaxsph.scenes.turek_hron_beam(across, dtype=dtype)
    found = jaxsph.topologies(scene)
    time_step = jaxsph.stable_time_step(scene, found)
    modulus = scene.get("beam.youngs_modulus")

    def tip(youngs_modulus, mode="reverse"):
        run = jaxsph.simulate(
            scene.replace({"beam.youngs_modulus": youngs_modulus}),
            steps * time_step,
            time_step=time_step,
            topologies_of_scene=found,
            mode=mode,
        )
        return run.probe("beam", at=(0.35, 0.0)).displacement[-1, 1]

    return tip, jnp.asarray(modulus, dtype), scene.systems[0].n_particles


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """One forward-mode tangent and one reverse-mode gradient, in forward runs."""
    steps = QUICK_STEPS if quick else STEPS
    tip, modulus, particles = tip_after(steps, ACROSS, precision)

    def tangent(youngs_modulus):
        return jax.jvp(lambda e: tip(e, mode="forward"), (youngs_modulus,), (jnp.ones_like(youngs_modulus),))

    calls = {
        "forward run": compiled(tip, modulus),
        "forward-mode tangent": compiled(tangent, modulus),
        "reverse-mode gradient": compiled(jax.value_and_grad(tip), modulus),
    }
    derivatives = [float(calls[name][0]()[1]) for name in ("forward-mode tangent", "reverse-mode gradient")]
    print(f"beam of {particles:,} particles, {steps} steps, {precision}; d(tip)/dE: {derivatives}", flush=True)
    timings = interleaved(calls, budget=1.0 if quick else 30.0)
    made = []
    about = {"case": "beam, a whole run", "resolution": f"{ACROSS} across, {steps} steps", "precision": precision}
    for name, timing in timings.items():
        print(timing.line(name), flush=True)
        if name == "forward run":
            figure, value, unit = (
                "speed of a forward run",
                particles * steps / timing.seconds / 1e6,
                "M particle-steps/s",
            )
        else:
            figure, value, unit = f"{name} / forward run", timing.over(timings["forward run"]), "times"
        identity = f"modes.{name.replace(' ', '_')}.{precision}"
        made.append(row(identity, figure=figure, value=value, unit=unit, timing=timing, **about))
    yield made
