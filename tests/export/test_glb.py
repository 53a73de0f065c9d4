"""GLB: the file is what the specification says, and its keyframes put every joint and bone where the poses are."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from writers_samples import chain, prediction

from uplift.errors import UserError
from uplift.export.glb import bone_rotations, write_glb
from uplift.models.prediction import Prediction

pygltflib = pytest.importorskip("pygltflib")
trimesh = pytest.importorskip("trimesh")
_SIZES = {5126: 4, 5123: 2, 5125: 4}
_PARTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class Scene:
    """A file read back by pygltflib, its animation evaluated at keyframes."""

    def __init__(self, path: Path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.blob = self.file.binary_blob()
        self.names = [node.name for node in self.file.nodes]
        self.above = {child: n for n, node in enumerate(self.file.nodes) for child in node.children or []}
        (self.animation,) = self.file.animations
        self.keys = {}
        for channel in self.animation.channels:
            sampler = self.animation.samplers[channel.sampler]
            keys = self.values(sampler.input)[:, 0], self.values(sampler.output), sampler.interpolation
            assert (channel.target.node, channel.target.path) not in self.keys
            self.keys[channel.target.node, channel.target.path] = keys

    def values(self, number: int) -> np.ndarray:
        accessor = self.file.accessors[number]
        view = self.file.bufferViews[accessor.bufferView]
        kind = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[accessor.componentType]
        parts = _PARTS[accessor.type]
        found = np.frombuffer(self.blob, kind, accessor.count * parts, view.byteOffset + (accessor.byteOffset or 0))
        return found.reshape(-1, parts)

    def at(self, node: int, path: str, time: float) -> np.ndarray:
        usual = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}[path]
        if (node, path) not in self.keys:
            return np.array(getattr(self.file.nodes[node], path) or usual, float)
        times, values, _ = self.keys[node, path]
        return values[max(0, np.searchsorted(times, time + 1e-5) - 1)].astype(float)

    def world(self, name: str, time: float) -> np.ndarray:
        node, matrix = self.names.index(name), np.eye(4)
        while node is not None:
            own = np.eye(4)
            own[:3, :3] = Rotation.from_quat(self.at(node, "rotation", time)).as_matrix() * self.at(node, "scale", time)
            own[:3, 3] = self.at(node, "translation", time)
            matrix, node = own @ matrix, self.above.get(node)
        return matrix


def check_format(path: Path) -> None:
    """Check what the specification demands of the pieces that are used."""
    data = path.read_bytes()
    assert data[:4] == b"glTF" and int.from_bytes(data[4:8], "little") == 2
    assert int.from_bytes(data[8:12], "little") == len(data)
    length = int.from_bytes(data[12:16], "little")
    assert data[16:20] == b"JSON" and length % 4 == 0
    asset = json.loads(data[20 : 20 + length])
    assert data[24 + length : 28 + length] == b"BIN\0"
    binary = data[28 + length :]
    assert int.from_bytes(data[20 + length : 24 + length], "little") == len(binary) == asset["buffers"][0]["byteLength"]
    assert asset["asset"]["version"] == "2.0"
    used = set()
    for accessor in asset["accessors"]:
        view = asset["bufferViews"][accessor["bufferView"]]
        size = accessor["count"] * _PARTS[accessor["type"]] * _SIZES[accessor["componentType"]]
        assert size <= view["byteLength"] and view["byteOffset"] % 4 == 0 and accessor["count"] > 0
        assert view["byteOffset"] + view["byteLength"] <= len(binary)
        used.add(accessor["bufferView"])
    assert used == set(range(len(asset["bufferViews"])))
    for mesh in asset["meshes"]:
        (primitive,) = mesh["primitives"]
        assert {"min", "max"} <= set(asset["accessors"][primitive["attributes"]["POSITION"]])
        assert asset["bufferViews"][asset["accessors"][primitive["indices"]]["bufferView"]]["target"] == 34963
    (animation,) = asset["animations"]
    for sampler in animation["samplers"]:
        moments, values = asset["accessors"][sampler["input"]], asset["accessors"][sampler["output"]]
        assert {"min", "max"} <= set(moments) and moments["count"] == values["count"]
        assert "target" not in asset["bufferViews"][values["bufferView"]]


def check_places(sample: Prediction, scene: Scene, scale: float, places: np.ndarray, prefix: str = "") -> None:
    bones = sample.bone_indices
    for row in range(len(sample)):
        at = row / (sample.fps or 30)
        for joint, name in enumerate(sample.joint_names):
            found = scene.world(prefix + name, at)
            assert np.abs(found[:3, 3] - places[row, joint] * scale).max() < 1e-4
        for parent, child in bones:
            one, other = sample.joint_names[parent], sample.joint_names[child]
            ends = scene.world(f"{prefix}{one}-{other}", at) @ np.array([[0, 0], [0, 1], [0, 0], [1, 1]])
            assert np.abs(ends[:3].T - places[row, [parent, child]] * scale).max() < 2e-4


def test_keyframes_are_the_poses_in_metres(tmp_path: Path) -> None:
    root = np.cumsum(np.random.default_rng(0).normal(size=(25, 3)) * 30, 0)
    sample = prediction(frames=25, root=root, axes="opensim")
    write_glb(sample, tmp_path / "a.glb")
    check_format(tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    check_places(sample, scene, 0.001, sample.points)
    about = scene.file.asset.extras
    assert about["unit"] == "m" and about["fps"] == 30 and not about["fps_assumed"] and about["axes"] == "opensim"
    inputs = [times for times, *_ in scene.keys.values() if len(times) > 1]
    assert np.allclose(inputs[0], np.arange(25) / 30)


def test_a_viewer_without_animation_shows_the_first_frame(tmp_path: Path) -> None:
    sample = prediction(frames=5)
    write_glb(sample, tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb")
    assert set(sample.joint_names) <= set(scene.graph.nodes)
    low, high = sample.points[0].min(0) / 1000, sample.points[0].max(0) / 1000
    assert np.abs(scene.bounds - [low, high]).max() < 0.04
    for joint, name in enumerate(sample.joint_names):
        assert np.abs(scene.graph[name][0][:3, 3] - sample.points[0, joint] / 1000).max() < 1e-4


def test_sides_have_their_colours(tmp_path: Path) -> None:
    write_glb(prediction(frames=2), tmp_path / "a.glb")
    file = Scene(tmp_path / "a.glb").file
    colour = {
        node.name: file.materials[file.meshes[node.mesh].primitives[0].material].name
        for node in file.nodes
        if node.mesh is not None
    }
    assert colour["lhand"] == colour["neck-lhand"] == "left"
    assert colour["rfoot"] == colour["hip-rfoot"] == "right"
    assert colour["hip"] == colour["neck-head"] == "centre"


def test_individuals_stand_apart_and_are_named(tmp_path: Path) -> None:
    sample = prediction(frames=4, individuals=2, axes="camera")
    write_glb(sample, tmp_path / "a.glb")
    check_format(tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    assert {"animal 0", "animal 1", "animal 0:hip", "animal 1:hip"} <= set(scene.names)
    gap = scene.world("animal 1:hip", 0)[:3, 3] - scene.world("animal 0:hip", 0)[:3, 3]
    assert gap[0] == pytest.approx(1.0, abs=0.1) and np.abs(gap[1:]).max() < 0.1  # 200 px at 0.2 px a mm


@pytest.mark.parametrize("unit", ["px", "relative"])
def test_what_has_no_unit_is_as_large_as_a_person(unit: str, tmp_path: Path) -> None:
    sample = replace(prediction(frames=6), unit=unit)
    write_glb(sample, tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    places = np.array([[scene.world(name, row / 30)[:3, 3] for name in sample.joint_names] for row in range(6)])
    assert np.median(np.ptp(places, axis=1).max(1)) == pytest.approx(1.7, rel=1e-3)
    scale = scene.file.asset.extras["scale"]
    assert np.allclose(places, sample.pose * scale, atol=1e-4)


def test_what_is_not_known_is_hidden(tmp_path: Path) -> None:
    sample = prediction(frames=10)
    hand = sample.joint_names.index("lhand")
    sample.pose[3:6, hand] = np.nan
    sample.pose[8] = np.nan
    write_glb(sample, tmp_path / "a.glb")
    check_format(tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    size = {name: [np.linalg.det(scene.world(name, row / 30)[:3, :3]) for row in range(10)] for name in scene.names[1:]}
    for name, found in size.items():
        gone = {8} | ({3, 4, 5} if "lhand" in name else set())
        assert [row for row in range(10) if abs(found[row]) < 1e-9] == sorted(gone), name
    assert scene.keys[scene.names.index("lhand"), "scale"][2] == "STEP"
    assert all(np.isfinite(values).all() for _, values, _ in scene.keys.values())


def test_individuals_that_come_and_go(tmp_path: Path) -> None:
    sample = prediction(frames=6, individuals=2)
    sample = sample.select(np.array([0, 1, 2, 3, 4, 5, 8, 9]))
    write_glb(sample, tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    shown = [np.abs(scene.at(scene.names.index("animal 1:hip"), "scale", row / 30)).max() for row in range(6)]
    assert shown == [0, 0, 1, 1, 0, 0]


def test_gaps_and_rates(tmp_path: Path) -> None:
    sample = prediction(frames=4, fps=None)
    sample.identity["frame"] = np.array([5, 7, 9, 15])
    write_glb(sample, tmp_path / "a.glb")
    scene = Scene(tmp_path / "a.glb")
    assert scene.file.asset.extras["fps_assumed"] and scene.file.asset.extras["fps"] == 30
    keys = next(times for times, *_ in scene.keys.values() if len(times) > 1)
    assert np.allclose(keys, np.array([0, 1, 2, 5]) / 30)
    write_glb(sample, tmp_path / "b.glb", fps=10)
    assert not Scene(tmp_path / "b.glb").file.asset.extras["fps_assumed"]
    with pytest.raises(UserError, match="fps=0"):
        write_glb(sample, tmp_path / "c.glb", fps=0)


def test_several_clips_and_none_are_refused(tmp_path: Path) -> None:
    sample = prediction(frames=4, identity={"sequence": np.array(["a", "a", "b", "b"])})
    with pytest.raises(UserError, match="one clip, found 2: a, b"):
        write_glb(sample, tmp_path / "a.glb")
    with pytest.raises(UserError, match="empty"):
        write_glb(sample.select(np.array([], int)), tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_a_thousand_frames_are_small_and_soon_written(tmp_path: Path) -> None:
    start = time.perf_counter()
    write_glb(prediction(frames=1000, joints=17), tmp_path / "a.glb")
    assert time.perf_counter() - start < 10
    assert os.path.getsize(tmp_path / "a.glb") < 2_000_000
    assert chain(17).joints[3] in Scene(tmp_path / "a.glb").names


@given(st.integers(0, 10_000))
def test_bones_turn_the_least_way_and_never_change_sign(seed: int) -> None:
    random = np.random.default_rng(seed)
    ways = np.cumsum(random.normal(size=(40, 3, 3)) * 0.4, 0) + [0, -1.0, 0]
    ways[7] = -ways[6]  # a half turn
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    ways[20:22, 1] = np.nan
    turned = bone_rotations(ways)
    assert np.abs(np.linalg.norm(turned, axis=-1) - 1).max() < 1e-9
    assert (turned[1:] * turned[:-1]).sum(-1).min() > -1e-9
    up = Rotation.from_quat(turned.reshape(-1, 4)).apply([0, 1, 0]).reshape(ways.shape)
    known = np.isfinite(ways).all(-1)
    assert np.abs(up - ways)[known].max() < 1e-9
    assert np.allclose(turned[20, 1], turned[19, 1], atol=1e-12)
    step = Rotation.from_quat(turned[:-1].reshape(-1, 4)).inv() * Rotation.from_quat(turned[1:].reshape(-1, 4))
    angle = np.arccos(np.clip((up[1:] * up[:-1]).sum(-1), -1, 1)).ravel()
    assert np.allclose(step.magnitude(), angle, atol=1e-6)


def test_names_of_any_script_and_the_same_bytes_twice(tmp_path: Path) -> None:
    sample = prediction(frames=3, title='走 "walk" é')
    write_glb(sample, tmp_path / "a.glb")
    write_glb(sample, tmp_path / "b.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert Scene(tmp_path / "a.glb").file.asset.extras["title"] == sample.title
