"""S01, S02: rigid rotations without stress and affine deformations without error, on disordered particles."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from reference import table
from rows import Case, Row, precision

import jaxsph
from jaxsph.dynamics import accelerations, prepare
from jaxsph.pytree import replace
from jaxsph.state import to_columns

ANGLES = (1, 10, 45, 90, 135, 180)
LIMITS = {"float64": 1e-12, "float32": 1e-5}
TABLE_LIMIT = {"float64": 1e-8, "float32": 1e-5}  # the tables have ten digits; stretches of .7 to 1.2 need nine
DISORDER = 0.2  # every particle is moved by up to this part of the spacing along each axis


def body(dimension: int, dtype) -> jaxsph.Scene:
    """A square or cube of 1 m around the origin, disordered, E = 1 Pa, Poisson ratio .3, with penalty force."""
    size = 12 if dimension == 2 else 7
    lattice = jaxsph.box((-0.5,) * dimension, (1.0,) * dimension, 1 / size, dtype=dtype)
    particles = jaxsph.jitter(lattice, DISORDER, seed=3)
    structure = jaxsph.Structure("body", particles, density=1.0, youngs_modulus=1.0, poisson_ratio=0.3)
    return jaxsph.Scene(structure, effects=[jaxsph.PenaltyForce(0.05)])


def deformed(scene: jaxsph.Scene, gradient: np.ndarray) -> jaxsph.State:
    """The state of the displacements u = H X; H (d, d)."""
    state = jaxsph.initial_state(scene)
    positions = np.asarray(scene["body"].particles.positions, np.float64)
    fields = {**state.systems["body"], "displacement": jnp.asarray(positions @ gradient.T, scene.dtype)}
    return replace(state, systems={"body": fields})


def rotation(dimension: int, degrees: float) -> np.ndarray:
    """Rotation by an angle in the plane, or around the axis (1, 2, 3)."""
    angle = np.deg2rad(degrees)
    if dimension == 2:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, y, z = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def size_of(scene: jaxsph.Scene) -> str:
    """Resolution: number of particles and the disorder."""
    return f"{scene['body'].n_particles} in {scene.dimension}D"


def rigid_rotation(quick: bool) -> Iterator[list[Row]]:
    for dimension in (2,) if quick else (2, 3):
        for dtype in (np.float64, np.float32):
            scene = body(dimension, dtype)
            found = jaxsph.topologies(scene)
            spacing, stress, force = scene["body"].particles.spacing, 0.0, 0.0

            @jax.jit
            def look(state, scene=scene, found=found):
                rates = accelerations(scene, prepare(scene, found), to_columns(state.systems, found), state.time)
                return jaxsph.observe.stresses(scene, state, "body", found)["pk1"], rates["body"]["acceleration"]

            for degrees in ANGLES:
                state = deformed(scene, rotation(dimension, degrees) - np.eye(dimension))
                pk1, rate = look(state)
                stress = max(stress, float(np.max(np.abs(pk1))))
                force = max(force, float(np.max(np.abs(rate))) * spacing)
            limit = LIMITS[precision(dtype)]
            where = (size_of(scene), precision(dtype))
            yield [
                Row("|P|max / E, rotated by 1 to 180 degrees", stress, limit, *where),
                Row("|a|max density spacing / E, with penalty force", force, limit, *where),
            ]


def affine(quick: bool) -> Iterator[list[Row]]:
    draws = np.random.default_rng(5).uniform(-0.3, 0.3, (8, 3, 3))
    for dimension in (2,) if quick else (2, 3):
        for dtype in (np.float64, np.float32):
            scene = body(dimension, dtype)
            error, look = 0.0, looker(scene)
            for gradient in draws[:, :dimension, :dimension]:
                state = deformed(scene, gradient)
                seen = look(state)["deformation_gradient"]
                error = max(error, float(np.max(np.abs(np.asarray(seen) - gradient - np.eye(dimension)))))
            where = (size_of(scene), precision(dtype))
            rows = [Row("|F - F exact|max, 8 affine deformations", error, LIMITS[precision(dtype)], *where)]
            if dimension == 2:
                rows.append(Row("|stress - table|max / E", against_tables(scene, look), TABLE_LIMIT[where[1]], *where))
            yield rows


def looker(scene: jaxsph.Scene):
    """Stresses of the body as a compiled function of the state."""
    found = jaxsph.topologies(scene)
    return jax.jit(lambda state: jaxsph.observe.stresses(scene, state, "body", found))


def against_tables(scene: jaxsph.Scene, look) -> float:
    """Largest difference of PK1 and Cauchy stresses from the tables of shear and plane strain tension, over E = 1."""
    worst = 0.0

    def compare(gradient, kind, expected):
        seen = np.asarray(look(deformed(scene, gradient))[kind])
        return max(float(np.max(np.abs(seen[:, i, j] - value))) for (i, j), value in expected.items())

    for line in table("solid/svk_simple_shear_E1_nu0.3.csv"):
        gradient = np.array([[0, float(line["gamma"])], [0, 0]])
        pk1 = {(i, j): float(line[f"P{i + 1}{j + 1}"]) for i in range(2) for j in range(2)}
        cauchy = {(0, 0): float(line["s11"]), (0, 1): float(line["s12"]), (1, 1): float(line["s22"])}
        worst = max(worst, compare(gradient, "pk1", pk1), compare(gradient, "cauchy", cauchy))
    for line in table("solid/svk_uniaxial_plane_strain_E1_nu0.3.csv"):
        gradient = np.diag([float(line["stretch_1"]) - 1, float(line["stretch_2"]) - 1])
        pk1 = {(0, 0): float(line["P11"]), (1, 1): 0.0, (0, 1): 0.0}
        worst = max(worst, compare(gradient, "pk1", pk1))
        worst = max(worst, compare(gradient, "cauchy", {(0, 0): float(line["sigma11"])}))
    return worst


CASES = [
    Case("S01", "Rigid rotation of a disordered body", rigid_rotation),
    Case("S02", "Affine deformation of a disordered body", affine),
]
