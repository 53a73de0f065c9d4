"""Read masks of any known format: `read` tells which it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from uplift.errors import UserError, did_you_mean
from uplift.masks.base import Look, MaskFormat
from uplift.masks.container import MaskData
from uplift.masks.formats import FORMATS, format_named
from uplift.masks.options import MaskOptions
from uplift.readers.files import files_of

__all__ = ["guess_format", "read"]

_NOT_MASKS = {
    (".mp4", ".avi", ".mov", ".mkv", ".webm"): "a video. Cut its objects out first, and give the masks as pictures",
    (".glb", ".gltf", ".obj", ".ply", ".stl", ".off"): "a 3D model, no masks; `uplift data render` makes masks of models",
    (".csv", ".h5", ".slp", ".nwb", ".trc", ".c3d", ".bvh"): "a file of keypoints or motion, no masks",
    (".pt", ".pth", ".ckpt", ".onnx", ".safetensors"): "the weights of a network, no masks",
    (".zip", ".tar", ".gz", ".tgz", ".7z"): "an archive. Unpack it, and give the folder",
    (".xml",): "XML. Give the pictures of the masks (SegmentationObject in a VOC folder)",
}  # fmt: skip


def read(
    path: str | Path,
    *,
    format: str | None = None,
    side: int = 64,
    border: str = "skip",
    pieces: str = "skip",
    category: str | Sequence[str] | None = None,
    most: int | None = None,
    images: str | Path | None = None,
) -> MaskData:
    """Read a file or folder of masks, in the format that it is found or said to be in, and clean them.

    ``path`` may be several with commas, or a pattern. `MaskData.notes` say which format that was, what was
    assumed, and what was skipped, and why. ``category`` names those that are taken, ``most`` how many,
    ``images`` the folder of the photos.

    Raises:
        UserError: nothing there, no known format, files that are not what they look like, no mask that can be used.
    """
    categories = category.split(",") if isinstance(category, str) else list(category or ())
    options = MaskOptions(
        side=side,
        border=border,
        pieces=pieces,
        format=format,
        category=tuple(one.strip() for one in categories if one.strip()),
        most=most,
        images=None if images is None else str(images),
    )
    look = Look(files_of(path))
    found = guess_format(look) if format is None else _named(format)
    data = found.read(look.paths, options)
    if found.name != "npz":  # the layout of this project needs no word
        told = f"read as {found.title}" + ("" if format else f" (guessed; format={found.name})")
        data = replace(data, notes=(told, *data.notes))
    return replace(data, source=str(path))


def guess_format(look: Look) -> MaskFormat:
    """Return the first format that what was given looks like.

    Raises:
        UserError: files of no known format, or of several.
    """
    endings = sorted({path.suffix.lower() for path in look.paths if not path.is_dir()} & {".json", ".npz"})
    if endings and any(path.is_dir() or path.suffix.lower() != endings[0] for path in look.paths):
        raise UserError(f"{look.where} are files of several kinds. Give those of one kind at a time.")
    for name in FORMATS:
        if format_named(name).fits(look):
            return format_named(name)
    raise _no_format(look)


def _no_format(look: Look) -> UserError:
    known = f"Known formats: {', '.join(FORMATS)}; format=NAME says which it is."
    path = look.paths[0]
    for endings, what in _NOT_MASKS.items():
        if path.suffix.lower() in endings:
            return UserError(f"{path} is {what}.")
    if path.is_dir():
        inside = sorted(child.name for child in path.iterdir())
        if not inside:
            return UserError(f"{path} is an empty folder, expected pictures of masks in it.")
        shown = ", ".join(inside[:3]) + (", ..." if len(inside) > 3 else "")
        better = next((one for one in inside if one.endswith((".json", ".npz"))), None)
        hint = f" Give a file in it: {path / better}." if better else ""
        return UserError(f"{path} has no pictures of masks in it, only {shown}.{hint} {known}")
    if look.peek is None:
        return UserError(f"{path} is empty (0 bytes), expected masks.")
    if look.peek.npz_names:
        shown = ", ".join(look.peek.npz_names[:5])
        what = "keypoints" if "keypoints" in look.peek.npz_names else "no 'masks'"
        return UserError(f"{path} holds {what} (its arrays: {shown}), expected masks: (items, side, side) uint8.")
    if look.peek.json_sign:
        keys = ", ".join(look.peek.json_keys[:5]) or "nothing that has a name"
        return UserError(
            f"{path} is JSON without annotations (it has {keys}), expected COCO's, with 'segmentation'. {known}"
        )
    return UserError(
        f"{path} is a file of no known format (it begins {look.peek.text[:60] or look.peek.start[:16]!r}). {known}"
    )


def _named(name: str) -> MaskFormat:
    if name not in FORMATS:
        raise UserError(f"format={name}: no such format.{did_you_mean(name, FORMATS)} Known: {', '.join(FORMATS)}.")
    return format_named(name)
