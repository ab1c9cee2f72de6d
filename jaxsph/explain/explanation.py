"""What an explanation holds, and how it is shown: as text, and as tables in a notebook."""

from __future__ import annotations

import html
from dataclasses import dataclass

from jaxsph.explain.cost import Cost
from jaxsph.explain.facts import Facts
from jaxsph.explain.finding import Finding, Number, percent


@dataclass(frozen=True)
class Explanation:
    """What a scene calls for, has, could do without, and lacks. Printed, or shown as tables in a notebook.

    Attributes:
        facts: characteristic speed and length and what else everything follows from.
        numbers: by name, such as "Re", "Ma", "Fr", "particles per length".
        on: effects that are on, and why.
        spare: effects that could be left out, and what error that would make.
        missing: what the scene calls for and does not have.
        costs: of each effect in a step, if they were measured; else None.
    """

    facts: Facts
    numbers: dict[str, Number]
    on: list[Finding]
    spare: list[Finding]
    missing: list[Finding]
    costs: list[Cost] | None = None

    @property
    def headline(self) -> str:
        """Characteristic speed and length, and where they come from."""
        facts = self.facts
        length = f"L = {facts.length:.4g} m ({facts.length_from})"
        if facts.speed is None:
            return f"{length}; nothing announces a speed" + (": pass speed=" if facts.scene.fluids else "")
        return f"U = {facts.speed:.4g} m/s ({facts.speed_from}), {length}"

    def __str__(self) -> str:
        parts = [self.headline, *_listed("numbers", self.numbers.values()), *_listed("on", self.on)]
        parts += _listed("could be left out", self.spare) + _listed("missing", self.missing)
        if self.costs is not None:
            parts += _listed("cost, measured", self.costs)
        return "\n".join(parts)

    def _repr_html_(self) -> str:
        numbers = [(n.name, f"{n.value:.3g}", n.formula, n.meaning) for n in self.numbers.values()]
        parts = [f"<p>{html.escape(self.headline)}</p>", _table(("number", "value", "formula", "meaning"), numbers)]
        for title, found in (("on", self.on), ("could be left out", self.spare), ("missing", self.missing)):
            rows = [(f.effect, f.why, "" if f.error is None else percent(f.error), f.estimate, f.source) for f in found]
            parts.append(_table((title, "why", "error", "estimate", "source"), rows))
        if self.costs is not None:
            rows = [
                (c.effect, f"{1e3 * c.with_it:.3g}", "" if c.without is None else f"{1e3 * c.without:.3g}")
                for c in self.costs
            ]
            parts.append(_table(("effect", "step with it [ms]", "without [ms]"), rows))
        return "\n".join(parts)


def _listed(title, items):
    items = list(items)
    return [f"{title}:", *(f"  {item}" for item in items)] if items else [f"{title}: nothing"]


def _table(headings, rows):
    cells = lambda tag, row: "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in row)  # noqa: E731
    if not rows:
        return f"<p>{html.escape(headings[0])}: nothing</p>"
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{cells('th', headings)}</tr></thead><tbody>{body}</tbody></table>"
