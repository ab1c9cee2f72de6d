"""H14: whether the documented limit of a structure's time step is real: stable below, unstable and refused above.

For fluids see F35 of the validations.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from any_step import any_step
from columns import STRONG, gripped
from rows import Case, Row, precision

import jaxsph
from jaxsph.geometry import box
from jaxsph.stable_step import SAFETY

FACTORS = (0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.6)
GAIN = 0.01  # of the largest kinetic energy: beyond the limit that is gained in a few steps
SAVES = 10


def bodies(dtype) -> dict[str, tuple[jaxsph.Scene, float]]:
    """Scenes without fluids by name, and for how long they run [s]."""
    block = jaxsph.Structure(
        "block",
        box((0, 0, 0), (1.0, 1.0, 1.0), 0.2, dtype=dtype),
        density=1000.0,
        youngs_modulus=1e6,
        poisson_ratio=0.3,
        clamped=lambda x: x[:, 2] < 0.2,
        law=jaxsph.NeoHookean(),
    )
    return {
        "beam, 5 across": (jaxsph.scenes.turek_hron_beam(5, dtype=dtype), 0.4),
        "sheared block": (jaxsph.Scene(block, gravity=(20.0, 0.0, -20.0), effects=[jaxsph.PenaltyForce(0.05)]), 0.4),
        "column to 4 lengths": (gripped(4, dtype, 3.0, 0.0), 1.5),
        f"column to 4 lengths, penalty {STRONG:g}": (gripped(4, dtype, 3.0, 0.0, STRONG), 1.5),
    }


def gained(scene, t_end: float, time_step: float) -> float:
    """The largest gain of energy over the start, or the hold, over the largest kinetic one; inf if it blew up."""
    name = scene.systems[0].name
    driven = scene[name].motion is not None
    found = jaxsph.topologies(scene)
    try:
        run = jaxsph.simulate(scene, t_end, t_end / (3 * SAVES), time_step=time_step)
    except jaxsph.NotFinite:
        return float("inf")
    seen = run.observe(lambda scene, state: jaxsph.observe.energies(scene, state, found))
    total, kinetic = (np.asarray(seen[key], float) for key in ("total", "kinetic"))
    first = 2 * SAVES + 1 if driven else 0  # the ramp is over
    size = total[first] if driven else kinetic.max()
    return float(np.max(total[first:] - total[first]) / size)


def sweep(quick: bool) -> Iterator[list[Row]]:
    """Up to which factor of the limit no energy is gained, and how many steps beyond it `simulate` takes."""
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        for name, (scene, t_end) in list(bodies(dtype).items())[: 1 if quick else None]:
            limit = jaxsph.stable_time_step(scene) / SAFETY
            stable = 0.0
            for factor in FACTORS:
                with any_step():
                    gain = gained(scene, t_end, factor * limit)
                print(f"  {name}: dt = {factor:.2g} of the limit gains {gain:+.2%}", flush=True)
                if not gain < GAIN:
                    break
                stable = factor
            taken = 0
            for factor in [factor for factor in FACTORS if factor > 1]:
                try:
                    jaxsph.simulate(scene, 4 * factor * limit, time_step=factor * limit)
                    taken += 1
                except jaxsph.UnstableTimeStep:
                    pass
            where = (name, precision(dtype))
            yield [
                Row("largest stable step / documented limit", stable, None, *where),
                Row("step of simulate, .9 limits, / largest stable", SAFETY / stable, 1.0, *where),
                Row("steps beyond the limit that are not refused", taken, 0.0, *where),
            ]


CASES = [Case("H14", "Time step of a structure", sweep)]
