"""glTF files: structure, skins, animations, morph targets, and files that are none."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh
from gltf_files import QUARTER, TRIANGLE, animate, arm, plain
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.data.parsers.gltf import GltfFile
from uplift.errors import UserError


def own(points) -> np.ndarray:
    return np.asarray(points) * [1, -1, -1]


def test_a_node_turns_scales_and_moves_its_mesh(tmp_path: Path) -> None:
    made = plain(translation=[10, 0, 0], rotation=QUARTER, scale=[2, 3, 1]).write(tmp_path / "a.glb")
    mesh = GltfFile.read(made).posed()
    np.testing.assert_allclose(mesh.vertices, own([[10, 0, 0], [10, 2, 0], [4, 0, 0.5]]), atol=1e-6)
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.name == "a"


def test_a_matrix_is_stored_by_columns_and_children_follow(tmp_path: Path) -> None:
    made = plain()
    root = {"children": [1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]}
    made.tree["nodes"] = [root, {"mesh": 0, "translation": [1, 1, 1], "name": "leaf"}]
    file = GltfFile.read(made.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(file.posed().vertices, own(np.add(TRIANGLE, [6, 7, 8])), atol=1e-6)
    np.testing.assert_allclose(file.node_positions()["leaf"], [6, -7, -8])


def test_mirrored_nodes_keep_the_outside_outside(tmp_path: Path) -> None:
    mesh = GltfFile.read(plain(scale=[-1, 1, 1]).write(tmp_path / "a.glb")).posed()
    assert mesh.faces.tolist() == [[2, 1, 0]]


def test_a_skin_bends_at_its_joint(tmp_path: Path) -> None:
    turn = [[0, 0, 0, 1], [*QUARTER]]
    file = GltfFile.read(animate(arm(), 2, "rotation", [0.0, 2.0], turn).write(tmp_path / "a.glb"))
    assert file.animations == {"bend": 2.0}
    np.testing.assert_allclose(file.posed().vertices, own([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), atol=1e-6)
    for time, angle in ((-1.0, 0), (0.5, 22.5), (1.0, 45), (2.0, 90), (9.0, 90)):
        hand = [1 + np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0]
        np.testing.assert_allclose(file.posed("bend", time).vertices[2], own(hand), atol=1e-6)
    np.testing.assert_allclose(file.node_positions("bend", 2.0)["elbow"], [1, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("how", "values", "middle"),
    [
        ("STEP", [[1, 0, 0], [3, 0, 0]], 1.0),
        ("LINEAR", [[1, 0, 0], [3, 0, 0]], 1.5),
        # Hermite with slopes 4 at the start and 0 at the end, at a quarter of two seconds.
        (
            "CUBICSPLINE",
            [[0, 0, 0], [1, 0, 0], [4, 0, 0], [0, 0, 0], [3, 0, 0], [0, 0, 0]],
            1 + 2 * 10 / 64 + 8 * 9 / 64,
        ),
    ],
)
def test_interpolation(how: str, values: list, middle: float, tmp_path: Path) -> None:
    file = GltfFile.read(animate(plain(), 0, "translation", [0, 2], values, how).write(tmp_path / "a.glb"))
    np.testing.assert_allclose(file.posed("bend", 0.5).vertices[0, 0], middle, rtol=1e-6)
    np.testing.assert_allclose(file.posed("bend", 5.0).vertices[0, 0], 3.0)


def test_morph_targets_move_vertices(tmp_path: Path) -> None:
    made = plain()
    made.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": made.put([[0, 0, 0], [0, 0, 0], [0, 4, 0]])}]
    made.tree["meshes"][0]["weights"] = [0.5]
    file = GltfFile.read(animate(made, 0, "weights", [0, 1], [0, 1]).write(tmp_path / "a.glb"))
    assert [-file.posed().vertices[2, 1], -file.posed("bend", 0.25).vertices[2, 1]] == [4.0, 3.0]


def test_strides_strips_normalised_and_sparse_numbers(tmp_path: Path) -> None:
    made = plain()
    square = np.array([[0, 0, 0], [127, 0, 0], [0, 127, 0], [127, 127, 0]])
    made.tree["meshes"][0]["primitives"] = [
        {"attributes": {"POSITION": made.put(square, "int8", stride=4, normalized=True)}, "mode": 5}
    ]
    rows, values = made.put([3], "uint8"), made.put([[-128, 127, 0]], "int8")
    made.tree["accessors"][2]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5121},
        "values": {"bufferView": values},
    }
    mesh = GltfFile.read(made.write(tmp_path / "a.glb")).posed()
    np.testing.assert_allclose(mesh.vertices, own([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 1, 0]]), atol=1e-6)
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3]]


def test_only_the_scene_is_shown_and_names_stay_apart(tmp_path: Path) -> None:
    made = plain(name="twin")
    made.tree["nodes"] += [{"mesh": 0, "name": "twin"}, {"mesh": 0}]
    file = GltfFile.read(made.write(tmp_path / "a.glb"))
    assert len(file.posed().faces) == 1
    assert set(file.node_positions()) == {"twin", "twin (2)", "node 2"}
    with pytest.raises(UserError, match="no animation 'walk'"):
        file.posed("walk")


def test_json_files_with_their_buffers_inside_or_beside_them(tmp_path: Path) -> None:
    made = plain()
    text = "data:application/octet-stream;base64," + base64.b64encode(made.data).decode()
    (tmp_path / "a b.bin").write_bytes(made.data)
    for uri in (text, "a%20b.bin"):
        tree = made.tree | {"buffers": [{"byteLength": len(made.data), "uri": uri}]}
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        np.testing.assert_allclose(GltfFile.read(tmp_path / "a.gltf").posed().vertices, own(TRIANGLE))
    for uri in ("../a.bin", "/etc/passwd", "https://a.b/c.bin", "none.bin"):
        tree = made.tree | {"buffers": [{"byteLength": len(made.data), "uri": uri}]}
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        with pytest.raises(UserError, match="its buffer"):
            GltfFile.read(tmp_path / "a.gltf")


def _circle(tree: dict) -> None:
    tree["nodes"] = [{"mesh": 0}, {"children": [2]}, {"children": [1]}]


BREAKS: dict[str, tuple[Callable[[dict], object], str]] = {
    "circle": (_circle, "form a circle"),
    "self": (lambda tree: tree["nodes"].append({"children": [1]}), "circle"),
    "parents": (lambda tree: tree["nodes"].extend([{"children": [0]}, {"children": [0]}]), "has two parents"),
    "child": (lambda tree: tree["nodes"].append({"children": [7]}), "refers to nodes 7, of 2"),
    "mesh": (lambda tree: tree["nodes"][0].update(mesh=True), "refers to meshes True"),
    "count": (lambda tree: tree["accessors"][0].update(count=10**11), "needs 1,200,000,000,000 bytes"),
    "huge": (lambda tree: tree["accessors"][0].update(count=10**30), "expected a whole number"),
    "empty": (
        lambda tree: tree["accessors"][0].pop("bufferView") or tree["accessors"][0].update(count=10**9),
        "no data",
    ),
    "index": (lambda tree: tree["accessors"][0].update(count=2), "refers to vertex 2, of 2"),
    "offset": (lambda tree: tree["bufferViews"][0].update(byteOffset=10**6), "its buffer has"),
    "stride": (lambda tree: tree["bufferViews"][0].update(byteStride=4), "4 apart"),
    "type": (lambda tree: tree["accessors"][0].update(componentType=[5126]), "component type"),
    "rotation": (lambda tree: tree["nodes"][0].update(rotation=[0, 0, 0, 0]), "length 0"),
    "nan": (lambda tree: tree["nodes"][0].update(scale=[float("nan")] * 3), "not 3 numbers"),
    "draco": (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "without compression"),
    "version": (lambda tree: tree.update(asset={"version": "1.0"}), "version '1.0'"),
    "nodes": (lambda tree: tree.update(nodes={"a": 1}), "not a list of objects"),
    "lines": (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=1), "no triangles"),
    "scene": (lambda tree: tree.update(scene=4), "refers to scenes 4"),
}


@pytest.mark.parametrize("kind", BREAKS)
def test_errors_name_what_is_wrong(kind: str, tmp_path: Path) -> None:
    made = plain()
    change, message = BREAKS[kind]
    change(made.tree)
    with pytest.raises(UserError, match=message):
        GltfFile.read(made.write(tmp_path / "a.glb"))


def test_missing_joints_and_keys_are_reported(tmp_path: Path) -> None:
    made = arm()
    made.tree["skins"][0]["joints"] = [1]
    with pytest.raises(UserError, match="refers to joint 1 of its skin"):
        GltfFile.read(made.write(tmp_path / "a.glb"))
    for times, values, message in (
        ([1, 1], [[0, 0, 0]] * 2, "do not increase"),
        ([0, 1], [[0, 0, 0]] * 3, "9 values for 2"),
    ):
        with pytest.raises(UserError, match=message):
            GltfFile.read(animate(plain(), 0, "scale", times, values).write(tmp_path / "a.glb"))


@settings(max_examples=150, deadline=None)
@given(at=st.integers(0, 10**6), found=st.binary(max_size=12), length=st.integers(0, 10**6))
def test_damaged_bytes_never_crash(
    at: int, found: bytes, length: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    turn = [[0, 0, 0, 1], [*QUARTER]]
    whole = animate(arm(), 2, "rotation", [0.0, 2.0], turn).bytes()
    at %= len(whole)
    damaged = whole[:at] + found + whole[at + len(found) :]
    path = tmp_path_factory.getbasetemp() / "damaged.glb"
    path.write_bytes(damaged[: length % len(damaged)] if length % 2 else damaged)
    try:
        file = GltfFile.read(path)
    except UserError as error:
        assert str(path) in str(error)
    else:
        for name, length_s in file.animations.items():
            assert len(file.posed(name, length_s / 2).faces)


def _places(tree: dict | list) -> list[tuple]:
    """Return the container and the key of every value of a tree."""
    found = []
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        found.append((tree, key))
        if isinstance(tree[key], dict | list):
            found += _places(tree[key])
    return found


ODD = [None, True, -1, 0, 2, 7, 0.5, 1e308, 10**9, 10**30, "x", "", [], {}, [0], [[]], {"a": 1}, [0, 0, 0], [1e308] * 3]


@settings(max_examples=300, deadline=None)
@given(place=st.integers(0, 10**4), value=st.sampled_from([*ODD, "gone"]))
def test_odd_structure_never_crashes(place: int, value: object, tmp_path_factory: pytest.TempPathFactory) -> None:
    made = animate(arm(), 2, "rotation", [0.0, 2.0], [[0, 0, 0, 1], [*QUARTER]])
    made.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": made.put(TRIANGLE)}]
    made.tree["meshes"][0]["weights"] = [0.5]
    made.tree |= {"scenes": [{"nodes": [0]}], "scene": 0}
    places = _places(made.tree)
    tree, key = places[place % len(places)]
    if value == "gone":
        del tree[key]
    else:
        tree[key] = value
    path = made.write(tmp_path_factory.getbasetemp() / "odd.glb")
    try:
        file = GltfFile.read(path)
    except UserError as error:
        assert str(path) in str(error)
    else:
        assert [len(file.posed(name, 1.0).faces) for name in file.animations] in ([], [1])


def test_an_animal_is_as_two_other_readers_have_it(benchmark_data: Callable[[str], Path]) -> None:
    path = benchmark_data("animal_meshes/Cow.glb")
    file, known = GltfFile.read(path), pygltflib.GLTF2().load(str(path))
    assert known is not None
    assert list(file.animations) == [animation.name for animation in known.animations]
    assert set(file.node_positions()) == {node.name for node in known.nodes}
    static = trimesh.load_mesh(path, process=False)
    mesh = file.posed()
    assert mesh.faces.shape == static.faces.shape
    # The nodes at rest are near to the pose the skin was bound in, which is all that trimesh has.
    np.testing.assert_allclose(own(mesh.vertices), static.vertices, atol=0.1)


@pytest.mark.parametrize("name", ["Alpaca", "Bull", "Cow", "Deer", "Donkey", "Husky", "ShibaInu", "Stag"])
def test_animals_look_ahead_and_have_their_left_at_the_left(name: str, benchmark_data: Callable[[str], Path]) -> None:
    file = GltfFile.read(benchmark_data(f"animal_meshes/{name}.glb"))
    walk = next(one for one in file.animations if one.endswith("|Walk"))
    for time in np.linspace(0, file.animations[walk], 4):
        bones, mesh = file.node_positions(walk, float(time)), file.posed(walk, float(time))
        assert bones["Head"][2] < bones["Body"][2] - 0.5
        assert bones["FrontUpperLeg.L"][0] > 0.1 > -0.1 > bones["FrontUpperLeg.R"][0]
        assert bones["Head"][1] < bones["FrontUpperLeg.L"][1] < 0
        # Bones are inside the body they move; the feet stand on the ground.
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        assert ((low < bones["Torso"]) & (bones["Torso"] < high)).all()
        assert abs(high[1]) < 0.3
