"""Files of lifted shapes, read back with other programs' readers: closed, sized, turned and named right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh
from shape_samples import AZIMUTH, OFFSET, SCALE, SCALE_PX, marked, shapes, view

from uplift.errors import UserError
from uplift.export import WRITERS, write, writer_for
from uplift.export.meshes import SHAPE_AXES
from uplift.geometry.surface import surface_of

_MARKS = {"front": (0, 0, -1), "left": (1, 0, 0), "up": (0, -1, 0)}
"""Of the object, in its own frame."""


def _read(path: Path) -> trimesh.Trimesh:
    found = trimesh.load(path, process=False)
    found = found.to_geometry() if isinstance(found, trimesh.Scene) else found
    assert isinstance(found, trimesh.Trimesh)
    found.merge_vertices(merge_norm=True, merge_tex=True)
    return found


def _horns(solid: trimesh.Trimesh, middle: np.ndarray) -> dict[str, np.ndarray]:
    """Return the directions of front, left and up: of the three farthest ends, in order of their length."""
    away = np.asarray(solid.vertices) - middle
    found = {}
    for name in _MARKS:
        length = np.linalg.norm(away, axis=1)
        corner = away[length.argmax()] / length.max()
        tip = away[(away @ corner > 0.9 * length) & (length > 0.9 * length.max())].mean(0)
        found[name] = tip / np.linalg.norm(tip)
        away = away[away @ found[name] < 0.8 * np.linalg.norm(away, axis=1)]
    return found


_EXPECTED = {
    "own": {"front": (0, 0, -1), "left": (1, 0, 0), "up": (0, -1, 0)},
    "gltf": {"front": (0, 0, 1), "left": (1, 0, 0), "up": (0, 1, 0)},
    "print": {"front": (0, -1, 0), "left": (1, 0, 0), "up": (0, 0, 1)},
    # As seen, level: the object is turned by its azimuth, up is up.
    "level": {
        "front": (-np.sin(AZIMUTH), 0, -np.cos(AZIMUTH)),
        "left": (np.cos(AZIMUTH), 0, -np.sin(AZIMUTH)),
        "up": (0, -1, 0),
    },
    "blender": {
        "front": (-np.sin(AZIMUTH), -np.cos(AZIMUTH), 0),
        "left": (np.cos(AZIMUTH), -np.sin(AZIMUTH), 0),
        "up": (0, 0, 1),
    },
    "opensim": {
        "front": (-np.sin(AZIMUTH), 0, np.cos(AZIMUTH)),
        "left": (np.cos(AZIMUTH), 0, np.sin(AZIMUTH)),
        "up": (0, 1, 0),
    },
    "camera": {name: tuple(view() @ np.array(way, float)) for name, way in _MARKS.items()},
}
_EXPECTED["opencv"] = _EXPECTED["camera"]


def test_every_axes_is_tested_and_right_handed() -> None:
    assert set(_EXPECTED) == set(SHAPE_AXES)
    for ways in _EXPECTED.values():
        front, left, up = (np.array(ways[name], float) for name in _MARKS)
        assert np.cross(up, front) @ left == pytest.approx(1)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
@pytest.mark.parametrize("axes", [None, *_EXPECTED])
def test_front_left_and_up_end_where_the_axes_have_them(tmp_path: Path, suffix: str, axes: str | None) -> None:
    ((path, told),) = write(shapes(), tmp_path / f"a{suffix}", axes=axes).items()
    solid, used = _read(path), axes or WRITERS["shapes"][suffix].axes
    assert told == "" and solid.is_watertight and solid.is_winding_consistent
    seen = used not in ("own", "gltf", "print")
    middle = np.array([*OFFSET, 0]) * SCALE_PX if seen else np.zeros(3)
    if used in ("level", "blender", "opensim"):
        rotation = np.stack([_EXPECTED[used][name] for name in _MARKS], 1) @ np.stack(list(_MARKS.values()), 1).T
        middle = rotation @ view().T @ middle
    for name, way in _horns(solid, middle).items():
        angle = np.degrees(np.arccos(np.clip(way @ np.array(_EXPECTED[used][name]), -1, 1)))
        assert angle < 5, (name, way)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_sizes_are_those_of_the_unit(tmp_path: Path, suffix: str) -> None:
    mesh = surface_of(marked(), finer=2, smooth=4).mesh
    assert mesh is not None
    own = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    high, longest = own.extents[1], own.extents.max()
    in_file = 0.001 if suffix == ".glb" else 1.0  # glTF's millimetres are metres
    cases = [
        ({}, SCALE * SCALE_PX),
        ({"unit": "crop"}, SCALE),
        ({"height_mm": 900}, 900 / high * in_file),
        ({"length_mm": 500.0, "unit": "mm"}, 500 / longest * in_file),
    ]
    for number, (options, factor) in enumerate(cases):
        (path,) = write(shapes(), tmp_path / f"{number}{suffix}", axes="own", **options)
        found = _read(path)
        np.testing.assert_allclose(found.extents, own.extents * factor, rtol=1e-4)
        assert found.volume == pytest.approx(own.volume * factor**3, rel=1e-3)


def test_a_mesh_in_the_camera_frame_covers_the_mask_it_came_from(tmp_path: Path) -> None:
    (path,) = write(shapes(), tmp_path / "a.ply", smooth=0)
    solid = _read(path)
    mesh = surface_of(marked(), finer=2).mesh
    assert mesh is not None
    seen = (SCALE * mesh.vertices @ view().T + [*OFFSET, 0]) * SCALE_PX
    np.testing.assert_allclose(np.sort(solid.bounds, 0), [seen.min(0), seen.max(0)], atol=0.01)


def test_items_of_a_scene_stand_side_by_side_under_their_names(tmp_path: Path) -> None:
    sample = shapes(3, ["chair.png", "b/chair.png:2", "chair.png"])
    sample.occupancy[1] *= 0.4
    ((path, told),) = write(sample, tmp_path / "all.glb").items()
    assert told == "without a surface: b/chair.png:2 (empty: the largest occupancy is 0.4, the surface lies at 0.5)"
    file = pygltflib.GLTF2().load(str(path))
    assert file is not None
    extras = file.asset.extras
    assert extras is not None
    assert [one["name"] for one in extras["items"]] == ["chair.png", "chair.png"]
    assert extras["unit"] == "px" and extras["axes"] == "gltf" and "y up" in extras["axes_are"]
    np.testing.assert_allclose(extras["items"][0]["view"], view(), atol=1e-5)
    assert extras["items"][0]["distance"] is None and file.asset.generator == "uplift"
    assert [node.name for node in file.nodes if node.mesh is not None] == ["1 chair.png", "2 chair.png"]
    assert all(primitive.attributes.NORMAL is not None for mesh in file.meshes for primitive in mesh.primitives)
    scene = trimesh.load(path)
    assert isinstance(scene, trimesh.Scene)
    boxes = sorted(one.bounds[:, 0].tolist() for one in scene.dump())
    assert boxes[0][1] < boxes[1][0]


def test_many_items_get_a_file_each(tmp_path: Path) -> None:
    assert len(write(shapes(17), tmp_path / "a.glb")) == 17
    assert len(write(shapes(17), tmp_path / "one.glb", together=True)) == 1
    paths = write(shapes(2, ["dir/a b.png:1", "dir/a b.png:1"]), tmp_path / "b.stl")
    assert [path.name for path in paths] == ["b_dir-a-b.png-1.stl", "b_dir-a-b.png-1_2.stl"]


def test_text_of_files_says_unit_axes_and_place(tmp_path: Path) -> None:
    sample = shapes(1, ["line\nbreak é"])
    (obj,) = write(sample, tmp_path / "a.obj")
    (ply,) = write(sample, tmp_path / "a.ply", length_mm=1200)
    (stl,) = write(sample, tmp_path / "a.stl")
    lines = obj.read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert any("unit: px (pixels" in line for line in comments) and any("axes: gltf (y up" in line for line in comments)
    assert all(line.split()[0] in ("#", "v", "vn", "f", "o") for line in lines if line.strip())
    head = ply.read_bytes().split(b"end_header")[0].decode("ascii")
    assert "comment unit: mm (millimetres, the longest side" in head and "comment axes: camera" in head
    assert "comment name: line break ?" in head
    assert stl.read_bytes()[:80].startswith(b"uplift, unit px, axes print, line")


def test_grids_come_back(tmp_path: Path) -> None:
    sample = shapes(2)
    sample.uncertainty = np.sqrt(sample.occupancy * (1 - sample.occupancy))
    for name in ("a", "b"):
        write(sample, tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    found = np.load(tmp_path / "a.npz", allow_pickle=False)
    np.testing.assert_array_equal(found["occupancy"], sample.occupancy)
    np.testing.assert_array_equal(found["masks"], sample.masks)
    np.testing.assert_allclose(found["uncertainty"], sample.uncertainty, atol=1e-3)
    np.testing.assert_allclose(found["view"], sample.view, atol=1e-6)
    assert found["names"].tolist() == sample.names and found["scale_px"].tolist() == [150, 150]


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("a.obi", {}, "no writer of shapes for '.obi'"),
        ("a", {}, "no extension"),
        ("a.obj", {"axes": "gltff"}, "Did you mean 'gltf'"),
        ("a.obj", {"unit": "pixels"}, "no such unit"),
        ("a.obj", {"unit": "mm"}, "Add height_mm= or length_mm="),
        ("a.obj", {"unit": "px", "height_mm": 3}, "do not go together"),
        ("a.obj", {"height_mm": -1}, "more than 0 mm"),
        ("a.obj", {"height_mm": 1, "length_mm": 1}, "give one"),
        ("a.obj", {"together": True}, "into one .glb"),
        ("a.obj", {"page": "gallery"}, "is an .html"),
        ("a.html", {"page": "galery"}, "no such page"),
        ("a.html", {"axes": "own"}, "axes= goes with the formats of meshes"),
        ("a.npz", {"unit": "px"}, "unit= goes with the formats of meshes"),
        ("a.stl", {"notes": ["x"]}, "notes= is for a page"),
        ("no/a.stl", {}, "does not exist"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, name: str, options: dict, told: str) -> None:
    with pytest.raises(UserError, match=told):
        write(shapes(), tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten_and_empty_shapes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("mine")
    (tmp_path / "b_item-1.stl").write_text("mine")
    for name, count in (("a.stl", 1), ("b.stl", 2)):
        with pytest.raises(UserError, match="not overwritten"):
            write(shapes(count), tmp_path / name)
    assert {path.read_text() for path in tmp_path.iterdir()} == {"mine"}
    empty = shapes()
    empty.occupancy[:] = 0
    with pytest.raises(UserError, match="no surface to write: empty"):
        write(empty, tmp_path / "c.glb")


def test_writers_are_found_by_extension() -> None:
    assert writer_for("a.GLB", of="shapes") is WRITERS["shapes"][".glb"]
    assert writer_for("a.html", "gallery", "shapes").where.endswith("write_shape_gallery")


def test_the_example_of_the_documents_runs(here: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs/shapes-output.md").read_text()
    (example,) = re.findall(r"^```py\n(.*?)^```$", text, re.M | re.S)
    exec(example, {})
    assert _read(here / "ball.stl").extents.max() == pytest.approx(60, rel=1e-3)
    assert "A ball." in (here / "ball.html").read_text()
    assert [ending for ending in WRITERS["shapes"] if f"| `{ending}` |" not in text] == []
    assert [axes for axes in SHAPE_AXES if f"`{axes}`" not in text] == []
