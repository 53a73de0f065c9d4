"""What the reports of all fits share, whatever is lifted: the head, the curves, the priors, the last lines."""

from __future__ import annotations

from collections.abc import Sequence

from uplift.config import Settings
from uplift.run import RunFolder
from uplift.training.progress import read_metrics

__all__ = ["closing_lines", "curves_of", "head_lines", "prior_lines"]


def prior_lines(settings: Settings) -> list[str]:
    """Return which priors had a say, and which of them are the user's own."""
    specs = {n: s for n, s in settings.priors.items() if float(s.get("weight", 1)) > 0}
    lines = ["Priors (weight): " + ", ".join(f"{n} {float(s.get('weight', 1)):g}" for n, s in specs.items()) + "."]
    for name, spec in specs.items():
        if ":" in str(spec.get("use", name)):
            lines.append(f"Prior {name} is the user's own ({spec['use']}): what it reads is for its author to say.")
    return lines


def curves_of(run: RunFolder) -> dict[str, list[tuple[float, float]]]:
    """Return each curve of metrics.csv: stage and name -> (step, value) points."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for stage, step, name, value in read_metrics(run.path / "metrics.csv"):
        curves.setdefault(f"{stage}: {name}", []).append((float(step), float(value)))
    return curves


def head_lines(run: RunFolder, settings: Settings, notes: Sequence[str], spent: dict[str, float]) -> list[str]:
    """Return the first lines of report.md."""
    facts = run.facts()
    lines = [f"# {settings.task or 'own data'}", "", settings.description.strip(), ""]
    lines += ["```", facts["command"], "```", ""]
    lines += [f"- {note}" for note in notes]
    lines += [f"- {stage}: {seconds:.0f} s of training" for stage, seconds in spent.items()]
    return [*lines, f"- seed {settings.seed}, {facts['cores']} cores, torch {facts['versions']['torch']}", ""]


def closing_lines(run: RunFolder, evaluated: bool, predicting: str) -> list[str]:
    """Return what a fit wrote and what comes next; ``predicting`` are the words of `predict` behind run=."""
    last = run.path.parent / "last"
    shown = last if last.is_symlink() and last.resolve() == run.path.resolve() else run.path
    return [
        f"\nwrote {run.path}/: lifter.pt, report.md, page.html" + (", evaluation.json" if evaluated else ""),
        f"look: open {run.path / 'page.html'} in a browser",
        f"next: uplift evaluate run={shown}",
        f"      uplift predict run={shown} {predicting}",
    ]
