"""What a run returns."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.pytree import is_concrete, pytree_dataclass, replace, static
from jaxsph.state import State


@pytree_dataclass
class Trajectory:
    """The saved states of a run.

    Attributes:
        scene: that was run.
        states: a `State` whose arrays have a time axis in front, the start first.
        time_step: that was taken [s].
    """

    scene: Any
    states: State
    time_step: float = static()

    @property
    def times(self):
        """Times of the saved states (T,) [s]."""
        return self.states.time

    @property
    def final(self) -> State:
        """The last state, from which another run can continue."""
        return jax.tree.map(lambda leaf: leaf[-1], self.states)

    def __getitem__(self, name: str) -> dict:
        """Fields of a system, (T, N, ...)."""
        self.scene[name]
        return self.states.systems[name]

    def positions(self, name: str):
        """Positions of the particles of a system, (T, N, d) [m]."""
        fields, rest = self[name], jnp.asarray(self.scene[name].particles.positions)
        if "displacement" in fields:
            return rest + fields["displacement"]
        return fields["position"] if "position" in fields else jnp.broadcast_to(rest, (len(self.times), *rest.shape))

    def probe(self, name: str, at) -> Probe:
        """Motion of the material point that is at a place (d,) [m] in the reference configuration.

        A particle that lies there is taken; otherwise the surrounding ones by moving least squares, exact for
        affine displacements.

        Raises ValueError if no particle is within two spacings.
        """
        particles, weights = interpolation(self.scene[name].particles, at)
        pick = lambda field: jnp.einsum("p,tpd->td", jnp.asarray(weights, field.dtype), field[:, particles])  # noqa: E731
        fields = self[name]
        return Probe(self.times, *(pick(fields[k]) for k in ("displacement", "velocity", "acceleration")))

    def at(self, times) -> Trajectory:
        """The trajectory at other times (T',) [s] within the run, by cubic Hermite interpolation.

        Fourth order for displacements, with the velocities as slopes, and for velocities, with the accelerations.

        Raises ValueError for times outside the run.
        """
        wanted = np.asarray(times, float)
        n_saved = self.times.shape[0]
        if not is_concrete(self.times):
            start, every = jnp.asarray(self.times[0]), self.times[1] - self.times[0]
            index = jnp.clip(jnp.floor((wanted - start) / every + 1e-6).astype(int), 0, n_saved - 2)
            fraction = (wanted - start) / every - index
        else:
            saved = np.asarray(self.times, float)
            every = saved[1] - saved[0]
            slack = 1e-5 * every + 1e-6 * abs(saved[-1])
            if wanted.size and (wanted.min() < saved[0] - slack or wanted.max() > saved[-1] + slack):
                raise ValueError(
                    f"times from {wanted.min():g} to {wanted.max():g} s were asked for; the run has {saved[0]:g} to "
                    f"{saved[-1]:g} s"
                )
            index = np.clip(np.floor((wanted - saved[0]) / every + 1e-6).astype(int), 0, n_saved - 2)
            fraction = (wanted - saved[0]) / every - index
        dtype = self.times.dtype
        fraction, every = jnp.asarray(fraction, dtype)[:, None, None], jnp.asarray(every, dtype)

        def hermite(value, slope):
            f = fraction
            low, high = value[index], value[index + 1]
            rise = high - low
            bend = (1 - f) * (every * slope[index] - rise) - f * (every * slope[index + 1] - rise)
            return low + f * rise + f * (1 - f) * bend

        systems = {}
        for name, fields in self.states.systems.items():
            acceleration = fields["acceleration"]
            systems[name] = {
                "displacement": hermite(fields["displacement"], fields["velocity"]),
                "velocity": hermite(fields["velocity"], acceleration),
                "acceleration": (1 - fraction) * acceleration[index] + fraction * acceleration[index + 1],
            }
        states = replace(
            self.states,
            time=jnp.asarray(wanted, dtype),
            step=self.states.step[index],
            systems=systems,
            health=jax.tree.map(lambda leaf: leaf[index], self.states.health),
        )
        return replace(self, states=states)

    def animate(self, path, name: str | None = None, **options) -> None:
        """Write a GIF of a system (the first if not named), colored by von Mises stress; see `jaxsph.plot.animate`."""
        from jaxsph.plot import animate_trajectory

        animate_trajectory(path, self, self.scene.systems[0].name if name is None else name, **options)


@pytree_dataclass
class Probe:
    """Motion of one material point: `times` (T,) [s], `displacement`, `velocity`, `acceleration` (T, d)."""

    times: Any
    displacement: Any
    velocity: Any
    acceleration: Any


def interpolation(particles, at) -> tuple[np.ndarray, np.ndarray]:
    """Indices and weights of the particles that stand for a place (d,) in the reference configuration.

    Raises ValueError if no particle is within two spacings, or too few to interpolate.
    """
    positions = np.asarray(particles.positions, np.float64)
    at = np.asarray(at, np.float64)
    if at.shape != positions.shape[1:]:
        raise ValueError(f"a point {at} was asked for; it must have {positions.shape[1]} components")
    spacing = particles.spacing
    offset = (positions - at) / spacing
    distance = np.linalg.norm(offset, axis=1)
    nearest = int(np.argmin(distance))
    if distance[nearest] < 1e-4:
        return np.array([nearest]), np.ones(1)
    near = np.flatnonzero(distance < 2.0)
    if len(near) <= positions.shape[1]:
        raise ValueError(
            f"{len(near)} particles are within two spacings of {at}; the nearest is at {positions[nearest]}, "
            f"{distance[nearest] * spacing:.4g} m away"
        )
    basis = np.concatenate([np.ones((len(near), 1)), offset[near]], axis=1)
    closeness = (1 - distance[near] / 2.0) ** 2
    moment = basis.T @ (closeness[:, None] * basis)
    if np.linalg.cond(moment) > 1e8:
        raise ValueError(f"the particles around {at} lie on a line; a point outside of it can't be interpolated")
    return near, closeness * (basis @ np.linalg.solve(moment, np.eye(len(moment))[0]))
