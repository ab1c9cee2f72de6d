"""Fill docs/effects.md with what some scenes say of themselves, costs of their effects included.

The page asks for a scene with a pair of markers, and everything between them is replaced:

    <!-- explain:begin dam_break -->
    <!-- explain:end -->

`python docs/effects.py` runs the scenes and writes; `python docs/effects.py dam_break` those that are named.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph.pytree import replace

PAGE = Path(__file__).resolve().parent / "effects.md"
MARKED = re.compile(r"(<!-- explain:begin (?P<name>\w+) -->\n)(?P<said>.*?)(<!-- explain:end -->)", re.DOTALL)


def slipping_cavity() -> sph.Scene:
    """The cavity at Re 10 without shifting, and with walls on which the fluid slips."""
    cavity = sph.scenes.lid_driven_cavity(20, reynolds=10.0, effects=[sph.DensityDiffusion(0.1)])
    walls = {wall.name: replace(wall, no_slip=False) for wall in cavity.walls}
    return replace(cavity, systems=tuple(walls.get(system.name, system) for system in cavity.systems))


def hasty_dam() -> sph.Scene:
    """A dam break with too slow a sound, a diffusion that levels the weight, and a thin plate without penalty force."""
    effects = [sph.DensityDiffusion(0.1), sph.ArtificialViscosity(0.02)]
    dam = sph.scenes.dam_break(20, sound_speed=20.0, effects=effects)
    body = sph.box((2.0, 0.0), (0.05, 0.3), 0.01, dtype=np.dtype(dam.dtype))
    plate = sph.Structure("plate", body, 1100.0, 1e6, 0.4, clamped=lambda x: x[:, 1] < 0.02)
    return replace(dam, systems=(*dam.systems, plate))


SCENES = {
    # by name: the scene, and whether its effects are timed
    "dam_break": (lambda: sph.scenes.dam_break(40), True),
    "lid_driven_cavity": (lambda: sph.scenes.lid_driven_cavity(50), True),
    "turek_hron_beam": (lambda: sph.scenes.turek_hron_beam(9), True),
    "slipping_cavity": (slipping_cavity, False),
    "hasty_dam": (hasty_dam, False),
}


def fill(text: str, names: Sequence[str]) -> str:
    """The page with the blocks of these scenes made anew. Raises KeyError for a scene that is not in SCENES."""

    def made(block: re.Match) -> str:
        if names and block["name"] not in names:
            return block[0]
        make, timed = SCENES[block["name"]]
        print(f"{block['name']}: explaining", flush=True)
        scene = make()
        return f"{block[1]}\n```text\n{scene}\n\n{scene.explain(measure=timed)}\n```\n\n{block[4]}"

    return MARKED.sub(made, text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page."""
    names = list(sys.argv[1:] if arguments is None else arguments)
    unknown = sorted(set(names) - set(SCENES))
    if unknown:
        print(f"no scene {', '.join(unknown)}; there are {', '.join(SCENES)}", file=sys.stderr)
        return 1
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), names), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
