"""Fill the tables in README.md and in the pages of docs/ from the result files in docs/results/.

A page asks for a table with a pair of markers, and everything between them is replaced:

    <!-- results:begin validation -->          every row of docs/results/validation.json
    <!-- results:begin validation S03,S05 -->  the rows whose id starts with S03 or S05
    <!-- results:begin validation S03 worst -->  of each case the row nearest its limit, or furthest beyond it, and how
                                              many of its rows that have a limit keep it
    <!-- results:begin stability H05 -->       rows of docs/results/stability.json, and whether each keeps its limit
    <!-- results:begin benchmark -->           every row of docs/results/benchmark.json
    <!-- results:begin benchmark dam_break times -->  of these the rows that are ratios
    <!-- results:begin modal -->               every row of docs/results/modal.json
    <!-- results:begin accuracy cavity -->     the runs of a study in docs/results/accuracy.json
    <!-- results:begin accuracy_answers answer.cavity -->  what to take for an error or a time
    <!-- results:begin -->                     validation and benchmark
    <!-- results:end -->

The notebooks in docs/notebooks/*.py are then run, and stored with their outputs as .ipynb beside them.

`python docs/build.py` writes; with `--check` it changes and runs nothing, and fails if a page is not up to date;
with `--no-notebooks` it fills the tables only.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
RESULTS = DOCS / "results"
MARKED = re.compile(r"(<!-- results:begin *(?P<ask>[^>]*?) *-->\n)(?P<table>.*?)(<!-- results:end -->)", re.DOTALL)

# For each result file: its columns as (key, heading), and the command that makes it.
TABLES: dict[str, tuple[tuple[tuple[str, str], ...], str]] = {
    "validation": (
        (
            ("case", "case"),
            ("figure", "figure"),
            ("value", "value"),
            ("limit", "limit"),
            ("resolution", "resolution"),
            ("precision", "precision"),
            ("seconds", "time [s]"),
        ),
        "make validate",
    ),
    "stability": (
        (
            ("case", "case"),
            ("figure", "figure"),
            ("value", "value"),
            ("limit", "limit"),
            ("kept", "kept"),
            ("resolution", "resolution"),
            ("precision", "precision"),
            ("seconds", "time [s]"),
        ),
        "make stability",
    ),
    "benchmark": (
        (
            ("case", "case"),
            ("figure", "figure"),
            ("value", "value"),
            ("unit", "unit"),
            ("resolution", "resolution"),
            ("precision", "precision"),
            ("peer", "code"),
            ("threads", "threads"),
        ),
        "make bench",
    ),
    "accuracy": (
        (
            ("particles", "particles"),
            ("settings", "settings"),
            ("code", "code"),
            ("error_1", "error 1"),
            ("error_2", "error 2"),
            ("error_3", "error 3"),
            ("front", "on the front of"),
            ("seconds", "time [s]"),
            ("compile_seconds", "compiling [s]"),
            ("steps", "steps"),
            ("n_particles", "all particles"),
            ("memory_mb", "memory [MB]"),
            ("failure", "failed"),
        ),
        "make accuracy",
    ),
    "accuracy_answers": (
        (
            ("question", "asked for"),
            ("particles", "particles"),
            ("settings", "settings"),
            ("error", "error"),
            ("seconds", "time [s]"),
        ),
        "make accuracy",
    ),
    "modal": (
        (
            ("case", "particles are"),
            ("h", "h / spacing"),
            ("error_5", "5 across [%]"),
            ("error_10", "10 across [%]"),
            ("error_20", "20 across [%]"),
            ("bending_20", "20 across, by bending alone [%]"),
            ("modes", "modes below 50 Hz without penalty"),
        ),
        "python examples/modal_analysis.py --json docs/results/modal.json",
    ),
}
ALL_TABLES = ("validation", "benchmark")  # what a marker without a name asks for
WORST = (
    ("case", "case"),
    ("kept", "within limit"),
    ("figure", "nearest its limit, or furthest beyond it"),
    ("value", "value"),
    ("limit", "limit"),
    ("resolution", "resolution"),
    ("precision", "precision"),
)


class BuildError(Exception):
    """A page asks for what the result files do not hold."""


def load_rows(name: str, results: Path = RESULTS) -> list[dict[str, Any]]:
    """Rows of one result file.

    Raises:
        BuildError: no such table, no such file, not JSON, or a row without one of the columns.
    """
    if name not in TABLES:
        raise BuildError(f"no table {name!r}: a marker names one of {', '.join(TABLES)}")
    columns, command = TABLES[name]
    path = results / f"{name}.json"
    if not path.is_file():
        raise BuildError(f"{path} is missing: run `{command}`, which writes it")
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise BuildError(f"{path} is not JSON ({error}): run `{command}` again") from error
    if not isinstance(rows, list):
        raise BuildError(f"{path} holds a {type(rows).__name__}, not a list of rows: run `{command}` again")
    for number, row in enumerate(rows):
        if name == "stability":
            row["kept"] = kept(row)
        missing = [key for key in ("id", "machine", *(key for key, _ in columns)) if key not in row]
        if missing:
            raise BuildError(f"{path}, row {number} ({row.get('id', 'no id')}) has no {', '.join(missing)}")
    return rows


def kept(row: Mapping[str, Any]) -> str:
    """Whether a row keeps its limit, nothing if it has none."""
    if row["value"] is None:
        return "**no**, not finite"
    if row["limit"] is None:
        return ""
    return "yes" if row["value"] <= row["limit"] else "**no**"


def worst(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row of each case, that with the largest share of its limit, with how many of the case keep theirs."""
    cases: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["limit"] is not None:
            cases.setdefault(row["case"], []).append(row)

    def share(row):
        if row["value"] is None or (row["limit"] == 0 and row["value"] > 0):
            return float("inf")
        return row["value"] / row["limit"] if row["limit"] else 0.0

    return [
        dict(max(judged, key=share)) | {"kept": f"{sum(kept(row) == 'yes' for row in judged)} of {len(judged)}"}
        for judged in cases.values()
    ]


