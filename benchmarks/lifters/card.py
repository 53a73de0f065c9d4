"""The model card of a ready lifter, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.lifters.measure import Figures

__all__ = ["card"]

_ABOUT = {
    "Protocols": "Means over all frames of the test split; [metrics](../docs/metrics.md) defines them.",
    "Layouts that lack joints": (
        "The test frames as a file of each layout has them: midpoints are means of the joints there, and what the layout "
        "lacks is filled in. How a detector understands a joint comes on top."
    ),
    "What it takes for another body": (
        "Each joint is hidden in turn; the figure is how many times as far it is from where the others put it as in "
        "training. `predict` warns and refuses by it; `check=false` turns that off."
    ),
}


def card(name: str, wanted: Mapping[str, Any], facts: Mapping[str, Any], found: Figures) -> str:
    """Return the card of the lifter ``name``: what it is, figures, data, how to rebuild it, limits."""
    first = f"{found.headline['p_mpjpe']:.1f} {_unit(found)}"
    lines = [
        f"# {name}",
        "",
        f"{_sentence(wanted['title'])} Trained on 2D keypoints alone; p_mpjpe {first} on the test split.",
        "",
    ]
    lines += [f"```\nuplift predict run={name} input=FILE output=poses.html\n```", ""]
    lines += _table([["", ""], *([key, str(value)] for key, value in facts.items())])
    lines += ["", "## Data", "", f"{_sentence(wanted['trained on'])}", "", f"Origin: {wanted['origin']}", ""]
    lines += ["## Figures", "", f"Errors are in {_unit(found)}; one fit, one seed."]
    for title, rows in found.tables.items():
        lines += ["", f"### {title}", "", *([_ABOUT[title], ""] if title in _ABOUT else []), *_table(rows)]
    lines += ["", "## Limits", "", *(f"- {one}" for one in wanted["limits"])]
    lines += ["", "Not for:", "", *(f"- {one}" for one in wanted["not for"])]
    lines += [
        "",
        "## Rebuild",
        "",
        f"`python -m benchmarks.lifters {name}` with UPLIFT_DATA: fits, measures, writes both files.",
    ]
    return "\n".join([*lines, "", "The same seed gives the same weights on one kind of machine and one thread.", ""])


def _unit(found: Figures) -> str:
    return found.unit if found.unit != "relative" else "thousandths of the body's size"


def _sentence(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return text if text.endswith(".") else f"{text}."


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    header, *others = [[cell.replace("|", r"\|") for cell in row] for row in rows]
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *others)]
