"""Masks in npz files: what is written is read, and whatever is wrong is one clear error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats.masks_npz import read_masks_npz, write_masks_npz
from uplift.data.masks import MaskData
from uplift.data.synthetic.masks import render_masks, simulate_masks
from uplift.errors import UserError


@pytest.fixture(scope="module")
def data() -> MaskData:
    return simulate_masks("furniture", 5, seed=3, side=32, views_per_shape=2)


def _changed(data: MaskData, path: Path, **changes: object) -> Path:
    """Write the data with some arrays changed, or left out where None."""
    write_masks_npz(data, path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def test_what_is_written_is_read(data: MaskData, tmp_path: Path) -> None:
    path = tmp_path / "masks.npz"
    data.labelled = np.array([True, False, True, False, False])
    data.notes = ("Two were skipped.",)
    write_masks_npz(data, path)
    read = read_masks_npz(path)
    np.testing.assert_array_equal(read.masks, data.masks)
    assert read.names == data.names
    assert read.notes == data.notes
    for name in ("centre_px", "scale_px", "category", "labelled"):
        np.testing.assert_array_equal(getattr(read, name), getattr(data, name))
    assert read.truth is not None
    assert data.truth is not None
    for name in ("shape", "view", "scale", "offset", "distance"):
        np.testing.assert_array_equal(getattr(read.truth, name), getattr(data.truth, name))
    for mesh, expected in zip(read.truth.meshes, data.truth.meshes, strict=True):
        np.testing.assert_allclose(mesh.vertices, expected.vertices, atol=1e-7)
        np.testing.assert_array_equal(mesh.faces, expected.faces)
        assert (mesh.name, mesh.category) == (expected.name, expected.category)
    truth = read.truth
    own = truth.distance / truth.scale
    masks, _ = render_masks(truth.meshes, truth.shape, truth.view.astype(float), own.astype(float), 32)
    assert np.abs(masks.astype(int) - data.masks).mean() < 0.5


def test_the_same_data_gives_the_same_bytes(data: MaskData, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        write_masks_npz(data, tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_masks_alone_are_enough(tmp_path: Path) -> None:
    np.savez(tmp_path / "own.npz", masks=np.full((2, 16, 16), 255, np.uint8))
    read = read_masks_npz(tmp_path / "own.npz")
    assert read.truth is None
    assert read.names == ["own:0", "own:1"]
    assert read.centre_px.tolist() == [[8, 8], [8, 8]]
    assert read.scale_px.tolist() == [8, 8]


def test_parallel_rays_keep_their_infinite_distance(tmp_path: Path, data: MaskData) -> None:
    path = _changed(data, tmp_path / "far.npz", distance=np.full(5, np.inf, np.float32))
    truth = read_masks_npz(path).truth
    assert truth is not None
    assert np.isinf(truth.distance).all()


_WRONG = {
    "no masks": ({"masks": None}, "no array 'masks'"),
    "masks of bool": ({"masks": np.ones((5, 8, 8), bool)}, r"'masks' is bool of shape \(5, 8, 8\), expected uint8"),
    "masks not square": ({"masks": np.ones((5, 8, 9), np.uint8)}, "expected uint8 "),
    "no items": ({"masks": np.ones((0, 8, 8), np.uint8)}, "expected uint8 "),
    "unknown": ({"colour": np.ones(5)}, "unknown array 'colour'"),
    "pickle": ({"names": np.array([{}] * 5, object)}, "pickled"),
    "names": ({"names": np.arange(5)}, r"'names' is int64 of shape \(5,\), expected text"),
    "few names": ({"names": np.array(["a"])}, "expected text of shape"),
    "bytes": ({"category": np.array([b"\xff"] * 5)}, "'category' .* expected text"),
    "notes": ({"notes": np.ones(2)}, "'notes' .* expected text"),
    "centre": ({"centre_px": np.full((5, 2), np.nan)}, r"'centre_px' is nan at \[0, 0\], expected finite"),
    "scale_px": ({"scale_px": np.zeros(5)}, r"'scale_px' is 0 at \[0\], expected numbers above 0"),
    "labelled": ({"labelled": np.ones(5)}, "'labelled' .* expected true or false"),
    "part of the truth": ({"view": None}, "the truth lacks 'view'"),
    "shape": ({"shape": np.full(5, 3)}, "'shape' goes from 3 to 3, expected 0 to 2"),
    "shape of floats": ({"shape": np.zeros(5)}, "expected whole numbers"),
    "view": ({"view": np.ones((5, 3, 3))}, "'view' of item 0 is not a rotation"),
    "mirror": ({"view": np.tile(-np.eye(3), (5, 1, 1))}, "is not a rotation"),
    "scale": ({"scale": np.full(5, -1.0)}, "'scale' is -1"),
    "offset": ({"offset": np.full((5, 2), np.inf)}, "'offset' is inf"),
    "huge": ({"offset": np.full((5, 2), 1e300)}, "'offset' is inf"),
    "distance": ({"distance": np.zeros(5)}, "'distance' is 0"),
    "vertices": ({"mesh_vertices": np.ones((4, 2))}, "'mesh_vertices' .* expected numbers"),
    "starts": ({"mesh_vertex_start": np.array([0, 5])}, "'mesh_vertex_start' must rise from 0 to"),
    "no starts": ({"mesh_face_start": np.array([], int)}, "'mesh_face_start' must rise from 0 to"),
    "faces below": ({"mesh_faces": np.full((9, 3), -1)}, "'mesh_faces' goes from -1"),
    "mesh names": ({"mesh_names": np.array(["a"])}, "'mesh_names' .* expected text"),
}


@pytest.mark.parametrize("case", _WRONG)
def test_wrong_files_are_refused(case: str, data: MaskData, tmp_path: Path) -> None:
    changes, message = _WRONG[case]
    with pytest.raises(UserError, match=message):
        read_masks_npz(_changed(data, tmp_path / "wrong.npz", **changes))


def test_faces_of_another_mesh_are_refused(data: MaskData, tmp_path: Path) -> None:
    assert data.truth is not None
    faces = np.concatenate([mesh.faces for mesh in data.truth.meshes])
    faces[0] = len(data.truth.meshes[0].vertices)
    with pytest.raises(UserError, match="'mesh_faces' of mesh 0 goes up to"):
        read_masks_npz(_changed(data, tmp_path / "wrong.npz", mesh_faces=faces))


def test_fewer_starts_of_faces_than_meshes(data: MaskData, tmp_path: Path) -> None:
    assert data.truth is not None
    total = sum(len(mesh.faces) for mesh in data.truth.meshes)
    with pytest.raises(UserError, match="has 1 meshes, expected 3"):
        read_masks_npz(_changed(data, tmp_path / "wrong.npz", mesh_face_start=np.array([0, total])))


def test_no_file_and_a_damaged_one(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="No file"):
        read_masks_npz(tmp_path / "none.npz")
    (tmp_path / "half.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(UserError, match="cannot be read as an .npz file"):
        read_masks_npz(tmp_path / "half.npz")
