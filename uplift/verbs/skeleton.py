"""The verbs skeleton check and skeleton new."""

from __future__ import annotations

from pathlib import Path

from uplift.errors import UserError, did_you_mean
from uplift.readers.base import ReadOptions
from uplift.skeleton import load_skeleton

__all__ = ["check_skeleton_file", "keyed_words", "new_skeleton_file", "reading"]

READING = ("format", "layout", "min_confidence")


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
        f"next: uplift fit skeleton={names[0]} data.train=KEYPOINTS",
    ]


def new_skeleton_file(words: list[str]) -> list[str]:
    """Write a commented starting file, or one proposed from a tracker's file, and return what to say."""
    names, keyed = keyed_words("new", words, ("from", "root", "gravity", *READING))
    if len(names) != 1:
        raise UserError("skeleton new takes one FILE, such as beetle.yaml, and --from TRACKER_FILE if you have one.")
    path = Path(names[0] if names[0].endswith((".yaml", ".yml")) else f"{names[0]}.yaml")
    if path.exists():
        raise UserError(f"{path} exists already and is not overwritten: remove it or choose another name.")
    if not path.parent.is_dir():
        raise UserError(f"No folder {path.parent} to write {path.name} into.")
    if "from" in keyed:
        return _write_proposal(path, keyed)
    if keyed:
        raise UserError(f"skeleton new: '{next(iter(keyed))}=' goes with --from FILE.")
    from uplift.skeleton.template import skeleton_template

    path.write_text(skeleton_template(path.stem))
    return [f"wrote {path}", f"next: edit it, then uplift skeleton check {path}"]


def keyed_words(verb: str, words: list[str], known: tuple[str, ...]) -> tuple[list[str], dict[str, str]]:
    """Return the plain words and the ``key=value`` words; raises UserError for keys that are not ``known``."""
    names, keyed = [], {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or (key not in known and Path(word).exists()):
            names.append(word)
        elif key not in known:
            raise UserError(f"skeleton {verb}: '{word}' is not one of its settings.{did_you_mean(key, known)}")
        elif not value:
            raise UserError(f"skeleton {verb}: '{key}=' has no value.")
        else:
            keyed[key] = value
    return names, keyed


def reading(keyed: dict[str, str]) -> ReadOptions:
    """Return what the words say of a file that is to be read."""
    try:
        weakest = float(keyed.get("min_confidence", 0))
    except ValueError:
        raise UserError(f"min_confidence={keyed['min_confidence']}: expected a number from 0 to 1.") from None
    if not 0 <= weakest <= 1:
        raise UserError(f"min_confidence={weakest:g}: expected a number from 0 to 1.")
    return ReadOptions(format=keyed.get("format"), layout=keyed.get("layout"), min_confidence=weakest)


def _write_proposal(path: Path, keyed: dict[str, str]) -> list[str]:
    from uplift.readers import read
    from uplift.skeleton.proposal import propose
    from uplift.skeleton.proposal_text import facing_guess, proposal_text

    gravity = keyed.get("gravity", "yes").casefold()
    if gravity not in ("yes", "no", "true", "false"):
        raise UserError(f"gravity={keyed['gravity']}: expected yes or no.")
    data = read(keyed["from"], reading(keyed))
    found = propose(data, path.stem, keyed.get("root"), gravity in ("yes", "true"))
    path.write_text(proposal_text(found, str(path), keyed["from"]))
    skeleton = found.skeleton
    guessed = len(skeleton.bones) - len(found.from_file)
    lines = [
        *data.notes,
        f"{len(skeleton.joints)} joints, root {skeleton.root}; {len(skeleton.mirror)} mirror pairs; "
        f"bones: {len(found.from_file)} from the file, {guessed} guessed by distance",
    ]
    if found.hidden:
        lines.append(f"left out, as no frame shows them: {', '.join(found.hidden)}")
    from uplift.verbs.skeleton_map import fitting_skeletons

    fitting = fitting_skeletons(data)
    if fitting:
        lines.append(f"shipped skeletons that fit this file as they are: {', '.join(fitting)}: better than a guess")
    said = "guessed by the names, in comments" if facing_guess(skeleton) else "not known"
    return [
        *lines,
        f"to do: look at the bones; facing is {said}",
        f"wrote {path}",
        f"next: edit it, then uplift skeleton check {path}, and uplift skeleton map {keyed['from']} skeleton={path}",
    ]
