"""The settings that a study sets by itself, on any scene; all others are arguments of the user's `scene_of`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np

from jaxsph import checks, kernels
from jaxsph.accuracy.results import Number, Value
from jaxsph.error_control import Diffrax
from jaxsph.integrate import KickDriftKick
from jaxsph.pytree import as_real, replace
from jaxsph.stable_step import SAFETY

SETTINGS = ("precision", "kernel", "neighbors", "step_fraction", "integrator", "tolerance")
"""precision: "float32" or "float64". kernel: such as "WendlandC2", of fluids and structures. neighbors: how many
particles lie within the support radius of a full neighborhood, by the smoothing length. step_fraction: of the largest
stable time step; .9 is the default. integrator: "KickDriftKick" or a diffrax solver such as "Tsit5". tolerance: of
such a solver, relative; the absolute one is a thousandth of it."""


def grid(**values: Iterable[Value]) -> list[dict[str, Value]]:
    """All combinations of the values of each setting, the last one fastest."""
    for name, choices in values.items():
        if isinstance(choices, str) or not isinstance(choices, Iterable):
            raise ValueError(f"{name} = {choices!r}: give a list of values, even of one")
    return [dict(zip(values, choice, strict=True)) for choice in itertools.product(*values.values())]


def listed(settings: Mapping[str, Iterable] | Iterable[Mapping[str, Any]]) -> list[dict[str, Value]]:
    """Settings as a list: those of a grid {name: values}, or as they are.

    Raises ValueError for a value that a file could not hold.
    """
    if isinstance(settings, Mapping):
        named: dict[str, Any] = {str(name): values for name, values in settings.items()}
        runs = grid(**named)
    else:
        runs = [dict(one) for one in settings]
    for one in runs:
        for name, value in one.items():
            if isinstance(value, np.generic):
                one[name] = value = value.item()
            if value is not None and not isinstance(value, (bool, int, float, str)):
                raise ValueError(
                    f"setting {name!r} is a {type(value).__name__}; tables hold numbers and names: give it a name, and "
                    "let scene_of make the object"
                )
    return runs


def applied(scene, settings: Mapping[str, Value]):
    """The scene with the kernel, the neighbors per particle and the precision that are asked for.

    Raises ValueError for a name or a number that there is not.
    """
    if (kernel := settings.get("kernel")) is not None:
        chosen = _kernel(kernel)
        scene = replace(scene, kernel=chosen)
        scene = _structures(scene, lambda s: {"kernel": chosen})
    if (neighbors := settings.get("neighbors")) is not None:
        checks.check_positive("neighbors", neighbors, "particles within the support radius")
        if scene.fluids:
            h = _smoothing_length(scene.kernel, float(neighbors), scene.dimension, scene.spacing)  # type: ignore[arg-type]
            scene = replace(scene, smoothing_length=as_real(h, scene.dtype))

        def shorter(structure):
            spacing = structure.particles.spacing
            h = _smoothing_length(structure.kernel, float(neighbors), scene.dimension, spacing)  # type: ignore[arg-type]
            return {"smoothing_length": as_real(h, scene.dtype)}

        scene = _structures(scene, shorter)
    if (precision := settings.get("precision")) is not None:
        scene = _in_precision(scene, precision)
    return scene


def integrator_of(settings: Mapping[str, Value]) -> KickDriftKick | Diffrax:
    """The integrator that is asked for. Raises ValueError for one that there is not."""
    name, tolerance = settings.get("integrator") or "KickDriftKick", settings.get("tolerance")
    if name == "KickDriftKick":
        if tolerance is not None:
            raise ValueError("KickDriftKick has no tolerance; its accuracy is that of step_fraction")
        return KickDriftKick()
    if settings.get("step_fraction") is not None:
        raise ValueError(f"{name} chooses its own steps; give a tolerance instead of step_fraction")
    import diffrax

    solver = getattr(diffrax, str(name), None)
    if not (isinstance(solver, type) and issubclass(solver, diffrax.AbstractSolver)):
        raise ValueError(f"integrator {name!r} must be 'KickDriftKick' or a solver of diffrax, such as 'Tsit5'")
    relative = 1e-6 if tolerance is None else float(tolerance)
    return Diffrax(solver(), relative_tolerance=relative, absolute_tolerance=1e-3 * relative)


def time_step_of(settings: Mapping[str, Value], default: Number) -> float:
    """The time step [s] that is asked for, as a fraction of the largest stable one; `default` is .9 of that."""
    fraction = settings["step_fraction"]
    checks.check_positive("step_fraction", fraction, "of the largest stable step")
    return float(fraction) * default / SAFETY  # type: ignore[arg-type]


def _structures(scene, changes):
    systems = tuple(replace(s, **changes(s)) if s in scene.structures else s for s in scene.systems)
    return replace(scene, systems=systems)


def _kernel(name):
    kind = getattr(kernels, str(name), None)
    if not (isinstance(kind, type) and issubclass(kind, kernels.Kernel) and kind is not kernels.Kernel):
        known = [key for key, item in vars(kernels).items() if isinstance(item, type) and hasattr(item, "support")]
        raise ValueError(f"kernel {name!r} must be one of {', '.join(sorted(known))}")
    return kind()


def _smoothing_length(kernel, neighbors: float, dimension: int, spacing: float) -> float:
    """h [m] with which a ball of the support radius holds so many particles, the one in the middle included."""
    unit_ball = math.pi if dimension == 2 else 4 * math.pi / 3
    return spacing * (neighbors / unit_ball) ** (1 / dimension) / kernel.support


def _in_precision(scene, precision):
    if precision not in ("float32", "float64"):
        raise ValueError(f"precision {precision!r} must be 'float32' or 'float64'")
    if precision == "float64" and not jax.config.read("jax_enable_x64"):
        raise ValueError("precision 'float64' needs jax.config.update('jax_enable_x64', True) before anything else")

    def cast(leaf: Any):
        real = isinstance(leaf, (np.ndarray, np.generic, jax.Array)) and np.issubdtype(leaf.dtype, np.floating)
        return np.asarray(leaf, precision) if real else leaf

    return jax.tree.map(cast, scene)
