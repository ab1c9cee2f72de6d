"""Why a scene has the effects that it has: its numbers, what it could do without, what it lacks, what each costs.

    print(scene.explain())
    scene.explain(speed=1.0, length=0.1, measure=True).missing

Everything is an estimate from the scene as it stands at the start: positions, numbers, effects. Nothing is run unless
`measure=True`.
"""

from __future__ import annotations

from jaxsph import checks
from jaxsph.effects import PenaltyForce
from jaxsph.explain.cost import Cost
from jaxsph.explain.cost import measure as measured
from jaxsph.explain.explanation import Explanation
from jaxsph.explain.facts import Facts, facts_of
from jaxsph.explain.finding import Finding, Number
from jaxsph.explain.listed import listed, spare
from jaxsph.explain.missing import missing
from jaxsph.explain.numbers import numbers_of
from jaxsph.explain.summary import summary
from jaxsph.pytree import is_concrete
from jaxsph.scene import Scene
from jaxsph.stable_step import stable_time_step

__all__ = ["Cost", "Explanation", "Facts", "Finding", "Number", "explain", "summary"]


def explain(
    scene: Scene,
    *,
    speed: float | int | None = None,
    length: float | int | None = None,
    surface_tension: float | int | None = None,
    measure: bool = False,
) -> Explanation:
    """Which effects of a scene are on and why, which could be left out at its numbers, and which are missing.

    Args:
        scene: with known numbers.
        speed: characteristic, U [m/s]; None takes the fastest of what starts, of moving walls, and of what gravity and
            body forces can drive.
        length: characteristic, L [m]; None takes the height of the fluid, or its smallest extent across the periodic
            directions.
        surface_tension: sigma of the fluid [N/m], to be told the Weber and Bond numbers and whether it matters.
        measure: time a step with and without each effect; compiles one program for each, some seconds.

    Raises:
        ValueError: numbers of the scene are traced; a speed, length or surface tension that is not positive.
    """
    if not is_concrete(scene):
        raise ValueError("numbers of the scene are traced; explain the scene outside of jit, grad and vmap")
    for name, value, unit in (
        ("speed", speed, "m/s"),
        ("length", length, "m"),
        ("surface_tension", surface_tension, "N/m"),
    ):
        if value is not None:
            checks.check_positive(name, value, unit)
    facts = facts_of(scene, speed, length, surface_tension)
    penalty = [effect for effect in scene.effects if isinstance(effect, PenaltyForce)]
    alone = [structure for structure in scene.structures if scene.fluids and not structure.clamped.all()]
    steps = {structure.name: stable_time_step(Scene(structure, effects=penalty)) for structure in alone}
    costs = measured(scene) if measure else None
    return Explanation(facts, numbers_of(facts, steps), listed(facts), spare(facts), missing(facts), costs)
