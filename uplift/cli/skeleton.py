"""The verbs skeleton check, new and map: a skeleton file, and which joint of a tracker's file goes where."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from uplift.cli.parsing import Keys, keyed
from uplift.config.files import Existing, as_bytes, refuse_existing, replacing, shipped, shipped_names
from uplift.data.clean import MIN_VISIBLE, clean
from uplift.data.concat import concat_poses
from uplift.data.formats.layouts import is_nameless
from uplift.data.load import in_joints_of, read_files
from uplift.data.poses import PoseData
from uplift.data.upright import upright_notes
from uplift.errors import UserError, listed
from uplift.skeleton import Skeleton, load_skeleton, propose
from uplift.skeleton.core import without_side
from uplift.skeleton.match import JointMatch, match_joints

__all__ = ["check_skeleton_file", "map_joints", "new_skeleton_file"]


def check_skeleton_file(words: list[str]) -> list[str]:
    """Validate a skeleton, draw it, and return the lines to print."""
    from uplift.skeleton.draw import draw_skeleton

    keys = keyed("skeleton check", words)
    if len(keys.plain) != 1:
        raise UserError("skeleton check takes one FILE (or a shipped name) and output=FILE.png.")
    skeleton = load_skeleton(keys.plain[0])
    output = Path(keys.get("output", f"{skeleton.name}.png"))
    if output.suffix.lower() != ".png":
        raise UserError(f"output={output}: the drawing is a .png.")
    for number in itertools.count(2):
        try:
            refuse_existing(output)
            draw_skeleton(skeleton, output)
            break
        except Existing:
            if "output" in keys:
                raise
            output = Path(f"{skeleton.name}_{number}.png")
    facing = ", ".join(skeleton.facing) or "none: the depth-mirrored pose cannot be told from the true one"
    return [
        f"{skeleton.name}: {len(skeleton.joints)} joints, {len(skeleton.bones)} bones, root {skeleton.root}",
        f"mirror pairs: {len(skeleton.mirror)}; facing: {facing}; gravity: {'yes' if skeleton.gravity else 'no'}",
        f"joint angles: {', '.join(dict.fromkeys(without_side(name)[0] for name in skeleton.angles)) or 'none'}",
        f"other layouts it can be built from: {', '.join(skeleton.sources) or 'none'}",
        f"simulator: {'ready' if skeleton.body else 'no proportions given'}",
        f"wrote {output}",
        f"next: uplift fit skeleton={keys.plain[0]} data.train=KEYPOINTS",
    ]


def new_skeleton_file(words: list[str]) -> list[str]:
    """Write a commented starting file, or one proposed from a tracker's file, and return the lines to print."""
    keys = keyed("skeleton new", words)
    if not keys.plain or ("from" not in keys and len(keys.plain) > 1):
        raise UserError("skeleton new takes one FILE, such as beetle.yaml, and --from TRACKER_FILE if you have one.")
    name = keys.plain[0]
    path = Path(name if name.endswith((".yaml", ".yml")) else f"{name}.yaml")
    refuse_existing(path)
    if not path.parent.is_dir():
        raise UserError(f"No folder {path.parent} to write {path.name} into.")
    if "from" in keys:
        return _write_proposal(path, keys)
    if keys:
        raise UserError(f"skeleton new: '{next(iter(keys))}=' goes with --from FILE.")
    _write(path, propose.skeleton_template(path.stem))
    return [f"wrote {path}", f"next: edit it, then uplift skeleton check {path}"]


def _write(path: Path, text: str) -> None:
    with replacing(path) as file:
        file.write(as_bytes(text))


def _write_proposal(path: Path, keys: Keys) -> list[str]:
    gravity, source = keys.value("gravity"), ",".join([keys["from"], *keys.plain[1:]])
    data, *others = _tracked([keys["from"], *keys.plain[1:]], keys)  # a shell puts several words for one pattern
    if others:
        raise UserError(
            f"{source}: the files have different joints ({', '.join(data.joint_names[:5])}, ... in {data.source}; "
            f"{', '.join(others[0].joint_names[:5])}, ... in {others[0].source}). Give files of one kind."
        )
    found = propose.propose(data, path.stem, keys.get("root"), gravity in ("yes", "true"))
    _write(path, propose.proposal_text(found, str(path), source))
    skeleton = found.skeleton
    guessed = len(skeleton.bones) - len(found.from_file)
    lines = [
        *data.notes,
        f"{len(skeleton.joints)} joints, root {skeleton.root}; {len(skeleton.mirror)} mirror pairs; "
        f"bones: {len(found.from_file)} from the file, {guessed} guessed by distance",
    ]
    lines += [f"left out, as no frame shows them: {listed(found.hidden)}"] if found.hidden else []
    fitting = _fitting_skeletons(data)
    if fitting:
        lines.append(f"shipped skeletons that fit this file as they are: {', '.join(fitting)}: better than a guess")
    how = f" format={keys['format']}" if "format" in keys else ""
    known = "guessed by the names, in comments" if propose.facing_guess(skeleton) else "not known"
    return [
        *lines,
        f"to do: look at the bones; facing is {known}",
        f"wrote {path}",
        f"next: edit it, then uplift skeleton check {path}, and uplift skeleton map {source}{how} skeleton={path}",
    ]


