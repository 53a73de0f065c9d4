"""USD files of poses, opened by Pixar's own library and looked through by its validators."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from writers_samples import pair, places_of, prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.scene import in_axes

pytest.importorskip("pxr")
from pxr import Usd, UsdGeom


def opened(path: Path) -> Any:
    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize(("ending", "axes", "up"), [(".usda", "blender", "Z"), (".usdc", "opensim", "Y")])
def test_two_people_move_as_they_do(ending: str, axes: str, up: str, tmp_path: Path) -> None:
    sample, path = in_axes(pair(), axes), tmp_path / f"walk{ending}"
    assert write(pair(), path, axes=axes) == {path: ""}
    stage = opened(path)
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (25, 100, 119)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == (up, 1)
    assert stage.GetDefaultPrim().GetName() == "Poses"
    for who in ("Anna", "Ben"):
        for frame in range(100, 120):
            places = places_of(sample, who, frame) / 1000
            for joint, name in enumerate(sample.joint_names):
                ball = UsdGeom.Sphere(stage.GetPrimAtPath(f"/Poses/{who}/{name}"))
                known = np.isfinite(places[joint]).all()
                assert (ball.ComputeVisibility(frame) == "inherited") == known
                if known:
                    placed = ball.ComputeLocalToWorldTransform(frame).ExtractTranslation()
                    np.testing.assert_allclose(placed, places[joint], atol=1e-9)
            for start, end in sample.bone_indices:
                name = f"{sample.joint_names[start]}_{sample.joint_names[end]}"
                line = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/Poses/{who}/{name}"))
                known = np.isfinite(places[[start, end]]).all()
                assert (line.ComputeVisibility(frame) == "inherited") == known
                if known:
                    np.testing.assert_allclose(line.GetPointsAttr().Get(frame), places[[start, end]], atol=1e-6)


def test_its_validators_find_nothing(tmp_path: Path) -> None:
    validation = pytest.importorskip("pxr.UsdValidation")
    write(pair(), tmp_path / "walk.usdc")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    found = validation.ValidationContext(validators).Validate(opened(tmp_path / "walk.usdc"))
    assert len(validators) > 5 and [one.GetMessage() for one in found] == []


def test_names_that_are_no_identifiers_are_kept_for_people(tmp_path: Path) -> None:
    sample = pair()
    odd = {"Anna": "../x", "Ben": ".. x"}
    sample.identity["instance"] = np.array([odd[str(who)] for who in sample.identity["instance"]])
    write(sample, tmp_path / "a.usda")
    stage = opened(tmp_path / "a.usda")
    bodies = stage.GetDefaultPrim().GetChildren()
    assert sorted(body.GetDisplayName() for body in bodies) == [".. x", "../x"]
    assert len({body.GetName() for body in bodies}) == 2


def test_without_a_size_or_a_rate_it_says_what_it_took(tmp_path: Path) -> None:
    path, sample = tmp_path / "a.usda", replace(prediction(3), unit="px", fps=None)
    assert "not known: 30; 1 px is 0.001" in write(sample, path)[path]
    stage = opened(path)
    about = stage.GetDefaultPrim().GetCustomDataByKey("uplift")
    assert about["fps_assumed"] is True and about["unit"] == "px" and stage.GetTimeCodesPerSecond() == 30
    ball = UsdGeom.Xformable(stage.GetPrimAtPath("/Poses/figure/head"))
    placed = np.array(ball.ComputeLocalToWorldTransform(1).ExtractTranslation())
    np.testing.assert_allclose(placed, in_axes(sample, "opensim").pose[1, 2] * about["scale"], atol=1e-9)
    with pytest.raises(UserError, match="unity is left-handed"):
        write(sample, tmp_path / "b.usda", axes="unity")
