"""What is there: tasks with their data, shipped skeletons."""

from __future__ import annotations

from uplift.data.load import find_data, set_of
from uplift.errors import UserError
from uplift.paths import shipped_names
from uplift.skeleton import load_skeleton
from uplift.task import load_settings

__all__ = ["list_skeletons", "list_tasks"]


def list_tasks() -> str:
    """Return a line for each shipped task: name, whether its data is present, what it is."""
    lines = []
    for name in shipped_names("tasks"):
        if name == "default":
            continue
        settings = load_settings(name)
        if settings.data.simulate:
            state = "no data needed"
        elif not settings.data.train:
            state = "data.train=..."
        else:
            try:
                if set_of(settings, "train") is None:
                    find_data(settings, "train")
                state = "data present"
            except UserError:
                state = "data missing"
        lines.append(f"{name:<18} {state:<15} {settings.description.strip().splitlines()[0]}")
    return "\n".join([*lines, "", "uplift fit task=NAME; a task file of your own: uplift fit task=FILE.yaml"])


def list_skeletons() -> str:
    """Return a line for each shipped skeleton."""
    lines = []
    for name in shipped_names("skeletons"):
        skeleton = load_skeleton(name)
        views = "gravity" if skeleton.gravity else "no gravity"
        lines.append(f"{name:<18} {len(skeleton.joints):>3} joints  {views:<10}  {skeleton.description}")
    return "\n".join(
        [*lines, "", "uplift skeleton check NAME|FILE draws one; uplift skeleton new FILE starts your own"]
    )
