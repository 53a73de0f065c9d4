"""netCDF files of poses, read back by xarray, by the rules that movement documents and by movement itself."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from writers_samples import pair, places_of, prediction

import uplift
from uplift.errors import UserError
from uplift.export import write

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")


def test_two_people_come_back(tmp_path: Path) -> None:
    sample = pair()
    write(sample, tmp_path / "walk.nc")
    found = xarray.load_dataset(tmp_path / "walk.nc")
    assert found.position.dims == ("time", "space", "keypoints", "individuals")
    assert found.confidence.dims == ("time", "keypoints", "individuals")
    assert (found.ds_type, found.fps, found.time_unit, found.source_software) == ("poses", 25, "seconds", "uplift")
    assert found.individuals.values.tolist() == ["Anna", "Ben"] and found.space.values.tolist() == ["x", "y", "z"]
    assert found.keypoints.values.tolist() == list(sample.joint_names)
    np.testing.assert_allclose(found.time, np.arange(100, 120) / 25)
    assert (found.position.space_unit, found.position.origin) == ("mm", "the camera")
    assert [tuple(bone) for bone in json.loads(found.bones)] == list(sample.skeleton.bones)
    for who in ("Anna", "Ben"):
        for frame in range(100, 120):
            place = found.sel(individuals=who).isel(time=frame - 100)
            expected = places_of(sample, who, frame)
            np.testing.assert_allclose(place.position.T, expected, rtol=1e-6, atol=1e-3)
            there = np.isfinite(expected).any()
            assert np.isfinite(place.confidence).all() == there and np.isfinite(place.uncertainty).all() == there
    row = (sample.identity["frame"] == 107) & (sample.identity["instance"] == "Ben")
    assert found.filled.sel(individuals="Ben").isel(time=7).values.tolist() == sample.filled[row][0].tolist()


def test_movement_takes_it(tmp_path: Path) -> None:
    validator = pytest.importorskip("movement.validators.datasets").ValidPosesInputs
    kinematics, filtering = pytest.importorskip("movement.kinematics"), pytest.importorskip("movement.filtering")
    write(pair(), tmp_path / "walk.nc")
    found = xarray.load_dataset(tmp_path / "walk.nc")
    validator.validate(found)
    speed = kinematics.compute_speed(found.position)
    step = places_of(pair(), "Ben", 109)[0] - places_of(pair(), "Ben", 107)[0]
    expected = np.linalg.norm(step) * 25 / 2  # mm/s
    np.testing.assert_allclose(speed.sel(keypoints="hip", individuals="Ben").isel(time=8), expected, rtol=1e-4)
    assert np.isfinite(filtering.interpolate_over_time(found.position).sel(individuals="Anna")).all()


def test_without_a_rate_time_is_frames_and_one_body_has_the_usual_name() -> None:
    found = uplift.to_xarray(replace(prediction(3), fps=None, unit="px"))
    assert found.time.values.tolist() == [0, 1, 2] and found.time_unit == "frames" and "fps" not in found.attrs
    assert found.individuals.values.tolist() == ["id_0"] and found.position.space_unit == "px"
    np.testing.assert_allclose(found.position.values[..., 0].transpose(0, 2, 1), prediction(3).pose, rtol=1e-6)


def test_several_clips_are_a_file_each_and_no_data_set(tmp_path: Path) -> None:
    sample = prediction(4, identity={"sequence": np.array(["a", "a", "b", "b"])})
    assert [path.name for path in write(sample, tmp_path / "walk.nc")] == ["walk_a.nc", "walk_b.nc"]
    with pytest.raises(UserError, match="one clip, found 2: a, b"):
        uplift.to_xarray(sample)
