"""The result of a fit: printed, plotted, saved."""

from __future__ import annotations

import dataclasses
import json
import pathlib
from typing import Any

import numpy as np

from inverse.uncertainty import Uncertainty

SHOWN = 12  # unknowns listed in the printed table


def figure_for(path: pathlib.Path, size: tuple[float | int, float | int]) -> Any:
    """An empty figure of a size [inches] to be saved at a path.

    Raises ImportError without matplotlib, FileNotFoundError without the directory, both with the cure.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install 'jaxsph[plot]'", name="matplotlib") from error
    if not path.parent.is_dir():
        raise FileNotFoundError(f"directory {path.parent} of the picture {path.name} does not exist; create it first")
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found. Vectors (n,) follow `labels`; series have the shape of the data, (T,) or (T, m).

    Attributes:
        values: {name: number or array}. `fit["name"]` is the same.
        uncertainty: standard errors, correlations, verdict; None where `messages` says why.
        residuals: (simulated - observed) / standard deviation (or / the signal's rms where no noise was
        given).
        cost: 0.5 * the sum of their squares.
        simulation_runs: executions of the simulator, those that carried derivatives included. tangent_runs:
            forward-mode directions carried along; adjoint_runs: reverse sweeps.
        seconds: everything; compile_seconds and run_seconds are parts of it.
        sensitivity: (T m, n) derivative of the simulated series by the values, at the values found; None where it
            was not computed.
        history: one dictionary per trial, for which secants and scans make several runs: run, cost, values, accepted,
            window [s], samples, note, seconds.

    """

    method: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: dict[str, Any]
    vector: np.ndarray
    start: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    uncertainty: Uncertainty | None
    converged: bool
    message: str
    messages: tuple[str, ...]
    cost: float
    times: np.ndarray
    columns: tuple[str, ...]
    observed: np.ndarray
    simulated: np.ndarray
    standard_deviations: np.ndarray | None
    residuals: np.ndarray
    sensitivity: np.ndarray | None
    history: list[dict[str, Any]]
    simulation_runs: int
    tangent_runs: int
    adjoint_runs: int
    seconds: float
    compile_seconds: float
    run_seconds: float

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    @property
    def iterations(self) -> int:
        """Accepted steps."""
        return sum(entry["accepted"] for entry in self.history) - 1

    def shift(self, simulated: Any) -> dict[str, float]:
        """By how much the unknowns would move if the simulator gave another series at the values found.

        To first order, by least squares: what a finer resolution (another time step, another model) changes in
        the series, in the unit of the unknowns. The bias that the standard error knows nothing of.

        Args:
            simulated: the other series (T,) or (T, m).

        Raises:
            ValueError: a shape that differs from the data, or a fit without sensitivities.
        """
        if self.sensitivity is None:
            raise ValueError("this fit has no sensitivities (too many unknowns); fit with method='gauss-newton'")
        simulated = np.asarray(simulated, float)
        if simulated.shape != self.simulated.shape:
            raise ValueError(f"the series has shape {simulated.shape}; the data have {self.simulated.shape}")
        weight = 1.0 if self.standard_deviations is None else 1.0 / self.standard_deviations.reshape(-1)
        change = (simulated - self.simulated).reshape(-1) * weight
        weighted = self.sensitivity * np.reshape(weight, (-1, 1) if np.ndim(weight) else ())
        move = -np.linalg.lstsq(weighted, change, rcond=None)[0]
        return dict(zip(self.labels, move.tolist(), strict=True))

    @property
    def standard_errors(self) -> dict[str, float]:
        """{label: standard error scaled by the residual}; empty where none could be given."""
        if self.uncertainty is None:
            return {}
        return dict(zip(self.labels, self.uncertainty.standard_error.tolist(), strict=True))

    @property
    def verdict(self) -> str:
        """What `uncertainty.verdict` says, "unknown" without standard errors."""
        return "unknown" if self.uncertainty is None else self.uncertainty.verdict

    def __str__(self) -> str:
        u = self.uncertainty
        width = max(len("unknown"), *(len(label) for label in self.labels[:SHOWN]))
        lines = [f"{'unknown':<{width}}  {'value':>13}  {'std. error':>10}  {'relative':>8}  {'start':>10}"]
        for i, label in enumerate(self.labels[:SHOWN]):
            error = f"{u.standard_error[i]:10.2g}  {100 * u.relative_error[i]:6.2g} %" if u else f"{'-':>10}  {'-':>8}"
            side = f"  at its {u.at_bound[i]} bound" if u and u.at_bound[i] else ""
            lines.append(
                f"{label:<{width}}  {self.vector[i]:13.7g}  {error}  {self.start[i]:10.4g}  "
                f"{self.units[i]}{side}".rstrip()
            )
        if len(self.labels) > SHOWN:
            lines.append(f"... and {len(self.labels) - SHOWN} more")
        misfit = np.sqrt(np.mean((self.simulated - self.observed) ** 2))
        lines.append(f"{self.verdict}; misfit {misfit:.3g} (rms)" + self._noise())
        lines.append(f"{self.method}: {self.message}")
        lines.append(
            f"{self.simulation_runs} runs ({self.tangent_runs} tangents, {self.adjoint_runs} adjoints), "
            f"{self.seconds:.1f} s, {self.compile_seconds:.1f} s of them compiling"
        )
        return "\n".join(lines + [f"! {message}" for message in self.messages])

    def _noise(self) -> str:
        u = self.uncertainty
        if u is None or u.chi_square_interval is None:
            return ", noise estimated from it"
        low, high = u.chi_square_interval
        consistent = "consistent" if low <= u.reduced_chi_square <= high else "not consistent"
        return f", reduced chi-square {u.reduced_chi_square:.3g} ({consistent} with 1: {low:.2f}-{high:.2f})"

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """Everything but the series, in types that JSON knows; numbers that are not finite become None."""
        summary: dict[str, Any] = {
            "method": self.method,
            "converged": self.converged,
            "message": self.message,
            "verdict": self.verdict,
            "messages": list(self.messages),
            "values": {k: np.asarray(v).tolist() for k, v in self.values.items()},
            "start": dict(zip(self.labels, self.start.tolist(), strict=True)),
            "standard_errors": self.standard_errors,
            "units": dict(zip(self.labels, self.units, strict=True)),
            "cost": self.cost,
            "iterations": self.iterations,
            "simulation_runs": self.simulation_runs,
            "tangent_runs": self.tangent_runs,
            "adjoint_runs": self.adjoint_runs,
            "seconds": self.seconds,
            "compile_seconds": self.compile_seconds,
            "run_seconds": self.run_seconds,
            "history": self.history,
        }
        if self.uncertainty is not None:
            summary["uncertainty"] = {
                field.name: getattr(self.uncertainty, field.name) for field in dataclasses.fields(self.uncertainty)
            }
        return _plain(summary)

    def save(self, path: Any) -> pathlib.Path:
        """Write HDF5: the series as datasets, the history as a table, the summary as JSON in the attribute
        "summary".
        """
        import h5py

        path = pathlib.Path(path)
        with h5py.File(path, "w") as file:
            file.attrs["summary"] = json.dumps(self.to_dict())
            for name in ("times", "observed", "simulated", "residuals", "vector", "start"):
                file[name] = getattr(self, name)
            if self.standard_deviations is not None:
                file["standard_deviations"] = self.standard_deviations
            file["times"].attrs["unit"] = "s"
            file["observed"].attrs["columns"] = list(self.columns)
            file["vector"].attrs["labels"] = list(self.labels)
            if self.uncertainty is not None:
                file["covariance"] = self.uncertainty.covariance
            for name in ("run", "cost", "accepted", "window", "seconds", "values"):
                file[f"history/{name}"] = np.asarray([entry[name] for entry in self.history])
        return path

    def plot(self, path: Any) -> pathlib.Path:
        """Draw data and fit, the residual, and the history of unknowns and cost; the format follows the
        suffix.
        """
        path = pathlib.Path(path)
        figure = figure_for(path, (8, 9))
        top, middle, bottom = figure.subplots(3, 1, height_ratios=(2, 1, 1.4))
        shape = (len(self.times), -1)
        observed, simulated = self.observed.reshape(shape), self.simulated.reshape(shape)
        residuals = self.residuals.reshape(shape)
        for i, name in enumerate(self.columns):
            top.plot(
                self.times,
                observed[:, i],
                ".",
                color=f"C{i}",
                markersize=4,
                alpha=0.6,
                label=f"{name} measured",
            )
            top.plot(self.times, simulated[:, i], "-", color=f"C{i}", linewidth=1.2, label=f"{name} simulated")
            middle.plot(self.times, residuals[:, i], ".-", color=f"C{i}", markersize=3, linewidth=0.6)
        top.set(ylabel="observed quantity", title=self._title())
        top.legend(fontsize=8)
        middle.axhline(0.0, color="0.5", linewidth=0.8)
        noise = "noise" if self.standard_deviations is not None else "signal"
        middle.set(xlabel="time [s]", ylabel=f"residual / {noise}")
        runs = np.array([entry["run"] for entry in self.history])
        costs = np.array([entry["cost"] for entry in self.history])
        shown = np.isfinite(costs)
        bottom.semilogy(runs[shown], np.maximum(costs[shown], 1e-300), "k.-", label="cost")
        bottom.xaxis.get_major_locator().set_params(integer=True)
        bottom.set(xlabel="simulation runs", ylabel="cost 0.5 sum r^2")
        side = bottom.twinx()
        lower, upper = self.bounds
        tracks = np.array([entry["values"] for entry in self.history])
        for i in range(min(len(self.labels), 6)):
            within = (tracks[:, i] - lower[i]) / (upper[i] - lower[i])
            if lower[i] > 0 and upper[i] > 30 * lower[i]:
                within = np.log(tracks[:, i] / lower[i]) / np.log(upper[i] / lower[i])
            side.plot(runs, within, "--", color=f"C{i + 1}", linewidth=1, label=self.labels[i])
        side.set(ylabel="unknowns, from lower to upper bound", ylim=(-0.05, 1.05))
        side.legend(fontsize=8, loc="upper right")
        path = pathlib.Path(path)
        figure.savefig(path, dpi=150)
        return path

    def _title(self) -> str:
        u, value = self.uncertainty, f"{self.labels[0]} = {self.vector[0]:.5g}"
        error = f" +- {u.standard_error[0]:.2g}" if u else ""
        return f"{value}{error} {self.units[0]}".rstrip() + f", {self.verdict}, {self.simulation_runs} runs"


def _plain(item: Any) -> Any:
    """JSON types all the way down."""
    if isinstance(item, dict):
        return {str(key): _plain(value) for key, value in item.items()}
    if isinstance(item, (list, tuple)):
        return [_plain(value) for value in item]
    if isinstance(item, np.ndarray):
        return _plain(item.tolist())
    if isinstance(item, np.generic):
        return _plain(item.item())
    if isinstance(item, float) and not np.isfinite(item):
        return None
    return item
