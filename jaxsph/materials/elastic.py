"""Elastic laws: from the displacement gradient to the first Piola-Kirchhoff (PK1) stress.

A law sees H = F - I (F is the deformation gradient, the poster's J) rather than F, because small strains
vanish in the rounding of F in float32. Two dimensions are plane strain. Tensors are (d, d, ...).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import jax.numpy as jnp

from jaxsph.pytree import pytree_dataclass
from jaxsph.tensors import determinant, identity_like, inverse, multiply, trace, transpose


def lame_parameters(youngs_modulus, poisson_ratio):
    """Lame parameters (lambda, mu) [Pa] from Young's modulus [Pa] and the Poisson ratio: equation (20)."""
    mu = youngs_modulus / (2 * (1 + poisson_ratio))
    lam = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    return lam, mu


def p_wave_speed(youngs_modulus, poisson_ratio, density):
    """Speed of the fastest elastic wave, sqrt((lambda + 2 mu) / rho) [m/s]."""
    lam, mu = lame_parameters(youngs_modulus, poisson_ratio)
    return jnp.sqrt((lam + 2 * mu) / density)


def green_lagrange_strain(displacement_gradient):
    """E = (F^T F - I) / 2 = (H + H^T + H^T H) / 2: equation (18)."""
    h = displacement_gradient
    return 0.5 * (h + transpose(h) + multiply(transpose(h), h))


class ElasticLaw(ABC):
    """A hyperelastic law: a stored energy per reference volume and its derivative, the PK1 stress."""

    @abstractmethod
    def stress(self, displacement_gradient, lam, mu) -> Any:
        """PK1 stress P [Pa], (d, d, ...), from H (d, d, ...) and the Lame parameters [Pa]."""

    @abstractmethod
    def energy_density(self, displacement_gradient, lam, mu) -> Any:
        """Stored energy per reference volume [J/m^3], (...)."""


@pytree_dataclass
class StVenantKirchhoff(ElasticLaw):
    """S = lambda tr(E) I + 2 mu E, P = F S: equations (18) and (19). For large rotations, moderate strains.

    Softens under strong compression (below a stretch of 1 / sqrt(3) it collapses).
    """

    def stress(self, displacement_gradient, lam, mu):
        """PK1 stress [Pa]."""
        strain = green_lagrange_strain(displacement_gradient)
        pk2 = lam * trace(strain) * identity_like(strain) + 2 * mu * strain
        return pk2 + multiply(displacement_gradient, pk2)

    def energy_density(self, displacement_gradient, lam, mu):
        """lambda / 2 tr(E)^2 + mu E : E [J/m^3]."""
        strain = green_lagrange_strain(displacement_gradient)
        return 0.5 * lam * trace(strain) ** 2 + mu * jnp.sum(strain * strain, axis=(0, 1))


@pytree_dataclass
class NeoHookean(ElasticLaw):
    """Compressible neo-Hookean law, P = mu (F - F^-T) + lambda ln(det F) F^-T. For large strains.

    Bonet & Wood (2008), Nonlinear Continuum Mechanics for Finite Element Analysis, eq. 6.28. Not defined for
    det F <= 0: the stress is then not a number, and the run stops with that reason.
    """

    def stress(self, displacement_gradient, lam, mu):
        """PK1 stress [Pa]."""
        unit = identity_like(displacement_gradient)
        deformation = displacement_gradient + unit
        inverse_transposed = transpose(inverse(deformation))
        volume_change = _log_determinant(displacement_gradient)
        # F - F^-T = (F F^T - I) F^-T, whose bracket is small when the strain is.
        left = displacement_gradient + transpose(displacement_gradient)
        left = left + multiply(displacement_gradient, transpose(displacement_gradient))
        return mu * multiply(left, inverse_transposed) + lam * volume_change * inverse_transposed

    def energy_density(self, displacement_gradient, lam, mu):
        """mu / 2 (tr(F^T F) - d) - mu ln J + lambda / 2 (ln J)^2 [J/m^3]; plane strain in 2D."""
        log_j = _log_determinant(displacement_gradient)
        strain = green_lagrange_strain(displacement_gradient)
        return mu * (trace(strain) - log_j) + 0.5 * lam * log_j**2


def _log_determinant(displacement_gradient):
    """ln(det(I + H)), accurate for small H: det(I + H) - 1 is expanded in the invariants of H."""
    h = displacement_gradient
    change = trace(h)
    if h.shape[0] == 2:
        change = change + determinant(h)
    elif h.shape[0] == 3:
        change = change + 0.5 * (trace(h) ** 2 - trace(multiply(h, h))) + determinant(h)
    return jnp.log1p(change)


def cauchy_stress(displacement_gradient, pk1):
    """Cauchy stress P F^T / det F [Pa], (d, d, ...)."""
    deformation = displacement_gradient + identity_like(displacement_gradient)
    return multiply(pk1, transpose(deformation)) / determinant(deformation)


def von_mises(stress, poisson_ratio):
    """Von Mises stress [Pa] of a Cauchy stress (d, d, ...).

    In 2D (plane strain) the stress out of the plane is poisson_ratio (s_xx + s_yy), as in linear elasticity.
    """
    d = stress.shape[0]
    normal = [stress[i, i] for i in range(d)]
    shear = [stress[i, j] for i in range(d) for j in range(i)]
    if d == 2:
        normal.append(poisson_ratio * (normal[0] + normal[1]))
    differences = sum((normal[i] - normal[j]) ** 2 for i in range(3) for j in range(i))
    squared = 0.5 * differences + 3 * sum(s**2 for s in shear)
    # The slope of the root is infinite without stress: there the derivative is taken as zero.
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)
