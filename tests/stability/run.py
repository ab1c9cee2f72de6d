"""Run the hard cases: what a stable scheme must keep, at coarse resolution, for long, in float32 and float64.

python tests/stability/run.py --only H05,H06    some of the cases
python tests/stability/run.py --quick           the coarsest runs only, into out/stability_quick.json

Every row is printed as it comes and written to docs/results/stability.json; the rows of cases that were not run
stay as they are. Exit code 1 if a value exceeds its limit or a case breaks off.
"""

from __future__ import annotations

import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(1, str(Path(__file__).resolve().parents[1] / "validation"))

import beams  # noqa: E402
import columns  # noqa: E402
import coupled_cases  # noqa: E402
import largest_step  # noqa: E402
import long_gradients  # noqa: E402
import mistakes  # noqa: E402
import surfaces_at_work  # noqa: E402
import tension  # noqa: E402
from rows import Case  # noqa: E402
from runner import main  # noqa: E402

GROUPS = (tension, surfaces_at_work, coupled_cases, beams, columns, largest_step, mistakes, long_gradients)
CASES: list[Case] = sorted((case for group in GROUPS for case in group.CASES), key=lambda case: case.id)

if __name__ == "__main__":
    sys.exit(main(CASES, "stability", __doc__ or ""))
