"""Gradients through a hundred steps of water that strikes an elastic plate: both modes against finite differences.

Smooth are the effects that are listed here. `ArtificialViscosity` acts on approaching pairs only, and pressures of
structures that are clipped at zero have a kink; see tests/test_flow_gradients.py.
"""

import jax
import jax.numpy as jnp
import pytest
from struck_plate import struck_plate

import jaxsph as sph

STEPS, SAVES = 100, 5
UNKNOWNS = [
    "plate.youngs_modulus",
    "plate.poisson_ratio",
    "plate.density",
    "water.viscosity",
    "water.density",
]


class Case:
    """A scene, and a loss of what its unknowns are multiplied by."""

    def __init__(self, scene):
        self.scene, self.found = scene, sph.topologies(scene)
        self.dt = 0.6 * sph.stable_time_step(scene)
        self.substeps = sph.stable_substeps(scene, 1.2 * self.dt)
        self.start = dict.fromkeys(UNKNOWNS, 1.0)

    def loss(self, x, mode):
        scene = self.scene.replace({name: factor * self.scene.get(name) for name, factor in x.items()})
        run = sph.simulate(
            scene,
            STEPS * self.dt,
            STEPS // SAVES * self.dt,
            time_step=self.dt,
            integrator=sph.KickDriftKick(self.substeps),
            topologies_of_scene=self.found,
            max_speed=4.0,
            mode=mode,
        )
        plate, water = (run.final.systems[name] for name in ("plate", "water"))
        return (
            1e3 * jnp.sum(plate["displacement"][:, 1])
            + jnp.sum(plate["velocity"][:, 1] ** 2)
            + jnp.sum(water["velocity"][:, 0] ** 2)
        )


@pytest.fixture(scope="module")
def case():
    return Case(struck_plate())


def test_gradients_of_a_struck_plate(case):
    value, gradient = jax.jit(jax.value_and_grad(lambda x: case.loss(x, "reverse")))(case.start)
    forward = jax.jit(lambda x, dx: jax.jvp(lambda y: case.loss(y, "forward"), (x,), (dx,)))
    assert case.substeps["plate"] > 1, "the plate has to be sub-cycled"
    for name in UNKNOWNS:
        direction = {key: float(key == name) for key in UNKNOWNS}
        forward_value, slope = forward(case.start, direction)
        assert float(forward_value) == pytest.approx(float(value), rel=1e-10), "the same steps, compiled apart"
        # the same derivative, summed forward and backward through a hundred steps
        assert float(slope) == pytest.approx(float(gradient[name]), rel=1e-8), name

        def difference(step, name=name, direction=direction):
            ends = [forward({**case.start, name: 1 + s}, direction)[0] for s in (step, -step)]
            return float(ends[0] - ends[1]) / (2 * step)

        # Richardson: step^4 = 1e-14 times the fifth derivative is left of the truncation; rounding of 1e-13 of the
        # value (a hundred steps) over the step, 1e-9 of the value
        step = 3e-4
        richardson = (4 * difference(step / 2) - difference(step)) / 3
        assert richardson != 0, name
        print(name, slope, richardson, float(slope) / richardson - 1)
        assert float(slope) == pytest.approx(richardson, rel=1e-6), name
