"""The scene: what is in the world. A pytree; every float in it can be differentiated, fitted or vmapped over."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxsph import checks, pytree
from jaxsph.density import ContinuityDensity, DensityCalculator
from jaxsph.effects import Contact, FlowEffect
from jaxsph.fluid import Fluid
from jaxsph.kernels import Kernel, WendlandC2
from jaxsph.materials.elastic import ElasticLaw
from jaxsph.materials.state_equation import StateEquation
from jaxsph.materials.viscosity import ViscosityLaw
from jaxsph.neighbors import Domain
from jaxsph.pytree import as_real, is_concrete, pytree_dataclass, static
from jaxsph.rigid_body import RigidBody
from jaxsph.scene_checks import check_density, check_effects, check_fluids, check_meetings, check_systems
from jaxsph.structure import Structure
from jaxsph.walls import Wall, WallPressure

SMOOTHING_LENGTH = 1.5
"""Smoothing length of the fluids in particle spacings of the coarsest, if none is given."""

LAWS = (ElasticLaw, StateEquation, ViscosityLaw, WallPressure)

SCENE_PARTS = ("gravity", "smoothing_length", "density", "kernel")


@pytree_dataclass
class Scene:
    """Systems of particles, gravity, and the effects that the scene calls for.

    Attributes:
        systems: fluids, walls, structures and rigid bodies, each with its own name.
        gravity: (d,) [m/s^2]; None is none.
        effects: such as `ArtificialViscosity(0.02)` or `PenaltyForce(0.05)`, one or a list, at most one of a kind (of
            `BodyForce` any number). What is not listed is not compiled.
        kernel: smoothing kernel of the fluids; structures have their own.
        smoothing_length: h of all fluids [m]; None takes 1.5 spacings, those of the coarsest.
        density: how fluids get their density.
        domain: in which systems that meet move, with its periodic directions; None is free, and ends far from the
            particles.

    Raises:
        ValueError: two systems of one name, different dimensions or precisions, two effects of one kind, an effect
            for which the scene has no system.

    A number in a scene is named by where it stands: "plate.youngs_modulus", "gravity", "PenaltyForce.coefficient",
    "density.alpha".
    """

    systems: tuple
    gravity: Any = None
    effects: tuple = ()
    kernel: Kernel = WendlandC2()
    smoothing_length: Any = None
    density: DensityCalculator = ContinuityDensity()
    domain: Domain | None = static(default=None)

    def __init__(
        self, *systems, gravity=None, effects=(), kernel=None, smoothing_length=None, density=None, domain=None
    ):
        if len(systems) == 1 and isinstance(systems[0], (tuple, list)):
            systems = tuple(systems[0])
        check_systems(systems)
        real, d = systems[0].dtype, systems[0].dimension
        gravity = np.zeros(d) if gravity is None else gravity
        effects = effects if isinstance(effects, (tuple, list)) else (effects,)
        checks.check_kind("kernel", kernel, Kernel, "WendlandC4()")
        checks.check_kind("domain", domain, Domain, "Domain((0, 0), (1, 1), periodic=True)")
        checks.check_kind("density", density, DensityCalculator, "SummationDensity()")
        checks.check_finite("gravity", gravity, (d,))
        check_effects(effects, systems)
        flows = [system for system in systems if isinstance(system, Fluid)]
        if domain is not None and domain.dimension != d:
            raise ValueError(f"the domain has {domain.dimension} axes, the particles {d}")
        if smoothing_length is None and flows:
            smoothing_length = SMOOTHING_LENGTH * max(fluid.particles.spacing for fluid in flows)
        if smoothing_length is not None:
            checks.check_positive("smoothing_length", smoothing_length, "m")
            smoothing_length = as_real(smoothing_length, real)
        check_fluids(flows, smoothing_length)
        check_meetings(systems, effects, flows)
        density = ContinuityDensity() if density is None else density
        check_density(density, systems, effects)
        set_field = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        set_field("systems", tuple(_laws_in_precision(system, real) for system in systems))
        set_field("gravity", as_real(gravity, real))
        set_field("effects", tuple(_in_precision(effect, real) for effect in effects))
        set_field("kernel", WendlandC2() if kernel is None else kernel)
        set_field("smoothing_length", smoothing_length)
        set_field("density", _in_precision(density, real))
        set_field("domain", domain)

    @property
    def structures(self) -> list[Structure]:
        """The elastic bodies."""
        return [system for system in self.systems if isinstance(system, Structure)]

    @property
    def rigid_bodies(self) -> list[RigidBody]:
        """The rigid bodies."""
        return [system for system in self.systems if isinstance(system, RigidBody)]

    @property
    def solids(self) -> list[Structure | RigidBody]:
        """Structures and rigid bodies: what forces move, and fluids meet as they meet a wall."""
        return [*self.structures, *self.rigid_bodies]

    @property
    def fluids(self) -> list[Fluid]:
        """The fluids."""
        return [system for system in self.systems if isinstance(system, Fluid)]

    @property
    def walls(self) -> list[Wall]:
        """The walls."""
        return [system for system in self.systems if isinstance(system, Wall)]

    @property
    def boundaries(self) -> list[Wall | Structure | RigidBody]:
        """What fluids meet beside each other, and solids with `Contact`; walls alone if nothing meets."""
        return [*self.walls, *(self.solids if self.meets else ())]

    @property
    def meets(self) -> bool:
        """Whether neighbors change during a run: those of fluids, and of solids with `Contact`."""
        return bool(self.fluids) or self.effect(Contact) is not None

    @property
    def flow_effects(self) -> list:
        """The effects that take part in the sums of fluids."""
        return [effect for effect in self.effects if isinstance(effect, FlowEffect)]

    @property
    def spacing(self) -> float:
        """Smallest particle spacing of the fluids [m]; of all systems if there is none."""
        return min(system.particles.spacing for system in self.fluids or self.systems)

    def displacement(self, a, b):
        """a - b [m], component first; in a periodic domain to the nearest image of b."""
        return a - b if self.domain is None else self.domain.displacement(a, b)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.systems[0].dimension

    @property
    def dtype(self):
        """Precision of all arrays."""
        return self.systems[0].dtype

    def __getitem__(self, name: str):
        for system in self.systems:
            if system.name == name:
                return system
        raise KeyError(f"no system is called {name!r}; there are {[s.name for s in self.systems]}")

    def effect(self, kind: type) -> Any:
        """The effect of this kind, or None."""
        return next((effect for effect in self.effects if isinstance(effect, kind)), None)

    def get(self, path: str) -> Any:
        """The value that stands at a path such as "plate.youngs_modulus".

        Raises KeyError if nothing stands there, naming what does.
        """
        return _walk(self, path.split("."), path)

    def replace(self, values: dict[str, Any]) -> Scene:
        """A copy with other values: {"plate.youngs_modulus": 2e6}. Values keep the scene's precision.

        Raises KeyError for a path at which nothing stands, ValueError for a number out of its range, or of
        another shape.
        """
        scene: Any = self
        for path, value in values.items():
            old = scene.get(path)
            if isinstance(old, (np.ndarray, jax.Array, float, int)) and not isinstance(old, bool):
                # a plain number, as in an effect, would become a float64 and take the whole run with it
                real = scene.dtype if isinstance(old, (float, int)) else old.dtype
                if np.issubdtype(real, np.integer):
                    real = scene.dtype
                value = np.asarray(value, real) if is_concrete(value) else jax.numpy.asarray(value, real)
            elif old is None and isinstance(value, (np.floating, np.ndarray, jax.Array)):
                value = as_real(value, scene.dtype)
            scene = _put(scene, path.split("."), value)
        for system in scene.systems:
            if is_concrete(system.particles):
                system.particles.__post_init__()
            system.check(f"{system.name}.")
        checks.check_finite("gravity", scene.gravity, (scene.dimension,))
        if scene.smoothing_length is not None:
            checks.check_positive("smoothing_length", scene.smoothing_length, "m")
        check_fluids(scene.fluids, scene.smoothing_length)
        for part in (*scene.effects, scene.density):
            if hasattr(part, "__post_init__"):
                part.__post_init__()
        return scene

    def __str__(self) -> str:
        lines = [f"Scene in {self.dimension}D, {np.dtype(self.dtype).name}"]
        lines += ["  " + _described(system) for system in self.systems]
        if self.fluids:
            h, room = self.smoothing_length, "free domain"
            if self.domain is not None:
                room = f"domain {_short(self.domain.lower)} to {_short(self.domain.upper)} m"
            about = f"{type(self.kernel).__name__}, smoothing length {_short(h)} m, {type(self.density).__name__}"
            lines.append(f"  {about}, {room}")
        lines.append(f"  gravity {_short(self.gravity)} m/s^2")
        lines.append("  effects: " + (", ".join(str(e) for e in self.effects) or "none"))
        if is_concrete(self):
            from jaxsph.explain import summary

            lines += ["  " + line for line in summary(self)]
        return "\n".join(lines)

    def explain(self, **about):
        """Why its effects are on, which could be left out, which are missing: see `jaxsph.explain.explain`."""
        from jaxsph.explain import explain

        return explain(self, **about)


def _described(s) -> str:
    """One line about a system."""
    line = f"{s.name}: {s.n_particles} particles, spacing {s.particles.spacing:.4g} m, "
    if isinstance(s, Structure):
        return line + (
            f"{int(np.sum(s.clamped))} clamped, {type(s.law).__name__}, E {_short(s.youngs_modulus)} Pa, Poisson ratio "
            f"{_short(s.poisson_ratio)}, density {_short(s.density)} kg/m^3"
        )
    if isinstance(s, RigidBody):
        return line + f"rigid, density {_short(s.density)} kg/m^3"
    if isinstance(s, Fluid):
        viscosity = "inviscid" if s.viscosity is None else f"viscosity {_short(s.viscosity)} Pa s"
        return line + (
            f"density {_short(s.density)} kg/m^3, sound speed {_short(s.sound_speed)} m/s, {viscosity}, "
            f"{type(s.state_equation).__name__}"
        )
    moving = "moving, " if s.motion is not None else ""
    return line + f"{moving}{type(s.pressure).__name__}, {'no slip' if s.no_slip else 'free slip'}"


def _in_precision(effect, real):
    """The effect with its arrays in the scene's precision; plain numbers have none."""
    plain = lambda leaf: type(leaf) in (float, int) or not is_concrete(leaf)  # noqa: E731
    return jax.tree.map(lambda leaf: leaf if plain(leaf) else np.asarray(leaf, real), effect)


