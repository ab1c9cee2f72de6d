"""A scene run at many settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxsph.accuracy.measure import measured
from jaxsph.accuracy.results import Number, Results, Row, Value
from jaxsph.accuracy.settings import SETTINGS, applied, integrator_of, listed, time_step_of
from jaxsph.dynamics import topologies
from jaxsph.error_control import Diffrax
from jaxsph.errors import SimulationError
from jaxsph.simulate import simulate
from jaxsph.stable_step import stable_time_step


@dataclass(eq=False)
class Study:
    """A scene, its settings, and how wrong a run of it is.

    The error is what `error_of` says (against an exact or tabulated solution), or the distance of what `observe` sees
    from a `reference`: |observe(run) - reference| / |reference|, with the reference an array, or the settings of a
    finer run, which is then made once. `recommend` also does without a reference.

    Args:
        scene_of: makes the scene from its own settings, as keywords.
        t_end, save_every: of `simulate` [s].
        error_of: run -> error, or {name: error} for several at once.
        observe: run -> array.
        reference: array of that shape, or settings.
        resolution: name of the setting that refines; larger is finer.
        options: further arguments of `simulate`.
        repeats: of every run; the fastest counts.
        title: for tables and pictures.

    Attributes:
        results: of all runs made so far.

    Raises ValueError unless there is one of error_of and observe.
    """

    scene_of: Callable[..., Any]
    t_end: Number
    save_every: Number | None = None
    error_of: Callable[[Any], float | Mapping[str, float]] | None = None
    observe: Callable[[Any], Any] | None = None
    reference: Any = None
    resolution: str | None = "particles"
    options: Mapping[str, Any] = field(default_factory=dict)
    repeats: int = 1
    title: str = ""

    def __post_init__(self):
        if (self.error_of is None) == (self.observe is None):
            raise ValueError("a study needs error_of=, or observe= with a reference=: one of the two")
        if self.error_of is not None and self.reference is not None:
            raise ValueError("error_of knows its own reference; give observe= together with reference=")
        if self.repeats < 1:
            raise ValueError(f"repeats = {self.repeats} must be at least 1")
        self.results = Results((), self.resolution, self.title)
        self._finest: np.ndarray | None = None

    def run(
        self,
        settings: Mapping[str, Iterable] | Iterable[Mapping[str, Any]],
        progress: bool = False,
        out: str | Path | None = None,
    ) -> Results:
        """Run all settings, one after the other.

        A run that fails (an unstable step, a field that is not finite) has a row that says so, and no error.

        Args:
            settings: {name: values} for all combinations, or a list of {name: value}. `accuracy.SETTINGS` are set by
                the study, all others are given to `scene_of`.
            progress: print a line for each run.
            out: `.csv` or `.h5` to write after each run.

        Raises ValueError for settings that there are not.
        """
        made = Results((), self.resolution, self.title)
        for one in listed(settings):
            row, _ = self.measure(one)
            made = made + Results((row,))
            self.results = self.results + Results((row,))
            if progress:
                print(line(row), flush=True)
            if out is not None:
                made.save(out)
        return made

    def measure(self, settings: Mapping[str, Value]) -> tuple[Row, Any]:
        """One run: its row, and what it has of the observed quantity (None with `error_of`, or if it failed)."""
        scene = applied(self.scene_of(**{k: v for k, v in settings.items() if k not in SETTINGS}), settings)
        n_particles = sum(system.n_particles for system in scene.systems)
        integrator, time_step = integrator_of(settings), None
        if settings.get("step_fraction") is not None:
            time_step = time_step_of(settings, stable_time_step(scene, topologies(scene)))

        def run_to(t_end):
            run = simulate(scene, t_end, self.save_every, time_step=time_step, integrator=integrator, **self.options)
            return jax.block_until_ready(run)

        # an error-controlled run is one program from start to end, others one from save to save
        controlled = isinstance(integrator, Diffrax)
        first = self.t_end if controlled or self.save_every is None else self.save_every
        try:
            run, cost = measured(lambda: run_to(self.t_end), lambda: run_to(first), first / self.t_end, self.repeats)
        except SimulationError as failure:
            names, reason = self.results.errors or ["error"], f"{type(failure).__name__}: {failure}"
            missing = dict.fromkeys(names, math.nan)
            return Row(dict(settings), missing, math.nan, n_particles=n_particles, failure=reason), None
        observed = None if self.observe is None else np.asarray(self.observe(run), float)
        row = Row(
            dict(settings),
            self._errors(run, observed),
            cost.seconds,
            cost.compile_seconds,
            int(run.states.step[-1]),
            n_particles,
            cost.memory,
            math.nan if controlled else float(run.time_step),
        )
        return row, observed

    def _errors(self, run, observed) -> dict[str, float]:
        if self.error_of is not None:
            found = self.error_of(run)
            named = found if isinstance(found, Mapping) else {"error": found}
            return {name: float(value) for name, value in named.items()}
        if self.reference is None:
            return {"error": math.nan}  # known only beside other resolutions: see recommend
        expected = self._expected()
        if expected.shape != observed.shape:
            raise ValueError(f"observe gave the shape {observed.shape}, the reference has {expected.shape}")
        return {"error": distance(observed, expected)}

    def _expected(self) -> np.ndarray:
        if not isinstance(self.reference, Mapping):
            return np.asarray(self.reference, float)
        if self._finest is None:
            finer = Study(self.scene_of, self.t_end, self.save_every, observe=self.observe, options=self.options)
            row, observed = finer.measure(self.reference)
            if observed is None:
                raise ValueError(f"the reference run failed: {row.failure}")
            self._finest = observed
            return observed
        return self._finest


def distance(a, b) -> float:
    """|a - b| / |b|, of two arrays of one shape."""
    return float(np.linalg.norm(np.ravel(a - b)) / np.linalg.norm(np.ravel(b)))


def line(row: Row) -> str:
    """A run on the screen."""
    about = ", ".join(f"{name} {value}" for name, value in row.settings.items() if value is not None)
    if row.failure:
        return f"{about}: {row.failure}"
    errors = "  ".join(f"{name} {value:.3g}" for name, value in row.errors.items())
    return (
        f"{about}: {errors}  {row.seconds:.3g} s (+ {row.compile_seconds:.2g} s compiling)  {row.steps} steps, "
        f"{row.n_particles} particles, {row.particle_steps / row.seconds / 1e6:.3g} M particle-steps/s"
    )
