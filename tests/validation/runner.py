"""Command line of a set of cases: which of them to run, the printed table, the file of their rows, the exit code."""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

from rows import Case, as_record, heading, holds, line, load, merge, save

ROOT = Path(__file__).resolve().parents[2]


def chosen(cases: list[Case], only: str | None) -> list[Case]:
    """The cases named in a list with commas, all without one.

    Raises ValueError for a name that is none of the cases'.
    """
    if only is None:
        return cases
    names, known = [name.strip() for name in only.split(",")], [case.id for case in cases]
    for name in names:
        if name not in known:
            raise ValueError(f"no case is called {name!r}; there are {', '.join(known)}")
    return [case for case in cases if case.id in names]


def run_cases(cases: Sequence[Case], order: Sequence[str], quick: bool, path: Path) -> tuple[list[dict], list[str]]:
    """Run cases, print and write their rows in an order of ids; the rows, and the ids of cases that broke off."""
    old = load(path)
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


def main(cases: list[Case], name: str, about: str, arguments: Sequence[str] | None = None) -> int:
    """Command line of a set of cases, written to docs/results/{name}.json; 0 if every value keeps its limit."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--only", metavar="ID,ID", help=f"some of {', '.join(case.id for case in cases)}")
    parser.add_argument("--quick", action="store_true", help="coarse resolutions only")
    parser.add_argument("--out", type=Path, help=f"file of the rows (default docs/results/{name}.json)")
    options = parser.parse_args(arguments)
    default = ROOT / (f"out/{name}_quick.json" if options.quick else f"docs/results/{name}.json")
    path = default if options.out is None else options.out
    try:
        wanted = chosen(cases, options.only)
    except ValueError as error:
        parser.error(str(error))
    print(heading())
    new, broken = run_cases(wanted, [case.id for case in cases], options.quick, path)
    print("\n" + heading())
    for record in new:
        print(line(record))
    missed = sum(not holds(record) for record in new)
    print(f"\n{len(new)} rows, {missed} miss their limit; written to {path}")
    if broken:
        print(f"broke off: {', '.join(broken)}", file=sys.stderr)
    return int(missed > 0 or bool(broken))
