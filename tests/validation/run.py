"""Run the validations: solver against reference data, fit against what is known, cost of the derivatives.

python tests/validation/run.py --only S03,S05    some of the cases
python tests/validation/run.py --quick           coarse resolutions only, into out/validation_quick.json

Every row is printed as it comes and written to docs/results/validation.json; the rows of cases that were not run
stay as they are. Exit code 1 if a value exceeds its limit or a case breaks off.
"""

from __future__ import annotations

import sys

import jax

jax.config.update("jax_enable_x64", True)

import cost  # noqa: E402
import coupled  # noqa: E402
import coupled_fits  # noqa: E402
import estimates  # noqa: E402
import fits  # noqa: E402
import flows  # noqa: E402
import gradient  # noqa: E402
import motion  # noqa: E402
import patch  # noqa: E402
import pulse  # noqa: E402
import schemes  # noqa: E402
import spheres  # noqa: E402
import static  # noqa: E402
import surfaces  # noqa: E402
import time_step  # noqa: E402
import viscosity_fits  # noqa: E402
from rows import Case  # noqa: E402
from runner import main  # noqa: E402

GROUPS = (
    patch,
    static,
    motion,
    pulse,
    gradient,
    fits,
    viscosity_fits,
    cost,
    flows,
    surfaces,
    coupled,
    coupled_fits,
    spheres,
    schemes,
    time_step,
    estimates,
)
CASES: list[Case] = [case for group in GROUPS for case in group.CASES]


if __name__ == "__main__":
    sys.exit(main(CASES, "validation", __doc__ or ""))
