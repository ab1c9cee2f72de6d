"""The simulator of a problem, compiled once per kind of derivative, counted and timed."""

from __future__ import annotations

import dataclasses
import re
import time

import jax
import jax.numpy as jnp
import numpy as np

from inverse.problem import Problem


class RunFailed(RuntimeError):
    """A simulation stopped, or returned values that are not finite."""


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Residual (T m,) = (model - data) / standard deviation, time-major, and its Jacobian (T m, n) in z.

    beside: of a Jacobian of secants the best of the runs that it was made of, without a Jacobian.
    """

    z: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    beside: Evaluation | None = None

    @property
    def cost(self) -> float:
        return 0.5 * float(self.residual @ self.residual)


class Model:
    """Residuals and derivatives of a problem in internal coordinates.

    Counts `runs` (every execution of the simulator, with or without derivatives), `tangents` (forward-mode
    directions carried along) and `adjoints` (reverse sweeps); keeps compile and run seconds apart.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.simulate = problem.simulate  # the default one is made here: what it takes is not compiling
        self.labels = problem.labels
        data = problem.data
        self.data = data.values.reshape(-1)
        self.width = data.values.size // len(data)
        if data.standard_deviations is None:
            # Unknown noise: any constant will do for the fit; the signal's own size keeps residuals near one.
            spread = float(np.sqrt(np.mean((data.values - np.mean(data.values, axis=0)) ** 2)))
            size = spread or float(np.max(np.abs(data.values)))
            self.deviation = np.full(self.data.shape, size or 1.0)
        else:
            self.deviation = data.standard_deviations.reshape(-1)
        self.runs = self.tangents = self.adjoints = 0
        self.compile_seconds = self.run_seconds = 0.0
        self._compiled: dict[str, jax.stages.Compiled] = problem.programs
        self.precision = float(np.finfo(np.float32).eps)

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Residual and Jacobian from one run with n tangents.

        The tangents share the run (vmap over the directions leaves the primal alone), and a compiled residual
        without tangents would cost a second compilation and a second run at each accepted point: measured
        over the few iterations of a fit, the Jacobian of a rejected point is the cheaper waste.
        """
        x, slopes = self._arrays(self.problem.vector(z), self.problem.slopes(z))
        model, tangents = self._call("forward", self._with_tangents, x, slopes)
        self.tangents += len(z)
        jacobian = tangents.T / self.deviation[:, None]
        residual = self._residual(model)
        if not np.all(np.isfinite(jacobian)):
            raise RunFailed(f"the derivative with respect to {self._first_bad_column(jacobian)} is not finite")
        return Evaluation(np.array(z), residual, jacobian)

    def secants(self, z: np.ndarray, difference: float) -> Evaluation:
        """Residual from one run, and as Jacobian the slopes between runs on both sides, 2 n of them.

        difference: how far from z they are, in internal coordinates; less at a bound.
        """
        lower, upper = self.problem.bounds
        residual, columns, none = self.residual(z), [], np.empty((0, len(z)))
        beside: list[Evaluation] = []
        for direction in np.eye(len(z)):
            ends = [np.clip(z + sign * difference * direction, lower, upper) for sign in (-1, 1)]
            beside += [Evaluation(end, self.residual(end), none) for end in ends]
            columns.append((beside[-1].residual - beside[-2].residual) / np.sum(ends[1] - ends[0]))
        best = min(beside, key=lambda one: one.cost)
        return Evaluation(np.array(z), residual, np.stack(columns, axis=1), best)

    def residual(self, z: np.ndarray) -> np.ndarray:
        """(T m,) residual from a run without derivatives."""
        (x,) = self._arrays(self.problem.vector(z))
        (model,) = self._call("value", lambda x: (self.problem.model(x, "forward"),), x)
        return self._residual(model)

    def cost_and_gradient(self, z: np.ndarray, weights: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """0.5 sum w r^2, its gradient (n,) in z by reverse mode, and the residual (T m,); weights (T m,)."""
        vector, slopes = self.problem.vector(z), self.problem.slopes(z)
        arguments = self._arrays(vector, slopes, weights, self.data, self.deviation)
        model, gradient = self._call("reverse", self._with_gradient, *arguments)
        self.adjoints += 1
        residual = self._residual(model)
        if not np.all(np.isfinite(gradient)):
            raise RunFailed(f"the derivative with respect to {self._first_bad_column(gradient[None])} is not finite")
        return 0.5 * float(np.sum(weights * residual**2)), gradient, residual

    def explain(self, z: np.ndarray, reason: str) -> str:
        """Run once more outside of jit, where a simulator can raise, to learn why a run failed."""
        problem = self.problem
        scene = problem.replace(problem.scene, problem.values(z))
        try:
            problem.simulate(scene, problem.data.times, "forward")
        except (RuntimeError, ValueError, ArithmeticError) as error:
            return f"{type(error).__name__}: {error}"
        return reason

    def _with_tangents(self, x, slopes):
        def directional(tangent):
            return jax.jvp(lambda x: self.problem.model(x, "forward"), (x,), (tangent,))

        models, tangents = jax.vmap(directional)(jnp.diag(slopes))
        return models[0], tangents

    def _with_gradient(self, x, slopes, weights, data, deviation):
        def cost(x):
            model = self.problem.model(x, "reverse")
            return 0.5 * jnp.sum(weights * ((model - data) / deviation) ** 2), model

        gradient, model = jax.grad(cost, has_aux=True)(x)
        return model, gradient * slopes

    def _arrays(self, *arrays: np.ndarray) -> list[jax.Array]:
        return [jnp.asarray(a, dtype=jnp.result_type(float)) for a in arrays]

    def _call(self, kind, function, *arguments) -> tuple[np.ndarray, ...]:
        if kind not in self._compiled:
            begin = time.perf_counter()
            self._compiled[kind] = jax.jit(function).lower(*arguments).compile()
            self.compile_seconds += time.perf_counter() - begin
        self.runs += 1
        begin = time.perf_counter()
        try:
            result = jax.block_until_ready(self._compiled[kind](*arguments))
        except (RuntimeError, ArithmeticError) as error:  # raised by a callback of the simulator
            raise RunFailed(_sentence(error)) from error
        finally:
            self.run_seconds += time.perf_counter() - begin
        self.precision = float(jnp.finfo(result[0].dtype).eps)
        return tuple(np.asarray(part, dtype=float) for part in result)

    def _residual(self, model: np.ndarray) -> np.ndarray:
        bad = np.flatnonzero(~np.isfinite(model))
        if bad.size:
            sample, column = divmod(int(bad[0]), self.width)
            raise RunFailed(
                f"the simulated {self.problem.data.columns[column]} is not finite from "
                f"t = {self.problem.data.times[sample]:g} s on"
            )
        return (model - self.data) / self.deviation

    def _first_bad_column(self, jacobian: np.ndarray) -> str:
        return self.labels[int(np.flatnonzero(~np.all(np.isfinite(jacobian), axis=0))[0])]


def _sentence(error: Exception) -> str:
    """What an error says, without the traceback that jax wraps around the errors of callbacks."""
    lines = str(error).splitlines()
    said = [line for line in lines if re.match(r"[A-Za-z_][\w.]*: \S", line)]
    return said[-1].split(": ", 1)[1] if said and len(lines) > 1 else str(error)
