"""What a run returns."""

from __future__ import annotations

from collections.abc import Callable
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

        Of a structure, a particle that lies there is taken; otherwise the surrounding ones by moving least squares,
        exact for affine displacements. Of a fluid, whose particles part, it is the particle that was nearest at the
        start of the scene; in a periodic domain it must go less than half a period from save to save.

        Raises ValueError if no particle is within two spacings, of a fluid within one; or of a wall.
        """
        fields, system = self[name], self.scene[name]
        if "displacement" not in fields:
            if "acceleration" not in fields:
                raise ValueError(f"{name!r} is a wall, which moves as prescribed; probe a fluid or a structure")
            return self._particle(fields, nearest(system.particles, at), system.particles.positions)
        particles, weights = interpolation(system.particles, at)
        pick = lambda field: jnp.einsum("p,tpd->td", jnp.asarray(weights, field.dtype), field[:, particles])  # noqa: E731
        return Probe(self.times, *(pick(fields[k]) for k in ("displacement", "velocity", "acceleration")))

    def _particle(self, fields, index, start) -> Probe:
        position = fields["position"][:, index]
        before = jnp.concatenate([jnp.asarray(start)[index][None], position[:-1]])
        displacement = jnp.cumsum(self.scene.displacement(position.T, before.T).T, axis=0)
        return Probe(self.times, displacement, fields["velocity"][:, index], fields["acceleration"][:, index])

    def observe(self, function: Callable[[Any, State], Any]) -> Any:
        """What function(scene, state) gives for every saved state, with a time axis in front; one state after another.

        `jaxsph.observe` has such functions: run.observe(jaxsph.observe.energies).
        """
        return jax.lax.map(jax.checkpoint(lambda state: function(self.scene, state)), self.states)

    def at(self, times) -> Trajectory:
        """The trajectory at other times (T',) [s] within the run.

        Of structures by cubic Hermite interpolation: fourth order for displacements, with the velocities as slopes, and
        for velocities, with the accelerations. Of fluids positions alike, to the nearest image in a periodic domain;
        linearly if they are shifted, since they do not follow their velocity then. Their velocities and all other
        fields are linear, because sound makes their slopes rough. Moving walls are where their motion puts them.

        Raises ValueError for times outside the run; of a run that is traced, whose times are not known, what would be
        outside is not a number.
        """
        wanted = np.asarray(times, float)
        n_saved = self.times.shape[0]
        if not is_concrete(self.times):
            start, every = jnp.asarray(self.times[0]), self.times[1] - self.times[0]
            index = jnp.clip(jnp.floor((wanted - start) / every + 1e-6).astype(int), 0, n_saved - 2)
            fraction = (wanted - start) / every - index
            slack = 1e-5 + 1e-6 * jnp.abs(self.times[-1]) / every
            fraction = jnp.where((fraction >= -slack) & (fraction <= 1 + slack), fraction, jnp.nan)
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
        fraction, every = jnp.asarray(fraction, dtype), jnp.asarray(every, dtype)

        def along(value):
            return fraction.reshape(-1, *[1] * (value.ndim - 1))

        def linear(value):
            return (1 - along(value)) * value[index] + along(value) * value[index + 1]

        def hermite(value, slope, rise=None):
            f, low = along(value), value[index]
            rise = value[index + 1] - low if rise is None else rise
            bend = (1 - f) * (every * slope[index] - rise) - f * (every * slope[index + 1] - rise)
            return low + f * rise + f * (1 - f) * bend

        systems = {}
        for name, fields in self.states.systems.items():
            systems[name] = {field: linear(value) for field, value in fields.items()}
            if "displacement" in fields:
                systems[name]["displacement"] = hermite(fields["displacement"], fields["velocity"])
                systems[name]["velocity"] = hermite(fields["velocity"], fields["acceleration"])
            elif "acceleration" in fields:
                path = fields["position"]
                axis_first = lambda value: jnp.moveaxis(value, -1, 0)  # noqa: E731
                rise = self.scene.displacement(axis_first(path[index + 1]), axis_first(path[index]))
                rise = jnp.moveaxis(rise, 0, -1)
                shifted = "shift" in fields
                place = path[index] + along(path) * rise if shifted else hermite(path, fields["velocity"], rise)
                if self.scene.domain is not None:
                    place = jnp.moveaxis(self.scene.domain.wrap(axis_first(place)), 0, -1)
                systems[name]["position"] = place
            elif "position" in fields:
                wall, start = self.scene[name], jnp.asarray(self.scene[name].particles.positions).T
                place, speed, _ = jax.vmap(lambda t, wall=wall, start=start: wall.placed(start, t))(
                    jnp.asarray(wanted, dtype)
                )
                systems[name] |= {"position": place.mT, "velocity": speed.mT}
        remainder = None if self.states.time_remainder is None else jnp.zeros(len(wanted), dtype)
        states = replace(
            self.states,
            time=jnp.asarray(wanted, dtype),
            time_remainder=remainder,
            step=self.states.step[index],
            systems=systems,
            health=jax.tree.map(lambda leaf: leaf[index], self.states.health),
        )
        return replace(self, states=states)

    def animate(self, path, name: str | None = None, **options) -> None:
        """Write a GIF of a system, or of all if none is named; see `jaxsph.plot.animate_trajectory`.

        color="pressure" colors by pressure; by default fluids are colored by pressure, structures by von Mises stress.
        """
        from jaxsph.plot import animate_trajectory

        animate_trajectory(path, self, name, **options)


@pytree_dataclass
class Probe:
    """Motion of one material point: `times` (T,) [s], `displacement`, `velocity`, `acceleration` (T, d)."""

    times: Any
    displacement: Any
    velocity: Any
    acceleration: Any


def nearest(particles, at) -> int:
    """Index of the particle nearest to a place (d,) at the start. Raises ValueError if none is within a spacing."""
    positions, at = np.asarray(particles.positions, np.float64), np.asarray(at, np.float64)
    if at.shape != positions.shape[1:]:
        raise ValueError(f"a point {at} was asked for; it must have {positions.shape[1]} components")
    distance = np.linalg.norm(positions - at, axis=1)
    index = int(np.argmin(distance))
    if distance[index] > particles.spacing:
        raise ValueError(
            f"the particle nearest to {at} is at {positions[index]}, {distance[index]:.4g} m away; a point of the "
            f"fluid is at most a spacing of {particles.spacing:.4g} m from one"
        )
    return index


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
