"""The physics of a pair written out in components, every one of them a number of its own.

For XLA a vector of two or three components is a short axis: a loop over particles that reads one is not vectorised, and
what several components share is computed again for each. Written out, all that is left are long arrays over particles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

_EACH_BY_ITSELF = {
    "abs", "acos", "acosh", "add", "add_any", "and", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil",
    "clamp", "convert_element_type", "copy", "cos", "cosh", "digamma", "div", "eq", "erf", "erf_inv", "erfc",
    "exp", "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "lgamma", "log", "log1p",
    "logistic", "lt", "max", "min", "mul", "ne", "neg", "nextafter", "not", "or", "pow", "rem", "round",
    "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "stop_gradient", "sub", "tan", "tanh", "xor",
}  # fmt: skip
_INNER = {
    "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "jit": "jaxpr",
    "pjit": "jaxpr", "checkpoint": "jaxpr", "core_call": "call_jaxpr",
}  # fmt: skip
_FOLD = {"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_prod": "mul"}


def split(value: Any) -> np.ndarray:
    """The components of an array of one particle, as an array of numbers."""
    parts = np.empty(np.shape(value), object)
    for index in np.ndindex(parts.shape):
        parts[index] = value[index] if index else value
    return parts


def join(parts: np.ndarray) -> Any:
    """The array of these components."""
    if not parts.shape:
        return parts[()]
    return jnp.stack([jnp.asarray(part) for part in parts.ravel()]).reshape(parts.shape)


def in_components(f: Callable, single: tuple, constants: Any, keep_rules: bool = False):
    """A function of one pair, f(a, b, edge, constants), as a function of lists of components of a, b and edge.

    Args:
        f: returns a pytree of arrays.
        single: shapes of the fields of a, b and edge, without axes of particles and slots.
        constants: traced or not.
        keep_rules: see `evaluate`.

    Returns:
        The function, the structure and shapes of what f returns, and for each component of b whether f reads it. One
        that it does not read may be None.
    """
    closed, out = jax.make_jaxpr(f, return_shape=True)(*single, constants)
    fixed = [split(leaf) for leaf in jax.tree.leaves(constants)]
    leaves = jax.tree.leaves(single)

    def of_components(*lists):
        numbers = iter([number for each in lists for number in each])
        arguments = [_filled(numbers, leaf.shape) for leaf in leaves]
        return [number for one in evaluate(closed, [*arguments, *fixed], keep_rules) for number in one.ravel()]

    shapes, structure = jax.tree.flatten(out)
    read = {v for e in closed.jaxpr.eqns for v in e.invars if not isinstance(v, Literal)}
    read |= {v for v in closed.jaxpr.outvars if not isinstance(v, Literal)}
    first, last = len(jax.tree.leaves(single[0])), len(jax.tree.leaves(single[:2]))
    of_b = zip(closed.jaxpr.invars[first:last], leaves[first:last], strict=True)
    read_of_b = [variable in read for variable, leaf in of_b for _ in range(math.prod(leaf.shape))]
    return of_components, structure, shapes, read_of_b


def components(tree: Any, axes: int = 1) -> list:
    """The components of fields (..., N), each (N,), or with two axes of their own of fields (..., K, N)."""
    return [leaf[index] for leaf in jax.tree.leaves(tree) for index in np.ndindex(leaf.shape[:-axes])]


def _filled(numbers, shape):
    parts = np.empty(shape, object)
    for index in np.ndindex(shape):
        parts[index] = next(numbers)
    return parts


def evaluate(closed: ClosedJaxpr, arguments: list[np.ndarray], keep_rules: bool = False) -> list[np.ndarray]:
    """What a function returns, and takes, in components.

    keep_rules: leave functions with a derivative rule of their own whole, for what is still to be differentiated.
    """
    known: dict[Any, np.ndarray] = {}

    def read(variable):
        return split(np.asarray(variable.val)) if isinstance(variable, Literal) else known[variable]

    known |= zip(closed.jaxpr.constvars, map(split, closed.consts), strict=True)
    known |= zip(closed.jaxpr.invars, arguments, strict=True)
    for equation in closed.jaxpr.eqns:
        results = _apply(closed.jaxpr, equation, [read(variable) for variable in equation.invars], keep_rules)
        known |= zip(equation.outvars, results, strict=True)
    return [read(variable) for variable in closed.jaxpr.outvars]


def _apply(whole, equation, values: list[np.ndarray], keep_rules: bool) -> list[np.ndarray]:
    name, params = equation.primitive.name, equation.params
    if name in _INNER and not (keep_rules and name.startswith("custom")):
        inner = params[_INNER[name]]
        return evaluate(inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, []), values, keep_rules)
    shape = equation.outvars[0].aval.shape
    if name in _EACH_BY_ITSELF:
        out = np.empty(shape, object)
        values = [np.broadcast_to(value, shape) for value in values]
        for index in np.ndindex(shape):
            out[index] = equation.primitive.bind(*[value[index] for value in values], **params)
        return [out]
    if name in _FOLD:
        return [_folded(_FOLD[name], values[0], params["axes"])]
    if name == "broadcast_in_dim":
        placed = [1] * len(shape)
        for axis, size in zip(params["broadcast_dimensions"], values[0].shape, strict=True):
            placed[axis] = size
        return [np.broadcast_to(values[0].reshape(placed), shape)]
    if name in ("reshape", "squeeze", "expand_dims"):
        return [values[0].reshape(shape)]
    if name == "transpose":
        return [values[0].transpose(params["permutation"])]
    if name == "concatenate":
        return [np.concatenate(values, params["dimension"])]
    if name == "slice":
        steps = params["strides"] or (1,) * values[0].ndim
        where = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
        return [values[0][tuple(slice(first, last, step) for first, last, step in where)]]
    if name == "dot_general":
        return [_contracted(values[0], values[1], params["dimension_numbers"]).reshape(shape)]
    return _as_it_stands(whole, equation, values)


def _as_it_stands(whole, equation, values: list[np.ndarray]) -> list[np.ndarray]:
    """Anything else, on whole arrays."""
    given = {v: x for v, x in zip(equation.invars, values, strict=True) if not isinstance(v, Literal)}
    about = whole.debug_info.with_unknown_names()
    alone = ClosedJaxpr(Jaxpr([], list(given), equation.outvars, [equation], debug_info=about), [])
    return [split(one) for one in jaxpr_as_fun(alone)(*map(join, given.values()))]


def _folded(operation: str, values: np.ndarray, axes) -> np.ndarray:
    """Sum, product, largest or smallest over axes."""
    combine = {"add": jax.lax.add, "mul": jax.lax.mul, "max": jax.lax.max, "min": jax.lax.min}[operation]
    kept = [axis for axis in range(values.ndim) if axis not in axes]
    shape = tuple(values.shape[axis] for axis in kept)
    rows = values.transpose(*kept, *axes).reshape(math.prod(shape), -1)
    out = np.empty(len(rows), object)
    for number, row in enumerate(rows):
        total = row[0]
        for part in row[1:]:
            total = combine(total, part)
        out[number] = total
    return out.reshape(shape)


def _contracted(left: np.ndarray, right: np.ndarray, numbers) -> np.ndarray:
    """`dot_general`."""
    (of_left, of_right), (batch_left, batch_right) = numbers

    def arranged(values, contracted, batch):
        free = [axis for axis in range(values.ndim) if axis not in (*contracted, *batch)]
        sizes = [math.prod(values.shape[axis] for axis in axes) for axes in (batch, free, contracted)]
        return values.transpose(*batch, *free, *contracted).reshape(sizes)

    left, right = arranged(left, of_left, batch_left), arranged(right, of_right, batch_right)
    return _folded("add", _products(left[:, :, None], right[:, None]), (3,))


def _products(left, right):
    left, right = np.broadcast_arrays(left, right)
    out = np.empty(left.shape, object)
    for index in np.ndindex(left.shape):
        out[index] = jax.lax.mul(left[index], right[index])
    return out
