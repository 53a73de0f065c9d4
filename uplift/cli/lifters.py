"""The verb lifters: the ready ones in a list, or the model card of one; and which of them takes given joints."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from uplift.config.files import shipped, shipped_names
from uplift.config.safe_weights import ENDING, describe_safe
from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import match_joints

__all__ = ["hint_for", "layouts_of", "lifter_card", "lifters_command", "list_lifters"]

_WIDTH = 110


def lifters_command(words: Sequence[str]) -> None:
    """Print the list, or the card of the one that is named."""
    if len(words) > 1 or any("=" in word for word in words):
        raise UserError(f"lifters takes the name of one ready lifter at most, found '{' '.join(words)}'.")
    print(lifter_card(words[0]) if words else list_lifters())


def list_lifters() -> str:
    """Return some lines for each ready lifter: skeleton, size, figures, what it takes, licence."""
    lines = []
    for name in shipped_names("lifters"):
        path = shipped("lifters") / f"{name}{ENDING}"
        found = describe_safe(path)
        lines += [*_lines(name, found, path.stat().st_size / 1e6), ""]
    if not lines:
        return "There are no ready lifters in this installation."
    return "\n".join(
        [*lines, "uplift predict run=NAME input=FILE output=poses.html; uplift lifters NAME shows its model card"]
    )


def _lines(name: str, found: dict[str, Any], megabytes: float) -> list[str]:
    skeleton, about = found["skeleton"], found.get("about", {})
    figures = ", ".join(f"{key} {value}" for key, value in about.get("figures", {}).items())
    facts = f"{skeleton['name']}, {len(skeleton['joints'])} joints, {megabytes:.1f} MB"
    takes = layouts_of(Skeleton.from_dict(skeleton))
    rows = {
        "": about.get("title", ""),
        "takes": ", ".join(takes),
        "error": figures,
        "licence": about.get("licence", ""),
    }
    wrapped = [_wrapped(key, text) for key, text in rows.items() if text]
    return [f"{name:<12} {facts}", *(line for lines in wrapped for line in lines)]


def _wrapped(key: str, text: str) -> list[str]:
    indent = " " * 13
    return textwrap.wrap(f"{key} {text}".strip(), _WIDTH, initial_indent=indent, subsequent_indent=indent)


def lifter_card(name: str) -> str:
    """Return the model card of a ready lifter, in Markdown; raises UserError for another name."""
    names = shipped_names("lifters")
    if name not in names:
        raise UserError(f"lifters: there is no ready lifter '{name}'.{did_you_mean(name, names)}")
    return (shipped("lifters") / f"{name}.md").read_text().rstrip()


def layouts_of(skeleton: Skeleton) -> list[str]:
    """Return the layouts whose files make the skeleton's joints: its own, those of its ``from:``, and included ones that hold their names."""
    found = [skeleton.name, *skeleton.sources]
    for name in shipped_names("skeletons"):
        other = load_skeleton(name)
        with suppress(UserError):
            match_joints([joint for joint in other.joints if joint not in other.midpoints], skeleton)
            found.append(name)
    return list(dict.fromkeys(found))


def hint_for(names: Sequence[str], other_than: str) -> str:
    """Return whose joints ``names`` are, and which ready lifter takes them; nothing where nobody knows them."""
    layout = next((name for name in shipped_names("skeletons") if _holds(load_skeleton(name), names)), None)
    whose = f"the file's joints are those of {layout}" if layout else "the file has other joints"
    for ready in shipped_names("lifters"):
        skeleton = Skeleton.from_dict(describe_safe(shipped("lifters") / f"{ready}{ENDING}")["skeleton"])
        with suppress(UserError):
            match_joints(names, skeleton)
            if ready != other_than:
                return f"{whose}: run={ready} lifts them."
    if layout is None:
        return ""
    return f"{whose}, which no ready lifter takes: `uplift fit skeleton={layout} data.train=FILE` trains one."


def _holds(skeleton: Skeleton, names: Sequence[str]) -> bool:
    """Return whether a file of the skeleton's joints has these names; midpoints may be left out."""
    return set(skeleton.joints) - set(skeleton.midpoints) <= set(names) <= set(skeleton.joints)
