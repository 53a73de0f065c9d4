"""Mesh files: kinds, axes, poses, folders, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_files import QUARTER, Glb, animate
from hypothesis import given
from hypothesis import strategies as st
from trimesh.exchange.gltf import export_gltf

from uplift.data.parsers.meshes import ENDINGS, MeshOptions, axes_to_own, find_mesh_files, read_meshes
from uplift.errors import UserError
from uplift.geometry.voxels import fill

AXES = ("x", "y", "z", "-x", "-y", "-z")


def wedge() -> trimesh.Trimesh:
    """Return a closed shape without any symmetry, long along x, 1 x 2 x 3 its corners' reach."""
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1], [0.5, 1, 0.7]])
    return trimesh.convex.convex_hull(points)


def write_glb(path: Path, *animations: str) -> Path:
    """Write the wedge as one node, split at its edges as exporters do, turning in each animation."""
    made, mesh = Glb(), wedge()
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    made.tree |= {"meshes": [{"primitives": [{"attributes": {"POSITION": made.put(corners)}}]}], "nodes": [{"mesh": 0}]}
    for name in animations:
        animate(made, 0, "rotation", [0.0, 2.0], [[0, 0, 0, 1], QUARTER], name=name)
    return made.write(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_ending_gives_the_same_solid(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"wedge{ending}"
    if ending == ".glb":
        write_glb(path)
    elif ending == ".gltf":
        for name, content in export_gltf(trimesh.Scene(wedge())).items():
            (tmp_path / name.replace("model.gltf", path.name)).write_bytes(content)
    else:
        wedge().export(path)
    (mesh,) = read_meshes(path)
    found = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert found.is_watertight
    assert len(mesh.vertices) == 5
    assert (mesh.name, mesh.category) == ("wedge", "wedge")
    # A rotation: the volume is as large and not turned inside out.
    np.testing.assert_allclose(found.volume, wedge().volume, rtol=1e-5)
    np.testing.assert_allclose(found.bounds, [[0, -2, -1], [3, 0, 0]], atol=1e-5)


@given(up=st.sampled_from(AXES), front=st.sampled_from(AXES))
def test_axes_are_proper_rotations_that_put_up_and_front_right(up: str, front: str) -> None:
    if up[-1] == front[-1]:
        with pytest.raises(UserError, match="are one axis"):
            axes_to_own(up, front)
        return
    turn = axes_to_own(up, front)
    axes = {name: np.eye(3)["xyz".index(name[-1])] * (-1 if name[0] == "-" else 1) for name in AXES}
    np.testing.assert_array_equal(turn @ axes[up], [0, -1, 0])
    np.testing.assert_array_equal(turn @ axes[front], [0, 0, -1])
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)


def test_a_file_with_z_up_is_the_one_with_y_up(tmp_path: Path) -> None:
    mesh = wedge()
    mesh.export(tmp_path / "y.ply")
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))  # y to z, z to -y
    mesh.export(tmp_path / "z.ply")
    (first,), (second,) = read_meshes(tmp_path / "y.ply"), read_meshes(tmp_path / "z.ply", MeshOptions(up="z"))
    np.testing.assert_allclose(
        first.vertices[np.lexsort(first.vertices.round(4).T)],
        second.vertices[np.lexsort(second.vertices.round(4).T)],
        atol=1e-5,
    )
    with pytest.raises(UserError, match="up=w: expected one of x"):
        read_meshes(tmp_path / "y.ply", MeshOptions(up="w"))


def test_poses_are_drawn_over_all_animations(tmp_path: Path) -> None:
    path = write_glb(tmp_path / "cat.glb", "Rig|walk", "Rig|run", "rest")
    found = read_meshes(path, MeshOptions(poses=7, seed=3))
    counts = {name: sum(f" {name} " in mesh.name for mesh in found) for name in ("walk", "run", "rest")}
    assert sorted(counts.values()) == [2, 2, 3]
    assert {mesh.category for mesh in found} == {"cat"}
    assert len({mesh.vertices.tobytes() for mesh in found}) == 7
    for mesh in found:
        angle = np.pi / 4 * float(mesh.name.split()[-1][:-1])
        tip = mesh.vertices[np.linalg.norm(mesh.vertices, axis=1).argmax()]
        np.testing.assert_allclose(tip, [3 * np.cos(angle), -3 * np.sin(angle), 0], atol=0.03)
    again = read_meshes([path, write_glb(tmp_path / "dog.glb")], MeshOptions(poses=7, seed=3))
    assert [mesh.name for mesh in again] == [*(mesh.name for mesh in found), "dog"]
    for parts, left in ((("walk", "RUN"), {"walk", "run"}), (("-Walk",), {"run", "rest"})):
        some = read_meshes(path, MeshOptions(poses=6, animations=parts))
        assert {mesh.name.split()[1] for mesh in some} == left
    with pytest.raises(UserError, match=r"animations=fly leaves none of its animations. Valid: Rig\|walk"):
        read_meshes(path, MeshOptions(animations=("fly",)))
    (rest,) = read_meshes(path, MeshOptions(poses=0, category="feline"))
    assert (rest.name, rest.category) == ("cat", "feline")


def test_folders_are_read_whole_and_name_categories(tmp_path: Path) -> None:
    (tmp_path / "set/chair/a1").mkdir(parents=True)
    for name in ("set/chair/a1/model.obj", "set/lamp.stl", "set/.hidden.obj", "set/notes.txt"):
        wedge().export(tmp_path / name, file_type=name[-3:].replace("txt", "obj"))
    files = find_mesh_files(tmp_path / "set")
    assert [(path.name, category) for path, category in files] == [("model.obj", "chair"), ("lamp.stl", "lamp")]
    assert len(read_meshes([tmp_path / "set", tmp_path / "set/lamp.stl"])) == 2
    drawn = {read_meshes(tmp_path / "set", MeshOptions(most=1, seed=seed))[0].name for seed in range(8)}
    assert drawn == {"model", "lamp"}


