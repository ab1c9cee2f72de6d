"""What a gradient means where a scheme is not smooth: what docs/fluids.md says of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph.effects import TensileControl
from jaxsph.flow import Pair

PAIR = Pair(jnp.array([1.0, 0.0]), 1.0, -1.0, jnp.array([-1.0, 0.0]), 1.0, 1.0, 1.0, 10.0)
REST = {"mass": 1.0, "density": 1.0, "volume": 1.0, "velocity": jnp.zeros(2), "cover": 1.0}


def friction(speed):
    """Force along x between two particles that part with this speed."""
    return sph.ArtificialViscosity(0.1).force({**REST, "velocity": jnp.array([1.0, 0.0]) * speed}, REST, PAIR)[0]


def tension(pressure):
    return TensileControl().force({**REST, "pressure": pressure}, REST, PAIR)[0]


@pytest.mark.parametrize(("force", "active"), [(friction, -1.0), (tension, -1.0)])
def test_slope_jumps_where_the_switch_is(force, active):
    """AD gives the slope of its side, and at the switch one of the two; a difference across it gives their mean."""
    slope, step = jax.grad(force), 1e-6
    on, off = float(slope(active * 1e-3)), float(slope(-active * 1e-3))
    assert abs(on) > 0.1 and off == 0
    assert float(force(0.0)) == 0 and abs(float(force(active * step))) < 10 * step, "continuous"
    assert float(slope(0.0)) in (0.0, pytest.approx(on, rel=1e-6))
    across = float(force(step) - force(-step)) / (2 * step)
    assert across == pytest.approx(0.5 * (on + off), rel=1e-6)  # rounding of 1e-16 over the step


@pytest.mark.parametrize("clip", [True, False])
def test_clipped_pressure_of_a_wall_has_no_slope(clip):
    """Under tension a clipped wall has no pressure, and the fluid's sound speed no influence on it."""
    from fluids import column, sums

    scene = column(pressure=sph.AdamiExtrapolation(clip=clip)).replace({"gravity": (0.0, 0.0)})
    found, systems = sph.topologies(scene), sph.initial_state(scene).systems
    systems["water"]["density_deviation"] = jnp.full(36, -0.1)

    def largest(speed):
        out = sums(scene.replace({"water.sound_speed": speed}), found, systems, forward_mode=True)["tank"]["pressure"]
        return jnp.sum(out)

    value, slope = jax.jvp(largest, (20.0,), (1.0,))
    if clip:
        assert value == 0 and slope == 0
    else:
        # p = c^2 (rho - rho_0): twice the pressure over c, to rounding
        np.testing.assert_allclose(slope, 2 * value / 20.0, rtol=1e-12)
        assert value < 0
