"""Photos on shapes: each point has the colour of the pixel that shows it, its mirror image's, or a soft one; never the background's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from shape_samples import OFFSET, SCALE, mask_of, shapes, view

from uplift.errors import UserError
from uplift.export import write
from uplift.models.prediction import ShapePrediction

_SIDE, _BACKGROUND = 640, (255, 0, 255)


def _horse(distance: float, lopsided: bool = False) -> ShapePrediction:
    """Return a long body with a head, its own mirror image unless it is ``lopsided``."""
    line = (2 * np.arange(32) + 1) / 32 - 1
    z, y, x = np.meshgrid(line, line, line, indexing="ij")
    grid = (np.abs(x) < 0.25) & (np.abs(y) < 0.3) & (np.abs(z) < 0.75)
    grid |= (np.abs(x) < 0.15) & (y < 0) & (y > -0.7) & (z < -0.5) & (z > -0.75)
    grid |= lopsided & (np.abs(y) < 0.2) & (x > 0) & (x < 0.8) & (z > 0.4) & (z < 0.7)
    grid = grid.astype(np.float32)
    sample = replace(shapes(1, distance=distance), occupancy=grid[None], masks=mask_of(grid, distance)[None])
    sample.images = np.array(["photo.png"])
    return sample


def _photo(folder: Path, sample: ShapePrediction) -> None:
    """Write a photo whose red runs across and green down the crop, where the mask has the object; 170..470 px is the crop."""
    down, across = np.mgrid[:_SIDE, :_SIDE]
    of_crop = [np.clip((at - 170 + 0.5) / 300, 0, 1) for at in (across, down)]
    pixels = np.stack([255 * of_crop[0], 255 * of_crop[1], np.full_like(of_crop[0], 40)], -1)
    place = [np.clip((of * 64).astype(int), 0, 63) for of in of_crop]
    pixels[sample.masks[0][place[1], place[0]] < 128] = _BACKGROUND
    Image.fromarray(np.rint(pixels).astype(np.uint8)).save(folder / "photo.png")


def _expected(points: np.ndarray, distance: float) -> np.ndarray:
    """Return the colours that the photo has where points of the shape's frame are seen, by hand."""
    seen = SCALE * points @ view().T + [*OFFSET, 0]
    flat = seen[:, :2] / (1 + seen[:, 2:] / distance)
    return np.column_stack([255 * (flat + 1) / 2, np.full(len(flat), 40)])


def _written(folder: Path, sample: ShapePrediction, suffix: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, normals and colours of a file in the shape's own frame, read by trimesh; colours between pixels."""
    _photo(folder, sample)
    (path,) = write(sample, folder / f"a{suffix}", axes="own", unit="crop", images=folder)
    scene = trimesh.load(path, process=False)
    solid = scene.to_geometry() if isinstance(scene, trimesh.Scene) else scene
    assert isinstance(solid, trimesh.Trimesh)
    if suffix == ".glb":
        picture = np.asarray(solid.visual.material.baseColorTexture.convert("RGB")).astype(float)
        at = solid.visual.uv * [1, -1] + [0, 1]
        x, y = (np.clip((at[:, k] * picture.shape[1 - k]).astype(int), 0, None) for k in (0, 1))
        colours = picture[y, x]
    else:
        colours = np.asarray(solid.visual.vertex_colors)[:, :3].astype(float)
    return np.asarray(solid.vertices) / SCALE, np.asarray(solid.vertex_normals), colours


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj"])
@pytest.mark.parametrize("distance", [np.inf, 3.0])
def test_what_is_seen_has_the_colours_of_its_pixels(tmp_path: Path, suffix: str, distance: float) -> None:
    points, normals, colours = _written(tmp_path, _horse(distance), suffix)
    camera = view().T @ [0, 0, -1.0]
    seen = (normals @ camera > 0.5) & (points[:, 0] * np.sign(camera[0]) > 0.2)  # the near flank: nothing is before it
    assert seen.sum() > 300
    off = np.abs(colours[seen] - _expected(points[seen], distance)).max(1)
    assert np.median(off) < 4 and np.quantile(off, 0.97) < 16
    assert np.quantile(np.abs(colours - _BACKGROUND).sum(1), 0.001) > 150  # the background is nowhere


def test_the_far_flank_has_the_colours_of_the_near_one_where_the_shape_is_its_own_mirror(tmp_path: Path) -> None:
    points, normals, colours = _written(tmp_path, _horse(np.inf), ".ply")
    camera = view().T @ [0, 0, -1.0]
    near = np.sign(camera[0])
    far = (normals[:, 0] * near < -0.9) & (points[:, 0] * near < -0.2) & (np.abs(points[:, 2]) < 0.6)
    assert far.sum() > 200
    off = np.abs(colours[far] - _expected(points[far] * [-1, 1, 1], np.inf)).max(1)
    assert np.median(off) < 4
    points, normals, colours = _written(tmp_path, _horse(np.inf, lopsided=True), ".obj")
    far = (normals[:, 0] * near < -0.9) & (points[:, 0] * near < -0.2) & (np.abs(points[:, 2]) < 0.6)
    mirrored = np.abs(colours[far] - _expected(points[far] * [-1, 1, 1], np.inf)).max(1)
    assert np.median(mirrored) > 8  # blurred colours of what is near, not a mirror image


def test_files_with_a_photo_stay_closed_and_photos_can_be_left_out(tmp_path: Path) -> None:
    sample = _horse(np.inf)
    _photo(tmp_path, sample)
    (path,) = write(sample, tmp_path / "a.glb", images=tmp_path)
    scene = trimesh.load(path)
    assert isinstance(scene, trimesh.Scene)
    solid = scene.to_geometry()
    assert isinstance(solid, trimesh.Trimesh)
    solid.merge_vertices(merge_norm=True, merge_tex=True)
    assert solid.is_watertight
    (plain,) = write(sample, tmp_path / "b.ply", images=tmp_path, texture=False)
    assert b"property uchar red" not in plain.read_bytes()[:2000]
    (other,) = write(sample, tmp_path / "c.ply")  # no photo lies where the prediction names it
    assert b"property uchar red" not in other.read_bytes()[:2000]
    for options, told in [
        ({"texture": True}, "was not found or read: photo.png"),
        ({"images": tmp_path / "none"}, "no such folder"),
    ]:
        with pytest.raises(UserError, match=told):
            write(sample, tmp_path / "d.glb", **options)
    with pytest.raises(UserError, match="no colours"):
        write(sample, tmp_path / "d.stl", texture=True)
    sample.images = None
    with pytest.raises(UserError, match="the masks name none"):
        write(sample, tmp_path / "d.glb", texture=True)