def write_off(path: Path, header: str, two_sided: bool = False) -> None:
    """Write a chair of one seat and one back as ModelNet has it: z up, looking along -y, triangles of no common order."""
    parts = [trimesh.creation.box((1, 1, 0.2)), trimesh.creation.box((1, 0.2, 1)).apply_translation((0, 0.4, 0.5))]
    mesh = trimesh.util.concatenate(parts)
    faces = np.concatenate([mesh.faces, mesh.faces[:, ::-1]]) if two_sided else mesh.faces
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [" ".join(map(str, point)) for point in mesh.vertices.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    path.write_text("\n".join([header.format(len(mesh.vertices), len(faces)), *lines, ""]))


def test_a_data_set_in_the_layout_of_modelnet(tmp_path: Path) -> None:
    write_off(tmp_path / "ModelNet10/chair/train/chair_0001.off", "OFF\n{} {} 0")
    write_off(tmp_path / "ModelNet10/chair/test/chair_0890.off", "OFF{} {} 0")
    write_off(tmp_path / "ModelNet10/night_stand/train/night_stand_0001.off", "OFF{} {} 0", two_sided=True)
    (tmp_path / "ModelNet10/README.txt").write_text("by its authors")
    expected = {"chair_0001": "chair", "chair_0890": "chair", "night_stand_0001": "night_stand"}
    assert {path.stem: category for path, category in find_mesh_files(tmp_path / "ModelNet10")} == expected
    # A category, or a split of one: the shapes are still chairs.
    for below, count in (("chair", 2), ("chair/train", 1), ("chair/test/chair_0890.off", 1)):
        found = find_mesh_files(tmp_path / "ModelNet10" / below)
        assert [category for _, category in found] == ["chair"] * count
    for mesh in read_meshes(tmp_path / "ModelNet10", MeshOptions(up="z")):
        # In its own frame the seat is below (y down) and the back behind (z) its middle.
        inside = fill(mesh.in_unit(), 40)
        z, y, _ = np.argwhere(inside).mean(0)
        assert y > 21 and z > 21
        assert inside.mean() == pytest.approx(0.9**3 * (0.2 + 0.18) / 1.1 / 1.1 / 1.1, rel=0.2)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
VERTICES = "v 0 0 0\nv 1 0 0\nv 0 1 1\nv 1 1 0\n"
WRONG = {
    "letter.obj": ("Dear all,\nfind the mesh attached.\n", "no triangles"),
    "nothing.obj": ("", "no triangles"),
    "points.obj": (VERTICES, "no triangles"),
    "points.ply": (f"{PLY}0 0 0\n1 0 0\n0 1 1\n", "no triangles"),
    "far.obj": (f"{VERTICES}f 1 2 9\n", "damaged, or not a .obj file"),
    "far.off": (
        "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 1\n3 0 1 7\n",
        "damaged, or not a .off file|a vertex of 3 that does not",
    ),
    "nan.obj": (f"{VERTICES}v nan 0 0\nf 1 2 3\nf 1 2 5\n", "1 of 4 vertices are not finite"),
    "flat.obj": (f"{VERTICES}f 1 2 3\n", "flat"),
    "corners of two numbers.obj": ("v 0 0\nv 1 0\nv 0 1\nv 1 1\nf 1 2 3\nf 1 2 4\n", "2 numbers each, expected 3"),
    "one corner.obj": ("v 0 0 0\nf 1 1 1\n", "flat"),
    "an edge.obj": ("v 0 0 0\nv 1 0 0\nf 1 2 1\n", "flat"),
    "dot.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "flat"),
    "cut.stl": ("\0" * 80 + "\x7f\x7f\0\0", "no triangles"),
    "cut.ply": (PLY.replace("ascii", "binary_little_endian"), "damaged, or not a .ply file"),
    "other.glb": (VERTICES, "does not begin with 'glTF'"),
    "animal.fbx": ("Kaydara FBX Binary", "Export others as .glb"),
}


@pytest.mark.parametrize("name", WRONG)
def test_other_files_are_refused(name: str, tmp_path: Path) -> None:
    content, message = WRONG[name]
    (tmp_path / name).write_text(content)
    with pytest.raises(UserError, match=message) as refused:
        read_meshes(tmp_path / name)
    assert name in str(refused.value)


@pytest.mark.parametrize("ending", [".stl", ".ply", ".glb"])
def test_files_that_are_cut_off_are_refused(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    if ending == ".glb":
        write_glb(path)
    else:
        wedge().export(path)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(UserError, match="damaged"):
        read_meshes(path)


def test_places_without_meshes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no mesh files in this folder"):
        read_meshes(tmp_path)
    with pytest.raises(UserError, match="no such file or folder"):
        read_meshes(tmp_path / "none.obj")
    with pytest.raises(UserError, match="no meshes given"):
        read_meshes([])


def test_no_other_file_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd picture.png\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl m\n{VERTICES}f 1 2 3\nf 1 2 4\n")
    read_meshes(tmp_path / "a.obj")  # the imports are done
    opened = []
    whole = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: opened.append(path.name) or whole(path))
    monkeypatch.setattr("builtins.open", lambda *found, **more: pytest.fail(f"opened {found}"))
    assert len(read_meshes(tmp_path / "a.obj")[0].faces) == 2
    assert opened == ["a.obj"]