# The verb skeleton map: which joint of a tracker's file goes where, before anything is lifted.

_LIKELY = 1.5  # see `stretched`


def map_joints(words: list[str]) -> tuple[list[str], bool]:
    """Return the lines on how the joints of files make a skeleton's, and whether all of the files can be lifted."""
    keys = keyed("skeleton map", words)
    if not keys.plain:
        raise UserError("skeleton map takes a FILE or FOLDER, or several, and skeleton=NAME or skeleton=FILE.yaml.")
    skeleton = load_skeleton(keys["skeleton"])
    kinds = _tracked(keys.plain, keys, skeleton)
    lines: list[str] = []
    fits = True
    for data in kinds:
        told, good = _map_of(data, skeleton, ",".join(keys.plain) if len(kinds) == 1 else data.source)
        lines += [*([""] if lines else []), *told]
        fits &= good
    return lines, fits


def _map_of(data: PoseData, skeleton: Skeleton, source: str) -> tuple[list[str], bool]:
    """Return the lines on one set of joints, and whether it can be lifted."""
    lines = [f"{source}: {_counts(data)}", *(f"  {note}" for note in data.notes), ""]
    try:
        match = match_joints(data.joint_names, skeleton)
    except UserError as error:
        return [*lines, f"it cannot be lifted as {skeleton.name}: {error}", *_help(data, skeleton)], False
    built = in_joints_of(data, skeleton)
    how = "by name" if match.layout is None else f"by its layout '{match.layout}'"
    lines += [f"{skeleton.name}, {how}:", *_table(match, skeleton, built)]
    lines += [f"  unused: {listed(match.unused)}"] if match.unused else []
    verdict, fits = _verdict(data, skeleton, built)
    return [*lines, *upright_notes([built], skeleton), "", verdict], fits


def _tracked(paths: Sequence[str], keys: Keys, skeleton: Skeleton | None = None) -> list[PoseData]:
    """Return what the files hold that ``paths`` mean, those of the same joints together."""
    files, left_out = read_files(paths, keys.reading(), skeleton)
    kinds: dict[frozenset[str], list[PoseData]] = {}
    for data in files:
        alike = kinds.setdefault(frozenset(data.joint_names), [])
        alike.append(_in_order(data, alike[0].joint_names) if alike else data)
    joined = [concat_poses(alike) for alike in kinds.values()]
    return [replace(joined[0], notes=(*left_out, *joined[0].notes)), *joined[1:]]


def _in_order(data: PoseData, names: tuple[str, ...]) -> PoseData:
    """Return ``data`` with its joints in the order of ``names``."""
    if data.joint_names == names:
        return data
    order = [data.joint_names.index(name) for name in names]
    pose = None if data.pose is None else data.pose[:, order]
    keypoints, confidence = data.keypoints[:, order], data.confidence[:, order]
    return replace(data, keypoints=keypoints, confidence=confidence, pose=pose, joint_names=names)


def _counts(data: PoseData) -> str:
    who = np.unique(data.identity.get("instance", ()))
    frames = f"{len(data):,} frames" + (f" of {len(who):,} individuals" if len(who) > 1 else "")
    kinds = np.unique(data.identity["category"]).tolist() if "category" in data.identity else []
    shown = f" ({', '.join(map(str, kinds[:6]))}{', ...' if len(kinds) > 6 else ''})" if kinds else ""
    return f"{frames}{shown}, {len(data.joint_names)} joints"


def _table(match: JointMatch, skeleton: Skeleton, built: PoseData) -> list[str]:
    """Return a line for each joint: what it is made of, how often it is seen, and its mean confidence."""
    seen = built.confidence > 0
    rows = []
    for place, joint in enumerate(skeleton.joints):
        parts = match.parts.get(joint)
        if parts is None:
            rows.append((joint, "MISSING", ""))
            continue
        made = parts[0] if len(parts) == 1 else f"mean of {', '.join(dict.fromkeys(parts))}"
        mean = f", confidence {built.confidence[seen[:, place], place].mean():.2f}" if seen[:, place].any() else ""
        rows.append((joint, made, f"seen in {_percent(seen[:, place])} of frames{mean}"))
    wide = [max(len(row[column]) for row in rows) for column in (0, 1)]
    return [f"  {joint:<{wide[0]}} <- {made:<{min(wide[1], 44)}}  {how}".rstrip() for joint, made, how in rows]


