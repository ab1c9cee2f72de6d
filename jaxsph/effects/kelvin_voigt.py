"""Internal friction of a structure's material."""

from __future__ import annotations

from jaxsph.checks import check_at_least
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class KelvinVoigt:
    """Stresses follow the deformation a little ahead of time, P(F + tau dF/dt): the solid of Kelvin and Voigt.

    A vibration of angular frequency w is damped by the share w tau / 2 of critical damping: one that lasts long hardly
    at all, while one as fast as the spacing allows is gone after a few periods. Beside a fluid a thin plate needs that:
    the fluid meets it once in a time step of its own, and feeds vibrations that are faster than that until the plate
    breaks. A tau of a tenth of the spacing over the p-wave speed holds them down. No sums over pairs are added.

    To first order in tau the stress is that of the rate of strain in the material's own axes, so a body that turns as
    a whole feels nothing but a part (w tau)^2 of its moduli. Smooth, like the law of the material. All structures of a
    scene have the same tau.

    Attributes:
        relaxation_time: tau [s], not negative. The stable time step gets shorter, from t to sqrt(t^2 + tau^2) - tau.
    """

    relaxation_time: float

    def __post_init__(self):
        check_at_least("KelvinVoigt.relaxation_time", self.relaxation_time, 0.0, "s")

    def ahead(self, displacement, velocity):
        """The displacement (d, N) [m], or (displacement, remainder), that the stresses are those of."""
        if isinstance(displacement, tuple):
            place, remainder = displacement
            return place, remainder + self.relaxation_time * velocity
        return displacement + self.relaxation_time * velocity
