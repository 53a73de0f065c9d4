"""The verb data render: masks of meshes, or of simulated shapes, with exact truth."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uplift.cli.parsing import Keys, keyed
from uplift.config.files import building, refuse_output
from uplift.errors import UserError, did_you_mean

if TYPE_CHECKING:
    from uplift.data.masks import MaskData
    from uplift.data.synthetic.masks import ViewChoice
    from uplift.geometry.mesh import Mesh

__all__ = ["render_masks_command"]

_VERB = "data render"
_FILE_KEYS = ("poses", "animations", "up", "front")
_MOST_BYTES = 4_000_000_000


def render_masks_command(words: Sequence[str]) -> list[str]:
    """Render masks into an .npz file, or a folder of .png files with ``truth.npz``; return what to print."""
    from uplift.data.formats.masks_npz import write_masks_npz
    from uplift.data.synthetic.masks import FAMILIES, simulate_masks

    keys = keyed(_VERB, words)
    if not keys.plain:
        raise UserError(
            f"{_VERB} takes files of meshes, folders of them, or simulated shapes ({', '.join(FAMILIES)}), "
            f"and output=FILE.npz or output=FOLDER. (uplift {_VERB} --help)"
        )
    items, side, seed, each = (keys.value(key) for key in ("items", "side", "seed", "views"))
    if items * side**2 > _MOST_BYTES:
        raise UserError(f"{_VERB}: items={items} of side={side} take {items * side**2 / 1e9:,.0f} GB. Ask for fewer.")
    views, output = _views(keys), _output(keys)
    shapes, about = _shapes(keys, -(-items // each), seed)
    data = simulate_masks(shapes, items, seed=seed, side=side, views=views, views_per_shape=each)
    if "category" in keys:
        data = replace(data, category=np.full(items, keys["category"]))
    if output.suffix == ".npz":
        write_masks_npz(data, output)
        wrote = f"wrote {output}: {items:,} masks of {side} x {side} px, with the shapes they show"
    else:
        with building(output) as folder:
            _write_folder(data, folder)
        wrote = f"wrote {output}: {items:,} .png files of {side} x {side} px, and truth.npz with the shapes they show"
    return [about, wrote, f"next: uplift fit task=masks data.train={output}"]


def _shapes(keys: Keys, count: int, seed: int) -> tuple[list[Mesh] | str, str]:
    """Return a family's name, or the meshes of files in a random order; and a line on them."""
    from uplift.data.parsers.meshes import ENDINGS, MeshOptions, find_mesh_files, read_meshes
    from uplift.data.synthetic.masks import FAMILIES

    sources = keys.plain
    families = [source for source in sources if source in FAMILIES]
    if families:
        if len(sources) > 1:
            raise UserError(
                f"{_VERB}: '{families[0]}' is a family of simulated shapes and goes alone. "
                f"Render {' and '.join(sources[:3])} apart. (A folder of that name: ./{families[0]})"
            )
        for key in [key for key in _FILE_KEYS if key in keys]:
            raise UserError(f"{_VERB}: {key}= goes with files of meshes, not with the family '{families[0]}'.")
        return families[0], f"{count:,} simulated shapes of '{families[0]}'"
    for source in sources:
        if not Path(source).expanduser().exists() and Path(source).suffix.lower() not in ENDINGS:
            raise UserError(f"{_VERB}: no file, folder or family of shapes '{source}'.{did_you_mean(source, FAMILIES)}")
    options = MeshOptions(
        up=keys.value("up"),
        front=keys.value("front"),
        poses=keys.value("poses"),
        animations=tuple(part for part in keys.value("animations") if part.strip("-")),
        seed=seed,
        category=keys.get("category"),
        most=count,
    )
    meshes = read_meshes(sources, options)
    files = min(len(find_mesh_files(sources)), count)
    about = f"{len(meshes):,} mesh{'es' * (len(meshes) > 1)} of {files:,} file{'s' * (files > 1)}"
    order = np.random.default_rng(seed).permutation(len(meshes))
    return [meshes[row].in_unit() for row in order], about


def _views(keys: Keys) -> ViewChoice:
    from uplift.data.synthetic.masks import ViewChoice

    views = ViewChoice(upright=keys.value("upright") == "true")
    if not views.upright:
        for key in [key for key in ("azimuth_deg", "elevation_deg") if key in keys]:
            raise UserError(f"{_VERB}: upright=false draws from all rotations, {key}= has no effect. Leave one out.")
    if "azimuth_deg" in keys:
        views = replace(views, azimuth_deg=keys.value("azimuth_deg"))
    if "elevation_deg" in keys:
        mean, sd = keys.value("elevation_deg")
        low, high = views.elevation_deg
        # The range cuts off what is rare: it must not cut off what is asked for.
        wide = (max(min(low, mean - 2 * sd), -90.0), min(max(high, mean + 2 * sd), 90.0))
        views = replace(views, elevation_mean_deg=mean, elevation_sd_deg=sd, elevation_deg=wide)
    if "distance" in keys:
        views = replace(views, distance=keys.value("distance"))
    return views


def _output(keys: Keys) -> Path:
    output = Path(keys["output"]).expanduser()
    if output.suffix.lower() not in ("", ".npz"):
        raise UserError(f"{_VERB}: output={output}: expected a file that ends in .npz, or a folder.")
    if output.suffix.lower() == ".npz" or not output.exists():
        refuse_output(output)
    elif not output.is_dir() or any(output.iterdir()):
        raise UserError(f"{output} exists already and is not empty: remove it or choose another name.")
    return output


def _write_folder(data: MaskData, folder: Path) -> None:
    from PIL import Image

    from uplift.data.formats.masks_npz import write_masks_npz

    digits = len(str(len(data) - 1))
    kinds = [""] * len(data) if data.category is None else [_plain(str(kind)) for kind in data.category]
    several = len(set(kinds)) > 1
    names = []
    for item, (mask, name) in enumerate(zip(data.masks, data.names, strict=True)):
        # Sub-folders are categories to the reader of such folders.
        below = Path(kinds[item] or "other") if several else Path()
        (folder / below).mkdir(parents=True, exist_ok=True)
        names.append((below / f"{_plain(re.sub(r':[0-9]+$', '', name))}_{item:0{digits}d}.png").as_posix())
        Image.fromarray(mask).save(folder / names[-1])
    write_masks_npz(replace(data, names=names), folder / "truth.npz")


def _plain(name: str) -> str:
    """Return a name that any disk takes."""
    return re.sub(r"[^\w.-]+", "_", name).lstrip(".")[:80]