def _percent(flags: np.ndarray) -> str:
    """Return a share as per cent, 100 and 0 kept for all and none."""
    share = float(flags.mean()) if len(flags) else 0.0
    return f"{share if share in (0, 1) else min(max(share, 0.001), 0.999):6.1%}"


def _verdict(data: PoseData, skeleton: Skeleton, built: PoseData) -> tuple[str, bool]:
    try:
        _, report = clean(built, skeleton, drop=False)
    except UserError as error:
        return f"it cannot be lifted: {error}", False
    # Shipped skeletons whose files hold just these names know the most bones of the file.
    others = [other for other, names in _shipped() if set(names) == set(data.joint_names)]
    long = max(_stretch(built, skeleton), *(_stretch(data, other) for other in others), 0)
    if long > propose.TOO_LONG:
        return f"it should not be lifted: {_wrong_order(long, data, skeleton)}", False
    good = report.frames - report.too_few - report.all_equal
    text = f"it can be lifted: {good:,} of {report.frames:,} frames show {MIN_VISIBLE} joints or more"
    shown = np.asarray((built.confidence > 0).any(0))
    hidden = [joint for joint, seen in zip(skeleton.joints, shown.tolist(), strict=True) if not seen]
    if hidden:
        which = ", ".join(hidden) if len(hidden) <= 6 else f"{len(hidden)} of {len(skeleton.joints)} joints"
        text += f"; hidden in all of them, so guessed: {which}"
    if len(hidden) > len(skeleton.joints) / 2:
        text += ". A skeleton with fewer joints suits this file better"
    return text, True


def _wrong_order(long: float, data: PoseData, skeleton: Skeleton) -> str:
    text = (
        f"its bones are {long:.1f} times as long as the shortest lines that join these joints (1 to 1.6 where the "
        "names are right). Joints have the names of others: another layout, or another order"
    )
    as_long = [(other, names) for other, names in _shipped() if len(names) == len(data.joint_names)]
    renamed = [(other, replace(data, joint_names=names, pose=None)) for other, names in as_long]
    fitting = [other.name for other, read_so in renamed if _stretch(read_so, other) < _LIKELY]
    if not fitting:
        return text
    how = "" if _unnamed(data) else f". {_NAMED}: correct its names"
    return f"{text}. In their order they look like layout={' or layout='.join(fitting)}{how}"


def _unnamed(data: PoseData) -> bool:
    """Return whether the joints have no names in the file: numbers alone, or those of a layout that was guessed."""
    return is_nameless(data.joint_names) or any("no names in the file" in note for note in data.notes)


_NAMED = "layout= has no effect here, as the file names its joints"


def _stretch(data: PoseData, skeleton: Skeleton) -> float:
    """Return how far the bones of the skeleton are stretched in a file that fits it; 0 where nothing is seen."""
    built = in_joints_of(data, skeleton)
    return propose.stretch_of(built.keypoints, built.confidence, skeleton)


def _shipped() -> list[tuple[Skeleton, tuple[str, ...]]]:
    """Return all shipped skeletons, each with the names that a file of it holds."""
    found = [load_skeleton(name) for name in shipped_names("skeletons")]
    return [(one, tuple(joint for joint in one.joints if joint not in one.midpoints)) for one in found]


def _fitting_skeletons(data: PoseData) -> list[str]:
    """Return the shipped skeletons that a file's joints make."""
    fitting = []
    for other, _ in _shipped():
        with suppress(UserError):
            match = match_joints(data.joint_names, other)
            fitting += [other.name] if len(match.missing) <= len(match.parts) else []
    return fitting


def _help(data: PoseData, skeleton: Skeleton) -> list[str]:
    """Return which shipped skeletons fit, and a `from:` block of guesses, in comments."""
    lines = [""]
    fitting = [name for name in _fitting_skeletons(data) if name != skeleton.name]
    if fitting:
        lines += [f"shipped skeletons that fit the file: {', '.join(fitting)}", ""]
    guesses = propose.guess_parts(skeleton, data.joint_names)
    if not guesses:
        how = f"{_NAMED}. Write a from: for its names, or correct them."
        if _unnamed(data):
            how = "Nobody named the joints: layout=SKELETON gives them its names, in order."
        return [*lines, f"no names are alike. {how}"]
    of_ours = skeleton.name in shipped_names("skeletons")
    where = f"a copy of {shipped('skeletons') / skeleton.name}.yaml" if of_ours else "the skeleton's file"
    lines.append(f"# Guesses by name; nothing of it is applied. Keep what is right, without the #, in {where}:")
    lines += ["# from:", "#   my_tracker:"]
    for joint in skeleton.joints:
        if joint in guesses:
            parts = ", ".join(map(propose.quoted, guesses[joint]))
            lines.append(f"#     {propose.quoted(joint)}: {parts if len(guesses[joint]) == 1 else f'[{parts}]'}")
        elif joint not in skeleton.midpoints:
            lines.append(f"#     # {propose.quoted(joint)}: nothing is alike")
    return lines
