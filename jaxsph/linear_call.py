"""A linear map with its own transpose, as one JAX primitive.

`jax.custom_derivatives.linear_call` does this without a rule for `vmap`, and cannot be differentiated with
respect to what the map is made of. This one has both, so that reverse mode (which transposes the map), batches
of simulations, and forward over reverse mode (Hessian-vector products) work through `pair_sum`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_primitive = Primitive("linear_call_with_transpose")
_primitive.multiple_results = True


def linear_call(forward: Callable, transpose: Callable, residual: Any, linear: Any) -> Any:
    """forward(residual, linear), whose transpose with respect to `linear` is transpose(residual, cotangent).

    Args:
        forward: function of (residual, linear), linear in its second argument.
        transpose: function of (residual, cotangent of what forward returns), returning the structure of `linear`.
        residual: pytree of arrays that the map is made of. Neither function may close over traced values.
        linear: pytree of arrays.
    """
    residual_leaves, residual_tree = jax.tree.flatten(residual)
    linear_leaves, linear_tree = jax.tree.flatten(linear)
    out_tree = jax.tree.structure(jax.eval_shape(forward, residual, linear))

    def flat(function, tree_in, tree_out):
        def on_leaves(residual_leaves, leaves):
            out = function(jax.tree.unflatten(residual_tree, residual_leaves), jax.tree.unflatten(tree_in, leaves))
            if jax.tree.structure(out) != tree_out:
                raise TypeError(f"expected the structure {tree_out}, got {jax.tree.structure(out)}")
            return jax.tree.leaves(out)

        return on_leaves

    out = _primitive.bind(
        *residual_leaves,
        *linear_leaves,
        forward=flat(forward, linear_tree, out_tree),
        transpose=flat(transpose, out_tree, linear_tree),
        n_residual=len(residual_leaves),
    )
    return jax.tree.unflatten(out_tree, out)


def _evaluate(*leaves, forward, transpose, n_residual):
    del transpose
    return forward(list(leaves[:n_residual]), list(leaves[n_residual:]))


def _abstract(*leaves, forward, transpose, n_residual):
    del transpose
    shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    out = jax.eval_shape(lambda r, x: forward(r, x), shapes[:n_residual], shapes[n_residual:])
    return [ShapedArray(leaf.shape, leaf.dtype) for leaf in out]


def _differentiate(primals, tangents, *, forward, transpose, n_residual):
    parameters = {"forward": forward, "transpose": transpose, "n_residual": n_residual}
    residual, linear = list(primals[:n_residual]), list(primals[n_residual:])
    out = _primitive.bind(*primals, **parameters)
    moved = [ad.instantiate_zeros(t) for t in tangents[n_residual:]]
    out_tangents = _primitive.bind(*residual, *moved, **parameters)
    changing = [i for i, t in enumerate(tangents[:n_residual]) if not isinstance(t, ad.Zero)]
    if changing:

        def of_changing(values):
            merged = list(residual)
            for i, value in zip(changing, values, strict=True):
                merged[i] = value
            return forward(merged, linear)

        extra = jax.jvp(of_changing, ([residual[i] for i in changing],), ([tangents[i] for i in changing],))[1]
        out_tangents = [a + b for a, b in zip(out_tangents, extra, strict=True)]
    return out, out_tangents


def _swap(cotangents, *leaves, forward, transpose, n_residual):
    residual = leaves[:n_residual]
    given = [ad.instantiate_zeros(c) for c in cotangents]
    out = _primitive.bind(*residual, *given, forward=transpose, transpose=forward, n_residual=n_residual)
    return [None] * n_residual + list(out)


def _batch(leaves, axes, *, forward, transpose, n_residual):
    size = next(leaf.shape[axis] for leaf, axis in zip(leaves, axes, strict=True) if axis is not None)
    residual_axes = [0 if axis is not None else None for axis in axes[:n_residual]]
    front = [leaf if axis is None else jnp.moveaxis(leaf, axis, 0) for leaf, axis in zip(leaves, axes, strict=True)]
    # Every linear input gets the batch axis, so that the transpose need not sum over the batch.
    linear = [
        jnp.broadcast_to(leaf, (size, *leaf.shape)) if axis is None else leaf
        for leaf, axis in zip(front[n_residual:], axes[n_residual:], strict=True)
    ]
    out = _primitive.bind(
        *front[:n_residual],
        *linear,
        forward=jax.vmap(forward, in_axes=(residual_axes, 0), axis_size=size),
        transpose=jax.vmap(transpose, in_axes=(residual_axes, 0), axis_size=size),
        n_residual=n_residual,
    )
    return out, [0] * len(out)


_primitive.def_impl(_evaluate)
_primitive.def_abstract_eval(_abstract)
ad.primitive_jvps[_primitive] = _differentiate
ad.primitive_transposes[_primitive] = _swap
batching.primitive_batchers[_primitive] = _batch
mlir.register_lowering(_primitive, mlir.lower_fun(_evaluate, multiple_results=True))
