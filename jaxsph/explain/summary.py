"""What a scene says of itself before it runs: its time step, lists, memory, and a few numbers."""

from __future__ import annotations

import math

import jax
import numpy as np

from jaxsph.contact import TOUCHING, bodies
from jaxsph.explain.arrangement import neighbors
from jaxsph.explain.facts import facts_of
from jaxsph.state import initial_state
from jaxsph.surroundings import CAPACITY_MULTIPLIER, SKIN, pairs_of


def summary(scene) -> list[str]:
    """Lines about a scene whose numbers are known. Nothing is compiled, so that the numbers are close, not exact."""
    facts, lines = facts_of(scene), []
    steps = [f"{name} {step:.3g} s" for name, step in facts.steps.items()]
    lines.append("largest stable steps, about: " + ", ".join(steps))
    state = jax.eval_shape(lambda: initial_state(scene)).systems
    kept = sum(leaf.size * np.dtype(leaf.dtype).itemsize for leaf in jax.tree.leaves(state))
    memory = f"{_bytes(kept)} of state"
    if scene.fluids:
        mean, most = facts.neighbors
        slots = math.ceil(CAPACITY_MULTIPLIER * neighbors(scene, 1 + SKIN[scene.dimension])[1])
        lists = pairs_of(scene)
        size = {system.name: system.n_particles for system in scene.systems}
        size[TOUCHING] = sum(body.n_particles for body in bodies(scene))
        held = sum(4 * slots * (size[a] + (0 if a == b else size[b])) for a, b in lists)
        lines.append(
            f"lists {', '.join('-'.join(pair) for pair in lists)}: "
            f"{mean:.3g} neighbors, at most {most}, room for {slots}"
        )
        memory += f", {_bytes(held)} of lists"
    lines.append(f"memory, about: {memory}")
    if scene.fluids and facts.speed:
        reynolds = f"Re {facts.reynolds:.3g}, " if facts.viscosity else "inviscid, "
        lines.append(
            f"{reynolds}Ma {facts.mach:.2g}, {facts.length / scene.spacing:.3g} particles over "
            f"L = {facts.length:.3g} m, U = {facts.speed:.3g} m/s ({facts.speed_from}); more by scene.explain()"
        )
    for name, count in facts.across.items():
        lines.append(f"{name} is {count} particles across")
    return lines


def _bytes(size: float | int) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"