def show(value: Any) -> str:
    """A cell: three significant digits for floats, nothing for null."""
    if value is None:
        return ""
    if isinstance(value, float):
        value = value + 0.0  # minus zero is zero
        if value == 0 or 1e-3 <= abs(value) < 1e5:
            return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
        return f"{value:.2e}"
    return str(value).replace("|", r"\|")


def markdown_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[tuple[str, str]]) -> str:
    """A Markdown table; columns that are empty in every row are left out."""
    columns = [(key, heading) for key, heading in columns if any(show(row[key]) for row in rows)]
    lines = [[heading for _, heading in columns], ["---"] * len(columns)]
    lines += [[show(row[key]) for key, _ in columns] for row in rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def tables(ask: str, results: Path = RESULTS) -> str:
    """What stands between the markers for one request: "", "validation", "validation S03,S05", "benchmark"..."""
    name, _, listed = ask.partition(" ")
    listed, _, kind = listed.partition(" ")
    if kind not in ("", "worst", "times"):
        raise BuildError(f"{kind!r} after the ids {listed!r}: it is `worst`, `times`, or nothing")
    parts = []
    for table in [name] if name else ALL_TABLES:
        columns, command = TABLES.get(table, ((), ""))
        everything = load_rows(table, results)
        rows = []
        for prefix in listed.split(","):
            found = [row for row in everything if str(row["id"]).startswith(prefix.strip()) and row not in rows]
            if not found:
                raise BuildError(f"{table}.json has no row whose id starts with {prefix.strip()!r}: run `{command}`")
            rows += [row for row in found if kind != "times" or row["unit"] == "times"]
        machines = sorted({str(row["machine"]) for row in rows})
        if kind == "worst":
            rows, columns = worst(rows), WORST
        parts.append(f"{markdown_table(rows, columns)}\nMade by `{command}` on {'; '.join(machines)}.\n")
    return "\n" + "\n".join(parts) + "\n"


def fill(text: str, results: Path = RESULTS) -> str:
    """The page with every marked block made anew.

    Raises:
        BuildError: a begin marker without its end, or a table that cannot be made.
    """
    if text.count("<!-- results:begin") != len(MARKED.findall(text)):
        raise BuildError("a `results:begin` marker has no `results:end` after it, each on a line of its own")
    return MARKED.sub(lambda block: block[1] + tables(block["ask"], results) + block[4], text)


def pages() -> list[Path]:
    """README.md and the Markdown pages of docs/."""
    built = DOCS / "_build"
    return [DOCS.parent / "README.md", *sorted(p for p in DOCS.rglob("*.md") if built not in p.parents)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill or check all pages, and run the notebooks; 0 if all went well."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing; fail if a page is not up to date")
    parser.add_argument("--no-notebooks", action="store_true", help="fill the tables only")
    options = parser.parse_args(arguments)
    failed = False
    for page in pages():
        old = page.read_text(encoding="utf-8")
        try:
            new = fill(old)
        except BuildError as error:
            print(f"{page.name}: {error}", file=sys.stderr)
            failed = True
            continue
        if new == old:
            print(f"{page.name}: up to date")
        elif options.check:
            print(f"{page.name}: not up to date, run `python docs/build.py`", file=sys.stderr)
            failed = True
        else:
            page.write_text(new, encoding="utf-8")
            print(f"{page.name}: written")
    if not (options.check or options.no_notebooks):
        for source in sorted((DOCS / "notebooks").glob("*.py")):
            print(f"{source.name}: running", flush=True)
            print(f"{run_notebook(source).name}: written")
    return int(failed)


def run_notebook(source: Path) -> Path:
    """Run a notebook written as a script with `# %%` cells and store it, outputs included, as .ipynb beside it.

    Raises nbclient's CellExecutionError, with the cell and its traceback, if a cell fails.
    """
    import jupytext
    import nbformat
    from nbclient import NotebookClient

    notebook = jupytext.read(source)
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    folder = {"metadata": {"path": str(source.parent)}}
    NotebookClient(notebook, timeout=900, record_timing=False, coalesce_streams=True, resources=folder).execute()
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"  # not a random one: a new run should differ where the results do
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                output["data"] = {"image/png": smaller(output["data"]["image/png"])}
    stored = source.with_suffix(".ipynb")
    nbformat.write(notebook, stored)
    return stored


def smaller(encoded: str) -> str:
    """The same PNG (base64) in 96 colors: plots need no more, and the notebook stays small enough to keep."""
    from PIL import Image

    image, buffer = Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB"), io.BytesIO()
    image.quantize(96, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


if __name__ == "__main__":
    sys.exit(main())