def _laws_in_precision(system, real):
    """The system with the arrays of its laws and models in the scene's precision."""
    laws = {name: getattr(system, name, None) for name in ("law", "state_equation", "viscosity_law", "pressure")}
    changed = {
        name: _in_precision(law, real) for name, law in laws.items() if isinstance(law, LAWS) and jax.tree.leaves(law)
    }
    return pytree.replace(system, **changed) if changed else system


def _short(value):
    if not is_concrete(value):
        return "(traced)"
    value = np.asarray(value)
    if value.ndim == 0:
        return f"{value.item():.4g}"
    if value.size <= 3:
        return "(" + ", ".join(f"{v:.4g}" for v in value) + ")"
    return f"{value.min():.4g} to {value.max():.4g}"


def _children(item):
    if isinstance(item, Scene):
        named = {system.name: system for system in item.systems}
        named |= {type(effect).__name__: effect for effect in item.effects}
        return named | {name: getattr(item, name) for name in SCENE_PARTS}
    return dict(vars(item)) if hasattr(item, "__dict__") else {}


def _walk(item, names, path):
    for name in names:
        children = _children(item)
        if name not in children:
            raise KeyError(f"nothing stands at {path!r}: {name!r} is not one of {sorted(children)}")
        item = children[name]
    return item


def _put(item, names, value):
    if not names:
        return value
    head, rest = names[0], names[1:]
    if isinstance(item, Scene):
        if head in SCENE_PARTS:
            return pytree.replace(item, **{head: _put(getattr(item, head), rest, value)})
        systems = tuple(_put(s, rest, value) if s.name == head else s for s in item.systems)
        effects = tuple(_put(e, rest, value) if type(e).__name__ == head else e for e in item.effects)
        return pytree.replace(item, systems=systems, effects=effects)
    return pytree.replace(item, **{head: _put(getattr(item, head), rest, value)})
