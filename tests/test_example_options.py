"""An example called without options does what its function does, and what its help says."""

import ast
import re
from pathlib import Path
from typing import Any

import pytest

FILES = sorted((Path(__file__).resolve().parents[1] / "examples").rglob("*.py"))
EXAMPLES = [path for path in FILES if re.search(r"type=(int|float), default=", path.read_text(encoding="utf-8"))]


def literal(node: ast.expr) -> Any:
    """What an expression stands for; the expression itself where that is computed, which is not compared."""
    try:
        return ast.literal_eval(node)
    except ValueError:
        return node


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_defaults_are_the_same_on_the_command_line_in_the_function_and_in_the_help(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    (main,) = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "main"]
    names = [argument.arg for argument in main.args.args]
    of_function = dict(zip(names[::-1], main.args.defaults[::-1], strict=False))
    compared = 0
    for call in ast.walk(tree):
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)):
            continue
        if call.func.attr != "add_argument":
            continue
        option, given = literal(call.args[0]), {word.arg: literal(word.value) for word in call.keywords}
        default = given.get("default")
        name = given.get("dest", option.lstrip("-").replace("-", "_"))
        if isinstance(default, int | float) and name in of_function:
            assert default == literal(of_function[name]), f"{option} is {default}, main() takes another"
            compared += 1
            said = re.search(r"\((-?[\d.]+(?:e-?\d+)?)\)$", given.get("help", ""))
            assert said is None or float(said[1]) == default, f"{option} is {default}, its help says {said}"
    assert compared > 0, f"{path.name} has no number to compare: is this test still looking at the right thing?"
