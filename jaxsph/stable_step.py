"""The largest stable time step: of sound in fluids and structures, of viscosity, of plates beside water, of contact."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.contact import contact_time_step
from jaxsph.dynamics import prepare, topologies
from jaxsph.effects import AcousticDamper, ArtificialViscosity, Contact, Damping, KelvinVoigt, PenaltyForce
from jaxsph.elastic_forces import elastic_acceleration
from jaxsph.state import State, to_columns
from jaxsph.structure import Reference

POWER_ITERATIONS = 60
SOUND_LIMIT, VISCOUS_LIMIT, SOUND_RINGS = 0.8, 0.25, 1.1  # of h / c, of h^2 / nu; the h / c at which sound is unstable
INTERFACE_LIMIT = 2.5  # times the step of sound in a fluid that is as light as the one and as stiff as the other
SAFETY = 0.9  # of the stable step: the power iteration comes from below, and stretched bodies get stiffer


def largest_stable_time_step(
    scene, references: dict[str, Any], substeps: tuple | None = None, columns: dict | None = None
):
    """Largest stable step [s] of a scene: of its structures, `structure_time_step`; with fluids, `fluid_time_step`.

    columns: by structure the fields of a state, in which they are deformed; None takes the reference configuration.

    In a scene with fluids structures take many small steps in one of the fluids: they limit it only if it is known how
    many, substeps = (("plate", 12), ...).
    """
    limit = jnp.asarray(jnp.inf, scene.dtype)
    for structure in scene.structures:
        steps = 1 if not scene.fluids else dict(substeps or ()).get(structure.name)
        if steps is not None:
            here = None if columns is None else columns[structure.name]["displacement"]
            limit = jnp.minimum(limit, steps * structure_time_step(scene, structure, references[structure.name], here))
    if scene.rigid_bodies and scene.effect(Damping) is not None:
        limit = jnp.minimum(limit, damped_time_step(scene, jnp.asarray(jnp.inf, scene.dtype)))
    touching = contact_time_step(scene, references)
    if not scene.fluids:
        # Both act on the same particles in one step: the squares of the frequencies add up.
        return limit if scene.effect(Contact) is None else 1 / jnp.sqrt(1 / limit**2 + 1 / touching**2)
    for fluid in scene.fluids:
        limit = jnp.minimum(limit, fluid_time_step(scene, fluid))
        for other in scene.fluids:
            if other is not fluid:
                limit = jnp.minimum(limit, interface_time_step(scene, fluid, other))
        for solid in scene.solids:
            if solid.thickness is not None:
                limit = jnp.minimum(limit, plate_time_step(scene, fluid, solid))
    return jnp.minimum(limit, touching)


def interface_time_step(scene, fluid, other):
    """Largest stable time step [s] of a fluid beside another, which may be stiffer than it is heavy.

    Particles of the one are pushed by the other's pressure, rho_b c_b^2 times its compression: they swing as if sound
    had the speed c = c_b sqrt(rho_b / rho_a) in them. Fluid of 1/30 and 1/100 of the density of the water below
    is stable up to 3.5 h / c and blows up at 4 (F35 in docs/validation.md).
    """
    speed = other.sound_speed * jnp.sqrt(other.density / fluid.density)
    return INTERFACE_LIMIT * SOUND_LIMIT * scene.smoothing_length / speed


def plate_time_step(scene, fluid, structure):
    """Largest stable time step [s] for a plate beside a fluid: that of its mass on the spring of the fluid.

    The layer of fluid at a plate resists its motion with the stiffness rho c^2 / dx, per area and per length; with the
    mass rho_s t per area of the plate the frequency is c sqrt(rho / (rho_s t dx)). The step is 1 over that, half of
    what one side of the plate would allow: both sides may be wet, and the fluid be denser for a moment.
    """
    ratio = jnp.min(structure.density) / fluid.density
    return jnp.sqrt(ratio * structure.thickness * scene.spacing) / fluid.sound_speed


def structure_time_step(scene, structure, ready: Reference, displacement=None):
    """2 / w_max [s], less with friction: the limit of kick-drift-kick for the fastest vibration about a displacement.

    The frequency comes from a power iteration on the linearised elastic forces, so it holds for any kernel,
    arrangement of particles, law and penalty; it is of the order of the spacing over the p-wave speed. Bodies that are
    stretched by a part of their length vibrate faster.

    displacement: (d, N) [m]; None takes the reference configuration.
    """
    penalty = scene.effect(PenaltyForce)
    here = jnp.zeros_like(ready.positions) if displacement is None else displacement

    def stiffness(direction):
        force = lambda u: elastic_acceleration(structure, ready, u, penalty, forward_mode=True)  # noqa: E731
        return -ready.moving * jax.jvp(force, (here,), (direction,))[1]

    start = np.random.default_rng(0).standard_normal(ready.positions.shape)
    vector = ready.moving * jnp.asarray(start, ready.positions.dtype)

    def iterate(carry, _):
        vector, _ = carry
        image = stiffness(vector / _length(vector))
        return (image, _length(image)), None

    (_, squared), _ = jax.lax.scan(iterate, (vector, jnp.zeros((), vector.dtype)), length=POWER_ITERATIONS)
    return damped_time_step(scene, 2 / jnp.sqrt(squared))


def _length(vector):
    """|v| of all numbers together, without squares that overflow: frequencies squared are 1e20 in a micrometer."""
    largest = jnp.maximum(jnp.max(jnp.abs(vector)), jnp.finfo(vector.dtype).tiny)
    return largest * jnp.sqrt(jnp.sum((vector / largest) ** 2))


def damped_time_step(scene, limit):
    """The largest stable step [s] of a solid that without friction is a limit [s], infinite for a rigid body.

    Friction of the material takes the rate tau w^2 from a vibration w, `Damping` its own; both act with the velocity of
    half a step before, so that a step is stable while (w dt)^2 + 2 (tau w^2 + rate) dt < 4, with 2 / w the limit.
    """
    friction, damping = scene.effect(KelvinVoigt), scene.effect(Damping)
    share = 0.0  # (tau w^2 + rate) / 2
    if friction is not None:
        share = 2 * friction.relaxation_time / limit**2
    if damping is not None:
        share = share + 0.5 * damping.rate
    return limit if friction is None and damping is None else 2 / (jnp.sqrt(share**2 + 4 / limit**2) + share)


def fluid_time_step(scene, fluid):
    """Largest stable time step [s] of a fluid: that of sound, or of what damps it or of viscosity if that is shorter.

    Sound: 1.1 h / c, where the fastest standing wave of disordered particles turns by 2 in a step. Viscosity: as the
    explicit diffusion of a wave that alternates from particle to particle, h^2 / (4 nu). SOUND_LIMIT leaves room below
    the first: a rotating square whose arms are under tension gains energy at 1.1 h / c, four other scenes none up to
    1.4 (F35 in docs/validation.md). The second is not swept.

    A damper takes the share alpha (h / c) w^2 of its speed from a standing wave of the frequency w, by the rate of the
    step before. With that a kick-drift-kick of the step dt is stable while (w dt)^2 + 2 alpha (h / c) w^2 dt < 4; if
    the fastest wave allows dt = S h / c without a damper, that is dt = (sqrt(alpha^2 + S^2) - alpha) h / c.

    Artificial viscosity damps sound by three times its kinematic viscosity, alpha h c / (2 (d + 2)), while all pairs
    approach: it counts as that much more of a damper, with S = 1.1, so that it limits the step from an alpha of about 1
    on (F35). Its beta is not counted.
    """
    h = scene.smoothing_length
    limit, share = jnp.asarray(SOUND_LIMIT * h / fluid.sound_speed), 0.0
    damper, artificial = scene.effect(AcousticDamper), scene.effect(ArtificialViscosity)
    if damper is not None:
        share = damper.alpha
        limit = _damped(share, SOUND_LIMIT) * h / fluid.sound_speed
    if artificial is not None:
        share = share + 1.5 * artificial.alpha / (scene.dimension + 2)
        limit = jnp.minimum(limit, _damped(share, SOUND_RINGS) * h / fluid.sound_speed)
    if fluid.viscosity is not None:
        nu = fluid.viscosity / fluid.density
        limit = jnp.minimum(limit, VISCOUS_LIMIT * h**2 / jnp.maximum(nu, jnp.finfo(scene.dtype).tiny))
    return limit


def _damped(share, undamped):
    return jnp.sqrt(share**2 + undamped**2) - share


def largest_stable(scene, found: dict[str, Any], columns: dict | None = None) -> float:
    """`largest_stable_time_step` as a plain number [s], infinite for rigid bodies alone. Of plain numbers.

    Raises ValueError if no particle can move.
    """
    free = bool(scene.fluids or scene.rigid_bodies)
    if not free and all(np.all(structure.clamped) for structure in scene.structures):
        raise ValueError("no particle of the scene can move: all are clamped")
    with jax.ensure_compile_time_eval():  # inside of jit too, where another argument is traced
        return float(_limit(scene, found, columns))


def safe(limit: float) -> float:
    """`SAFETY` of the largest stable step [s]. Raises ValueError if there is none."""
    if not math.isfinite(limit):
        raise ValueError("nothing in the scene limits the time step, rigid bodies alone do not; pass time_step=")
    return SAFETY * limit


def stable_time_step(scene, found: dict[str, Any] | None = None, state: State | None = None) -> float:
    """The time step [s] that `simulate` takes by default: .9 of the largest stable one.

    With fluids that is theirs; `stable_substeps` says into how many steps structures divide it.

    state: whose deformation decides, of a scene without fluids; None takes the reference configuration, as `simulate`
        does. For a run in which bodies stretch by much, the step of its most stretched state is the one to pass.

    Raises ValueError if no particle can move, nothing limits the step, or a state is given of a scene with fluids.
    """
    found = topologies(scene) if found is None else found
    if state is not None and scene.fluids:
        raise ValueError("state= is for scenes without fluids: beside a fluid structures take substeps of its step")
    columns = None if state is None else to_columns(state.systems, found)
    return safe(largest_stable(scene, found, columns))


def stable_substeps(scene, time_step: float, found: dict[str, Any] | None = None) -> dict[str, int]:
    """By structure the number of steps that it takes within one of the fluids [s]: .9 of its largest stable, or less.

    Of a scene without fluids all are 1. For a fit take the stiffest and lightest scene that can occur.
    """
    if not scene.fluids:
        return {structure.name: 1 for structure in scene.structures}
    limits = structure_limits(scene, topologies(scene) if found is None else found)
    return {name: max(1, math.ceil(float(time_step) / (SAFETY * limit))) for name, limit in limits.items()}


def structure_limits(scene, found: dict[str, Any]) -> dict[str, float]:
    """By structure its largest stable step [s], as a plain number. Of plain numbers."""
    with jax.ensure_compile_time_eval():
        return {name: float(limit) for name, limit in _structure_limits(scene, found).items()}


@jax.jit
def _limit(scene, found, columns=None):
    return largest_stable_time_step(scene, prepare(scene, found), None, columns)


@jax.jit
def _structure_limits(scene, found):
    references = prepare(scene, found)
    return {s.name: structure_time_step(scene, s, references[s.name]) for s in scene.structures}
