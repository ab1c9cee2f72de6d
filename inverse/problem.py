"""An inverse problem: which values of the unknowns make the simulated observations match the measured
ones.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from inverse.jaxsph_simulation import JaxsphSimulation
from inverse.observations import Observations
from inverse.transforms import Transform


class Problem:
    """Data, unknowns, and the three functions that turn values of the unknowns into simulated observations.

    Args:
        scene: whatever `replace` and `simulate` understand.
        observe: run -> array of the shape of `data.values`, differentiable.
        data: the measurement.
        unknown: {name: inverse.log(...) or inverse.linear(...)}.
        simulate: (scene, times, mode) -> run, pure and differentiable by JAX; `times` (T,) are the
        observation
            times [s], `mode` is "forward" or "reverse", the direction in which it will be differentiated. A
            run that fails raises a RuntimeError, or, where it is traced, returns values that are not finite.
            By default jaxsph.simulate with the time step that is stable everywhere within the bounds.
        replace: (scene, {name: value}) -> scene with those values; `scene.replace` by default.
        time_step: of the default `simulate` [s]; chosen from the bounds where not given.
        save_every: of the default `simulate` [s]; chosen from the observation times where not given.

    Raises:
        ValueError: arguments that are of the wrong kind, or say the same thing twice.

    """

    def __init__(
        self,
        scene: Any,
        observe: Callable[[Any], Any],
        data: Any,
        unknown: Mapping[str, Any],
        simulate: Callable[[Any, np.ndarray, str], Any] | None = None,
        replace: Callable[[Any, dict[str, Any]], Any] | None = None,
        time_step: float | None = None,
        save_every: float | None = None,
    ) -> None:
        if not isinstance(data, Observations):
            raise ValueError(f"data is a {type(data).__name__}; make it with inverse.Observations(...)")
        if not unknown:
            raise ValueError(
                "unknown is empty; name at least one, as in {'plate.youngs_modulus': inverse.log(1e5, 1e8)}"
            )
        for name, transform in unknown.items():
            if not isinstance(transform, Transform):
                raise ValueError(
                    f"unknown[{name!r}] is a {type(transform).__name__}; give bounds and a scale with "
                    "inverse.log(lower, upper) or inverse.linear(lower, upper)"
                )
        if replace is None:
            if not callable(getattr(scene, "replace", None)):
                raise ValueError(
                    f"a scene of type {type(scene).__name__} has no method replace({{name: value}}); pass replace="
                )
            replace = _replace_by_method
        if simulate is not None and not (time_step is None and save_every is None):
            raise ValueError("time_step and save_every belong to the default simulate; set them inside your own")
        self.scene = scene
        self.observe = observe
        self.data: Observations = data
        self.unknown: dict[str, Transform] = dict(unknown)
        self.replace = replace
        self._made = {} if simulate is None else {"simulate": simulate}  # shared by copies for other data or starts
        self.empty_rows = 0  # of the data: entries that are zero whatever the unknowns are, and tell nothing
        self._dtypes = {name: _dtype_of(scene, name) for name in self.unknown}
        self._asked = {"simulate": simulate, "time_step": time_step, "save_every": save_every}
        self.programs: dict[str, Any] = {}  # what the first fit compiled, for the next ones

    def with_data(self, data: Observations) -> Problem:
        """The same problem for another measurement at the same times; nothing is compiled anew.

        Raises:
            ValueError: times or shape that differ.

        """
        if data.values.shape != self.data.values.shape or not np.array_equal(data.times, self.data.times):
            raise ValueError(
                f"with_data: values {data.values.shape} at {len(data)} times do not take the place of "
                f"{self.data.values.shape}; the times must be the same, make a new Problem otherwise"
            )
        other = copy.copy(self)
        other.data = data
        return other

    def started_at(self, vector: np.ndarray) -> Problem:
        """The same problem from other starting values (n,), clipped to the bounds; nothing is compiled anew."""
        other, offset = copy.copy(self), 0
        other.unknown = dict(self.unknown)
        for name, t in self.unknown.items():
            size = int(np.prod(t.shape))
            start = np.asarray(np.clip(np.reshape(vector[offset : offset + size], t.shape), t.lower, t.upper))
            other.unknown[name], offset = dataclasses.replace(t, start=start), offset + size
        return other

    def narrowed(self, vector: np.ndarray, width: float) -> Problem:
        """The same problem from other starting values (n,), with bounds that are `width` away from them.

        The width is in the internal coordinate (log: .2 is 22 %; linear: .2 is a twentieth of the range), and never
        goes beyond the bounds that there are. Narrow bounds spare the default `simulate` time steps, which are those
        of the stiffest values within them.
        """
        if not width > 0:
            raise ValueError(f"narrowed: width = {width} must be > 0")
        unknown = {}
        for name, t in self.started_at(vector).unknown.items():
            z = t.internal(t.start)
            lower, upper = np.asarray(t.value(z - width)), np.asarray(t.value(z + width))  # clipped to the old ones
            unknown[name] = dataclasses.replace(t, lower=lower, upper=upper)
        other = Problem(self.scene, self.observe, self.data, unknown, replace=self.replace, **self._asked)
        other.empty_rows = self.empty_rows
        return other

    @property
    def simulate(self) -> Callable[[Any, np.ndarray, str], Any]:
        """The simulator; the default one is made when it is first needed, because with fluids it runs some of them."""
        if "simulate" not in self._made:
            _, time_step, save_every = self._asked.values()
            self._made["simulate"] = JaxsphSimulation(
                self.scene, self.replace, self.unknown, self.data.times, time_step, save_every
            )
        return self._made["simulate"]

    @property
    def labels(self) -> list[str]:
        """One label per entry of z: the name, with an index for unknowns that are arrays."""
        return [
            name if not t.shape else f"{name}[{','.join(map(str, index))}]"
            for name, t in self.unknown.items()
            for index in np.ndindex(t.shape)
        ]

    @property
    def units(self) -> list[str]:
        return [t.unit for t in self.unknown.values() for _ in np.ndindex(t.shape)]

    @property
    def start(self) -> np.ndarray:
        """(n,) internal coordinates of the starting values."""
        return self._join(lambda t: t.internal(t.start))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Two (n,): the bounds in internal coordinates."""
        return self._join(lambda t: t.internal(t.lower)), self._join(lambda t: t.internal(t.upper))

    def values(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Values of the unknowns by name at the internal coordinates z (n,)."""
        return {name: t.value(part) for name, t, part in self._parts(z)}

    def vector(self, z: np.ndarray) -> np.ndarray:
        """(n,) values of the unknowns, in the order of `labels`."""
        return np.concatenate([t.value(part).ravel() for _, t, part in self._parts(z)])

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """(n,) d value / d z."""
        return np.concatenate([np.ravel(t.slope(part)) for _, t, part in self._parts(z)])

    def relative_errors(self, z: np.ndarray, standard_error: np.ndarray) -> np.ndarray:
        """(n,) standard errors in z as fractions: of the value (log unknowns) or of the range (linear)."""
        errors = [part for _, _, part in self._parts(standard_error)]
        return np.concatenate(
            [np.ravel(t.relative(part, error)) for (_, t, part), error in zip(self._parts(z), errors, strict=True)]
        )

    def model(self, vector: Any, mode: str) -> jax.Array:
        """(T m,) simulated observations for the values (n,) of the unknowns, traceable by JAX."""
        vector, values, offset = jnp.asarray(vector), {}, 0
        for name, transform in self.unknown.items():
            size = int(np.prod(transform.shape))
            entry = vector[offset : offset + size].reshape(transform.shape)
            values[name] = entry.astype(self._dtypes[name] or entry.dtype)
            offset += size
        run = self.simulate(self.replace(self.scene, values), self.data.times, mode)
        observed = jnp.asarray(self.observe(run))
        if observed.size != self.data.values.size or observed.shape[0] != len(self.data):
            raise ValueError(
                f"observe(run) has shape {observed.shape}, data.values {self.data.values.shape}; both "
                "are (T,) or (T, m) at the observation times: simulate must return the run at the times "
                "that it is given, and observe must pick what was measured"
            )
        return observed.reshape(-1)

    def check(self, **options: Any):
        """Do forward mode, reverse mode and central differences agree? See `inverse.check`."""
        from inverse.gradient_check import check

        return check(self, **options)

    def _parts(self, z: np.ndarray):
        offset = 0
        for name, transform in self.unknown.items():
            size = int(np.prod(transform.shape))
            yield name, transform, np.asarray(z)[offset : offset + size].reshape(transform.shape)
            offset += size

    def _join(self, pick: Callable[[Transform], np.ndarray]) -> np.ndarray:
        return np.concatenate([np.ravel(pick(t)) for t in self.unknown.values()])


def _replace_by_method(scene: Any, values: dict[str, Any]) -> Any:
    return scene.replace(values)


def _dtype_of(scene: Any, name: str):
    """Floating type of what the unknown replaces, so that a float32 scene stays one; None where it can't be
    seen.
    """
    try:
        if isinstance(scene, Mapping):
            leaf = scene[name]
        elif callable(getattr(scene, "get", None)):
            leaf = scene.get(name)
        else:
            return None
    except KeyError:
        return None  # replace will say what is wrong with the name, or knows it by another way
    dtype = getattr(leaf, "dtype", None)
    return dtype if dtype is not None and jnp.issubdtype(dtype, jnp.floating) else None
