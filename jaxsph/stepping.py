"""Many steps of a scene: one after the other, between builds of the neighbor lists, and with lists built when due."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxsph import surroundings
from jaxsph.dynamics import place_boundaries, positions_of, velocities_of
from jaxsph.effects import ShepardFilter
from jaxsph.flow import filtered
from jaxsph.state import State

PAUSE, LONGEST_PAUSE = 0.8, 8
"""After which share of the steps that neighbor lists are thought to hold to look at them again, and after how many at
most: a wave that breaks changes velocities fast."""


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """What all steps of one call of `advance` share.

    Attributes:
        scene, references, found: the scene, made ready, and its topologies.
        state: at the start; only its time, step and health are read.
        dt: [s].
        integrator: `KickDriftKick`.
        forward_mode: whether nothing is kept for reverse mode.
        rebuild_every: steps between two builds of the neighbor lists.
        counted: whether the number of steps is known, so that there is a reverse mode.
    """

    scene: Any
    references: dict
    found: dict
    state: State
    dt: Any
    integrator: Any
    forward_mode: bool
    rebuild_every: Any
    counted: bool

    def time_of(self, number):
        """[s], after a number of steps."""
        return self.state.time + number.astype(self.scene.dtype) * self.dt

    def one(self, columns, number, lists=None):
        """Columns after one more step than a number of them."""
        time = self.time_of(number)
        return self.integrator.step(
            self.scene, self.references, columns, lists, time, self.dt, forward_mode=self.forward_mode
        )

    def checkpointed(self, function):
        """A step of which reverse mode keeps little and calculates the rest again."""
        if self.forward_mode or not self.counted:
            return function
        # Not of the many small steps of structures beside fluids.
        names = () if self.scene.fluids else ("displacement_gradient",)
        keep = jax.checkpoint_policies.save_only_these_names(*names)
        return jax.checkpoint(function, policy=keep, prevent_cse=False)

    def positions(self, columns, number):
        """By system, and what boundaries do, after a number of steps."""
        placed = place_boundaries(self.scene, self.references, columns, self.time_of(number))
        return positions_of(self.scene, columns, placed), placed

    def between_builds(self, carry, build):
        """`rebuild_every` steps with the lists of their start, the number of which is counted in builds."""
        columns, health = carry
        first = build * self.rebuild_every
        columns = self.wrapped(columns)
        lists, _ = lists_of(self.scene, self.references, columns, self.found, self.time_of(first))
        assert lists is not None  # this is for scenes in which systems meet
        columns = self.filtered_when_due(columns, lists, first)
        step = self.checkpointed(self.one)
        columns = repeated(lambda columns, number: step(columns, first + number, lists), columns, self.rebuild_every)
        last = first + self.rebuild_every
        places, _ = self.positions(columns, last)
        return columns, surroundings.note(self.scene, health, lists, places, self.state.step + last)

    def with_lists_when_due(self, columns, n_steps, reserve):
        """Columns and health after a number of steps that may be traced, see `advance`."""
        lists = {
            "-".join(pair): self.found["-".join(pair)] for pair in surroundings.pairs_of(self.scene)
        }  # still empty
        plan = dict.fromkeys(lists, jnp.bool_(True)), jnp.int32(1)

        def go_on(carry):
            """Lists that are due built anew, some steps, and a look at how long the lists will hold."""
            columns, lists, (due, pause), health, number = carry
            columns, lists = self.rebuilt_if(due, self.wrapped(columns), lists, number)
            last = jnp.minimum(number + pause, n_steps)
            columns, number = self.until(last, self.filtered_when_due(columns, lists, number), lists, number)
            health, plan = self.look(health, columns, lists, number, reserve)
            return columns, lists, plan, health, number

        carry = (columns, lists, plan, self.state.health, jnp.int32(0))
        columns, _, _, health, _ = jax.lax.while_loop(lambda carry: carry[4] < n_steps, go_on, carry)
        return columns, health

    def rebuilt_if(self, due, columns, lists, number):
        """Columns, and lists of which those that are due are new."""
        positions, _ = self.positions(columns, number)
        for pair in surroundings.pairs_of(self.scene):
            name = "-".join(pair)
            build = lambda _, pair=pair: surroundings.rebuild(self.scene, self.found, positions, [pair])  # noqa: E731
            lists = {**lists, **jax.lax.cond(due[name], build, dict, {name: lists[name]})}
        return columns, lists

    def until(self, last, columns, lists, number):
        """Columns and number of steps when `last` of them are done, or the Shepard filter is due."""
        filters = self.scene.effect(ShepardFilter) is not None

        def once(carry):
            columns, number, _ = carry
            columns, number = self.one(columns, number, lists), number + 1
            enough = number >= last
            return columns, number, enough | self.filter_due(number) if filters else enough

        columns, number, _ = jax.lax.while_loop(lambda carry: ~carry[2], once, (columns, number, jnp.bool_(False)))
        return columns, number

    def look(self, health, columns, lists, number, reserve):
        """What is wrong with the lists, which of them are due, and for how many steps not to look again."""
        positions, placed = self.positions(columns, number)
        steps = {name: self.dt * velocity for name, velocity in velocities_of(self.scene, columns, placed).items()}
        left = surroundings.steps_left(lists, positions, steps, reserve)
        health = surroundings.note(self.scene, health, lists, positions, self.state.step + number, left)
        due = {name: ~(lasts.steps >= 1) for name, lasts in left.items()}
        # Who has just come near others belongs to other regions once lists are new: then one step, and another look.
        shortest = jnp.min(jnp.stack([lasts.steps for lasts in left.values()]))
        pause = jnp.clip(jnp.where(shortest >= 1, shortest * PAUSE, 1), 1, LONGEST_PAUSE).astype(jnp.int32)
        return health, (due, pause)

    def filtered_when_due(self, columns, lists, number):
        """Columns with the density smoothed, if a `ShepardFilter` wants it after a number of steps."""
        if self.scene.effect(ShepardFilter) is None:
            return columns
        smooth = lambda now: filtered(  # noqa: E731
            self.scene, self.references, now, lists, forward_mode=self.forward_mode
        )
        return jax.lax.cond(self.filter_due(number), smooth, dict, columns)

    def filter_due(self, number):
        """At the first multiple of rebuild_every steps at or after one of the filter's."""
        every, shepard = self.rebuild_every, self.scene.effect(ShepardFilter)
        return (number % every == 0) & shepard.due(self.state.step + number, every)

    def wrapped(self, columns):
        """Columns with the positions of fluids within the periodic domain."""
        if self.scene.domain is not None:
            for fluid in self.scene.fluids:
                fields = columns[fluid.name]
                columns = {**columns, fluid.name: {**fields, "position": self.scene.domain.wrap(fields["position"])}}
        return columns


def lists_of(scene, references, columns, found, time):
    """Neighbor lists of the systems that meet, and walls where they are at a time."""
    if not scene.meets:
        return None, None
    placed = place_boundaries(scene, references, columns, time)
    return surroundings.rebuild(scene, found, positions_of(scene, columns, placed)), placed


def repeated(once, carry, n, block=None):
    """What n times carry = once(carry, number) gives; n may be traced.

    In blocks of which only the start is kept for reverse mode, if a block's length is given.
    """
    if not isinstance(n, int):
        return jax.lax.fori_loop(jnp.int32(0), n, lambda number, carry: once(carry, number), carry)

    def several(carry, numbers):
        return jax.lax.scan(lambda carry, number: (once(carry, number), None), carry, numbers)

    numbers = jnp.arange(n, dtype=jnp.int32)
    if block is None:
        return several(carry, numbers)[0]
    whole = n // block * block
    run_block = jax.checkpoint(several, prevent_cse=False)
    carry, _ = jax.lax.scan(run_block, carry, numbers[:whole].reshape(-1, block))
    if whole < n:
        carry, _ = run_block(carry, numbers[whole:])
    return carry
