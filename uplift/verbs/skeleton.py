"""The verbs skeleton check and skeleton new."""

from __future__ import annotations

from pathlib import Path

from uplift.errors import UserError, did_you_mean
from uplift.skeleton import load_skeleton

__all__ = ["check_skeleton_file", "new_skeleton_file"]


def check_skeleton_file(words: list[str]) -> list[str]:
    """Validate a skeleton, draw it, and return what to say."""
    from uplift.skeleton.drawing import draw_skeleton

    names = [word for word in words if "=" not in word]
    keyed = dict(word.split("=", 1) for word in words if "=" in word)
    if len(names) != 1 or set(keyed) - {"output"}:
        wrong = next(iter(set(keyed) - {"output"}), "")
        hint = did_you_mean(wrong, ["output"]) if wrong else ""
        raise UserError(f"skeleton check takes one FILE (or a shipped name) and output=FILE.png.{hint}")
    skeleton = load_skeleton(names[0])
    output = Path(keyed.get("output", f"{skeleton.name}.png"))
    if output.suffix.lower() != ".png":
        raise UserError(f"output={output}: the drawing is a .png.")
    if output.exists() and "output" in keyed:
        raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
    number = 2
    while output.exists():
        output = Path(f"{skeleton.name}_{number}.png")
        number += 1
    draw_skeleton(skeleton, output)
    facing = ", ".join(skeleton.facing) or "none: the depth-mirrored pose cannot be told from the true one"
    return [
        f"{skeleton.name}: {len(skeleton.joints)} joints, {len(skeleton.bones)} bones, root {skeleton.root}",
        f"mirror pairs: {len(skeleton.mirror)}; facing: {facing}; gravity: {'yes' if skeleton.gravity else 'no'}",
        f"other layouts it can be built from: {', '.join(skeleton.sources) or 'none'}",
        f"simulator: {'ready' if skeleton.body else 'no proportions given'}",
        f"wrote {output}",
        f"next: uplift fit skeleton={names[0]} data.train=KEYPOINTS.npz",
    ]


def new_skeleton_file(words: list[str]) -> list[str]:
    """Write a commented starting file and return what to say."""
    from uplift.skeleton.template import skeleton_template

    if len(words) != 1:
        raise UserError("skeleton new takes one FILE, such as beetle.yaml.")
    path = Path(words[0] if words[0].endswith((".yaml", ".yml")) else f"{words[0]}.yaml")
    if path.exists():
        raise UserError(f"{path} exists already and is not overwritten: remove it or choose another name.")
    if not path.parent.is_dir():
        raise UserError(f"No folder {path.parent} to write {path.name} into.")
    path.write_text(skeleton_template(path.stem))
    return [f"wrote {path}", f"next: edit it, then uplift skeleton check {path}"]
