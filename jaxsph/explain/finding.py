"""One sentence of an explanation, and one number."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What an explanation says of one effect.

    Attributes:
        effect: its name, with the system that it is of, such as "no slip of tank".
        why: why it is there, can be left out, or is called for.
        error: an estimate of what keeping it, leaving it out, or not having it costs, relative; None where no formula
            is known.
        estimate: the formula of the error, or what is known without one.
        source: of the formula.
    """

    effect: str
    why: str
    error: float | None = None
    estimate: str = ""
    source: str = ""

    def __str__(self) -> str:
        parts = [f"{self.effect}: {self.why}"]
        if self.error is not None:
            parts.append(f"error about {percent(self.error)}, {self.estimate}")
        elif self.estimate:
            parts.append(self.estimate)
        return "; ".join(parts) + (f" [{self.source}]" if self.source else "")


@dataclass(frozen=True)
class Number:
    """A number of a scene: its symbol or name, its value, how it follows, and what it means here."""

    name: str
    value: float | int
    formula: str
    meaning: str = ""

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.3g} ({self.formula})" + (f": {self.meaning}" if self.meaning else "")


def percent(value: float | int) -> str:
    """A share for reading: .0123 is 1.2 %."""
    return f"{100 * value:.2g} %" if value < 1 else f"{value:.2g} times as much"


MONAGHAN = "J. J. Monaghan (2005), Rep. Prog. Phys. 68, 1703"
COMPRESSIBLE = "J. J. Monaghan (1994), J. Comput. Phys. 110, 399"
LAYER = "H. Schlichting, K. Gersten, Boundary-Layer Theory"
DIFFUSION = "D. Molteni, A. Colagrossi (2009), Comput. Phys. Commun. 180, 861"
DELTA = "M. Antuono, A. Colagrossi, S. Marrone, D. Molteni (2010), Comput. Phys. Commun. 181, 532"
TENSILE = "J. W. Swegle, D. L. Hicks, S. W. Attaway (1995), J. Comput. Phys. 116, 123"
DISORDER = "N. J. Quinlan, M. Basa, M. Lastiwka (2006), Int. J. Numer. Methods Eng. 66, 2064"
WALLS = "S. Adami, X. Y. Hu, N. A. Adams (2012), J. Comput. Phys. 231, 7057"
SHIFTING = "P.-N. Sun, A. Colagrossi, S. Marrone, M. Antuono, A.-M. Zhang (2019), Comput. Phys. Commun. 236, 63"
PENALTY = "G. C. Ganzenmueller (2015), Comput. Methods Appl. Mech. Eng. 286, 87"
