"""The scene: what is in the world. A pytree; every float in it can be differentiated, fitted or vmapped over."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxsph import checks, pytree
from jaxsph.effects import Damping, PenaltyForce
from jaxsph.pytree import is_concrete, pytree_dataclass
from jaxsph.structure import Structure


@pytree_dataclass
class Scene:
    """Systems of particles, gravity, and the effects that the scene calls for.

    Attributes:
        systems: structures, each with its own name.
        gravity: (d,) [m/s^2]; None is none.
        effects: such as `PenaltyForce(0.05)` or `Damping(2.0)`, at most one of a kind. What is not listed is
            not compiled.

    Raises:
        ValueError: two systems of one name, different dimensions or precisions, two effects of one kind.

    A number in a scene is named by where it stands: "plate.youngs_modulus", "gravity", "PenaltyForce.coefficient".
    """

    systems: tuple
    gravity: Any = None
    effects: tuple = ()

    def __init__(self, *systems, gravity=None, effects=()):
        if len(systems) == 1 and isinstance(systems[0], (tuple, list)):
            systems = tuple(systems[0])
        for system in systems:
            if not isinstance(system, Structure):
                raise ValueError(f"a scene is made of structures, not of {type(system).__name__}")
        if not systems:
            raise ValueError("a scene needs at least one system of particles")
        names = [system.name for system in systems]
        if len(set(names)) != len(names):
            raise ValueError(f"two systems have the same name: {names}")
        dimensions, kinds = {s.dimension for s in systems}, {str(s.dtype) for s in systems}
        if len(dimensions) > 1 or len(kinds) > 1:
            raise ValueError(f"all systems of a scene need one dimension and one precision, not {dimensions}, {kinds}")
        (d,) = dimensions
        gravity = np.zeros(d) if gravity is None else gravity
        checks.check_finite("gravity", gravity, (d,))
        if is_concrete(gravity):
            gravity = np.asarray(gravity, systems[0].dtype)
        for effect in effects:
            if not isinstance(effect, (PenaltyForce, Damping)):
                raise ValueError(f"{effect!r} is not an effect; known are PenaltyForce and Damping")
        if len({type(effect) for effect in effects}) != len(effects):
            raise ValueError(f"an effect can be listed once: {[type(e).__name__ for e in effects]}")
        object.__setattr__(self, "systems", tuple(systems))
        object.__setattr__(self, "gravity", gravity)
        object.__setattr__(self, "effects", tuple(_in_precision(effect, systems[0].dtype) for effect in effects))

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
            scene = _put(scene, path.split("."), value)
        for system in scene.systems:
            if is_concrete(system.particles):
                system.particles.__post_init__()
            system.check(f"{system.name}.")
        checks.check_finite("gravity", scene.gravity, (scene.dimension,))
        for effect in scene.effects:
            effect.__post_init__()
        return scene

    def __str__(self) -> str:
        lines = [f"Scene in {self.dimension}D, {np.dtype(self.dtype).name}"]
        for s in self.systems:
            clamped = int(np.sum(s.clamped))
            lines.append(
                f"  {s.name}: {s.n_particles} particles ({clamped} clamped), spacing {s.particles.spacing:.4g} m, "
                f"{type(s.law).__name__}, E {_short(s.youngs_modulus)} Pa, Poisson ratio {_short(s.poisson_ratio)}, "
                f"density {_short(s.density)} kg/m^3"
            )
        lines.append(f"  gravity {_short(self.gravity)} m/s^2")
        lines.append("  effects: " + (", ".join(str(e) for e in self.effects) or "none"))
        return "\n".join(lines)


def _in_precision(effect, real):
    """The effect with its arrays in the scene's precision; plain numbers have none."""
    plain = lambda leaf: type(leaf) in (float, int) or not is_concrete(leaf)  # noqa: E731
    return jax.tree.map(lambda leaf: leaf if plain(leaf) else np.asarray(leaf, real), effect)


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
        return named | {type(effect).__name__: effect for effect in item.effects} | {"gravity": item.gravity}
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
        if head == "gravity":
            return pytree.replace(item, gravity=value)
        systems = tuple(_put(s, rest, value) if s.name == head else s for s in item.systems)
        effects = tuple(_put(e, rest, value) if type(e).__name__ == head else e for e in item.effects)
        return pytree.replace(item, systems=systems, effects=effects)
    return pytree.replace(item, **{head: _put(getattr(item, head), rest, value)})
