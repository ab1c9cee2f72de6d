"""Run the validations: solver against reference data, fit against what is known, cost of the derivatives.

python tests/validation/run.py --only S03,S05    some of the cases
python tests/validation/run.py --quick           coarse resolutions only, into out/validation_quick.json

Every row is printed as it comes and written to docs/results/validation.json; the rows of cases that were not run
stay as they are. Exit code 1 if a value exceeds its limit or a case breaks off.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import cost  # noqa: E402
import coupled  # noqa: E402
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
from rows import Case, as_record, heading, holds, line, load, merge, save  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
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
    spheres,
    schemes,
    time_step,
)
CASES: list[Case] = [case for group in GROUPS for case in group.CASES]


def chosen(only: str | None) -> list[Case]:
    """The cases named in a list with commas, all without one.

    Raises ValueError for a name that is none of the cases'.
    """
    if only is None:
        return CASES
    names, known = [name.strip() for name in only.split(",")], [case.id for case in CASES]
    for name in names:
        if name not in known:
            raise ValueError(f"no case is called {name!r}; there are {', '.join(known)}")
    return [case for case in CASES if case.id in names]


def run_cases(cases: Sequence[Case], quick: bool, path: Path) -> tuple[list[dict], list[str]]:
    """Run cases, print and write their rows; the rows, and the ids of cases that broke off."""
    order, old = [case.id for case in CASES], load(path)
    new, finished, broken = [], [], []
    for case in cases:
        print(f"\n{case.id}: {case.title}", flush=True)
        try:
            begin = time.perf_counter()
            for batch in case.run(quick):
                seconds = time.perf_counter() - begin
                for row in batch:
                    new.append(as_record(case, row, seconds))
                    print(line(new[-1]), flush=True)
                save(path, merge(old, new, finished, order))
                begin = time.perf_counter()
        except Exception:  # one case that breaks off must not lose the others: its traceback is shown, exit code 1
            traceback.print_exc()
            broken.append(case.id)
        else:
            finished.append(case.id)
        save(path, merge(old, new, finished, order))
    return new, broken


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 0 if every value keeps its limit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="ID,ID", help=f"some of {', '.join(case.id for case in CASES)}")
    parser.add_argument("--quick", action="store_true", help="coarse resolutions only")
    parser.add_argument("--out", type=Path, help="file of the rows (default docs/results/validation.json)")
    options = parser.parse_args(arguments)
    default = ROOT / ("out/validation_quick.json" if options.quick else "docs/results/validation.json")
    path = default if options.out is None else options.out
    try:
        cases = chosen(options.only)
    except ValueError as error:
        parser.error(str(error))
    print(heading())
    new, broken = run_cases(cases, options.quick, path)
    print("\n" + heading())
    for record in new:
        print(line(record))
    missed = sum(not holds(record) for record in new)
    print(f"\n{len(new)} rows, {missed} miss their limit; written to {path}")
    if broken:
        print(f"broke off: {', '.join(broken)}", file=sys.stderr)
    return int(missed > 0 or bool(broken))


if __name__ == "__main__":
    sys.exit(main())
