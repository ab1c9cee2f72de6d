"""What a step of a scene compiles to, from the lowered program: operations, loops over pairs, gathered fields."""

import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

import jaxsph as sph
from jaxsph.dynamics import Order, place_boundaries, prepare
from jaxsph.structure import topology
from jaxsph.surroundings import pairs_of

SLOTS = 5  # of lists of which only the shapes matter

GATHER = re.compile(r"stablehlo\.gather.* -> tensor<([0-9x]+)x(complex<)?(?:f32|f64)>")
OPERATION = re.compile(r"\b(stablehlo\.\w+|func\.call)")


def numbers(shapes: Iterable[tuple[int, ...]]) -> Counter:
    """What fields (..., N) hold: by N, how many numbers for each particle."""
    total = Counter()
    for *components, n in shapes:
        total[n] += math.prod(components)
    return total


@dataclass
class Program:
    """A function of a scene, lowered but not compiled. JAX has left out what leads to no result."""

    lowered: jax.stages.Lowered
    state: dict

    @cached_property
    def text(self) -> str:
        return self.lowered.as_text()

    @cached_property
    def operations(self) -> Counter:
        return Counter(OPERATION.findall(self.text))

    @property
    def size(self) -> int:
        """Number of operations in the text; a loop's body counts once."""
        return sum(self.operations.values())

    @property
    def passes(self) -> int:
        """Loops over pairs: every one gathers positions."""
        return self.operations["stablehlo.while"]

    @property
    def gathered(self) -> Counter:
        """Numbers gathered in all passes together, by how many particles gather them; a vector is d numbers.

        Complex fields are pairs of real ones.
        """
        return numbers(
            (2 if pairs else 1, *(int(n) for n in found.split("x"))) for found, pairs in GATHER.findall(self.text)
        )

    @property
    def n_gathers(self) -> int:
        return len(GATHER.findall(self.text))

    @cached_property
    def cost(self) -> dict:
        return dict(self.lowered.cost_analysis() or {})


def neighbors(n: int, senders: int | None = None) -> sph.PairList:
    """A list of one set of n particles, or of two, as shapes."""

    def of(k):
        return jax.ShapeDtypeStruct((SLOTS, k), np.int32), jax.ShapeDtypeStruct((k,), np.int32)

    return sph.PairList(*of(n), None if senders is None else sph.PairList(*of(senders)))


def inputs(scene):
    """References, columns of the state and neighbor lists of a scene, as shapes."""
    found = {s.name: topology(s) for s in scene.structures}
    found |= {s.name: Order.of(np.arange(s.n_particles)) for s in [*scene.fluids, *scene.walls]}
    references = jax.eval_shape(lambda: prepare(scene, found))
    state = jax.eval_shape(lambda: sph.initial_state(scene)).systems
    columns = {
        name: {k: jax.ShapeDtypeStruct((*v.shape[1:], v.shape[0]), v.dtype) for k, v in fields.items()}
        for name, fields in state.items()
    }
    n = {s.name: s.n_particles for s in scene.systems}
    lists = {f"{a}-{b}": neighbors(n[a], None if a == b else n[b]) for a, b in pairs_of(scene)} if scene.fluids else {}
    return references, columns, lists


def step(scene) -> Program:
    """One step of a run."""
    references, columns, lists = inputs(scene)
    time = jax.ShapeDtypeStruct((), scene.dtype)

    def one(scene, references, columns, lists, time, time_step):
        return sph.KickDriftKick().step(scene, references, columns, lists, time, time_step, forward_mode=True)

    return Program(jax.jit(one).lower(scene, references, columns, lists, time, time), columns)


def lower(function, scene) -> Program:
    """function(scene, references, columns, lists, placed) with walls where they are at the start."""
    references, columns, lists = inputs(scene)

    def at_start(scene, references, columns, lists):
        placed = place_boundaries(scene, references, columns, jnp.zeros((), scene.dtype))
        return function(scene, references, columns, lists, placed)

    return Program(jax.jit(at_start).lower(scene, references, columns, lists), columns)
