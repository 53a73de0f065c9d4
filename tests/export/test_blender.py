"""The script for Blender: run by Blender itself where it is installed as a module, else against a stand-in of its objects."""

from __future__ import annotations

import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from writers_samples import pair, places_of, prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.scene import in_axes


class Keys(list[Any]):
    """The keyframes of a curve: room is made first, and filled after."""

    def add(self, count: int) -> None:
        self.extend([None] * count)

    def foreach_set(self, name: str, values: np.ndarray) -> None:
        assert len(values) == {"co": 2, "interpolation": 1}[name] * len(self)
        setattr(self, name, np.reshape(values, (len(self), -1)))


class Thing(MagicMock):
    """An object, whose action has its curves as before Blender 4.4."""

    def keyframe_insert(self, path: str, frame: float) -> None:
        assert path == "location"
        curves = [SimpleNamespace(array_index=axis, keyframe_points=Keys([None]), update=int) for axis in range(3)]
        self.animation_data = SimpleNamespace(action=SimpleNamespace(layers=None, fcurves=curves))


def run(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, dict[str, Thing]]:
    """Run a script against the stand-in; return the scene, and the objects by name."""
    bpy, made = MagicMock(), {}
    bpy.data.objects.new = lambda name, data: made.setdefault(name, Thing(data=data))
    monkeypatch.setitem(sys.modules, "bpy", bpy)
    monkeypatch.setattr(sys, "argv", ["blender"])
    runpy.run_path(str(path))
    return bpy.context.scene, made


def test_a_joint_moves_where_it_is_in_the_frames_it_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = in_axes(pair(), "blender")
    write(pair(), tmp_path / "walk.blend.py")
    scene, made = run(tmp_path / "walk.blend.py", monkeypatch)
    assert (scene.render.fps, scene.render.fps_base) == (25, 1) and (scene.frame_start, scene.frame_end) == (100, 119)
    names = [f"{who}:{joint}" for who in ("Anna", "Ben") for joint in sample.joint_names]
    assert set(made) == {"Anna", "Ben", "Anna bones", "Ben bones", *names}
    for who in ("Anna", "Ben"):
        for joint, name in enumerate(sample.joint_names):
            places = {frame: places_of(sample, who, frame)[joint] / 1000 for frame in range(100, 120)}
            places = {frame: place for frame, place in places.items() if np.isfinite(place).all()}
            assert made[f"{who}:{name}"].parent is made[who]
            for curve in made[f"{who}:{name}"].animation_data.action.fcurves:
                np.testing.assert_array_equal(curve.keyframe_points.co[:, 0], list(places))
                expected = [place[curve.array_index] for place in places.values()]
                np.testing.assert_allclose(curve.keyframe_points.co[:, 1], expected, atol=1e-6)


def test_without_a_size_or_a_rate_it_says_what_it_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, sample = tmp_path / "a.blend.py", replace(prediction(3), unit="px", fps=None)
    remark = write(sample, path)[path]
    assert "frames a second are not known: 30; 1 px is 0.001" in remark
    scene, made = run(path, monkeypatch)
    assert scene.render.fps == 30 and "neck" in made and "figure" in made
    write(replace(sample, fps=29.97), tmp_path / "b.blend.py")
    scene, _ = run(tmp_path / "b.blend.py", monkeypatch)
    assert scene.render.fps == 30 and scene.render.fps / scene.render.fps_base == pytest.approx(29.97)
    with pytest.raises(UserError, match="unity is left-handed"):
        write(sample, tmp_path / "c.blend.py", axes="unity")


def test_names_cannot_break_out_of_the_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample, odd = pair(), {"Anna": "'''\"); raise SystemExit(1)\n#\\", "Ben": "🐭" * 40}
    sample.identity["instance"] = np.array([odd[str(who)] for who in sample.identity["instance"]])
    write(sample, tmp_path / "a.blend.py")
    _, made = run(tmp_path / "a.blend.py", monkeypatch)
    assert "'''\"); raise SystemExit(1)_#\\" in made and "🐭" * 15 in made


def test_blender_itself_shows_the_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    monkeypatch.setattr(sys, "argv", ["blender", "--", str(tmp_path / "walk.blend")])
    sample = in_axes(pair(), "blender")
    write(pair(), tmp_path / "walk.blend.py")
    runpy.run_path(str(tmp_path / "walk.blend.py"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "walk.blend"))
    scene = bpy.context.scene
    assert (scene.render.fps, scene.render.fps_base, scene.frame_start, scene.frame_end) == (25, 1, 100, 119)
    for frame, who in ((100, "Anna"), (107, "Ben"), (119, "Ben")):
        scene.frame_set(frame)
        places = dict(zip(sample.joint_names, places_of(sample, who, frame) / 1000, strict=True))
        rig = bpy.data.objects[f"{who} bones"].evaluated_get(bpy.context.evaluated_depsgraph_get())
        assert {bone.name for bone in rig.pose.bones} == {"-".join(bone) for bone in sample.skeleton.bones}
        for bone in rig.pose.bones:
            start, end = bone.name.split("-")
            np.testing.assert_allclose(rig.matrix_world @ bone.head, places[start], atol=2e-6)
            np.testing.assert_allclose(rig.matrix_world @ bone.tail, places[end], atol=2e-6)
