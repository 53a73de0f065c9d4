"""NWB files of poses, read back by pynwb, ndx-pose and movement, and looked through by nwbinspector."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from writers_samples import pair, places_of, prediction

from uplift.data.formats import read
from uplift.errors import UserError
from uplift.export import write

pynwb = pytest.importorskip("pynwb")
ndx_pose = pytest.importorskip("ndx_pose")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
SAID = {"session_start_time": "2026-05-01T10:30:00+02:00", "experimenter": "Curie, Marie", "institution": "Sorbonne",
        "lab": "Gait", "subject_id": "A1", "species": "Homo sapiens", "sex": "F", "age": "P34Y"}  # fmt: skip


def opened(path: Path) -> Any:
    """Return an NWBFile with all its arrays."""
    return pynwb.NWBHDF5IO(str(path), "r", load_namespaces=True).read()


def test_two_people_come_back_in_metres_in_the_time_of_the_video(tmp_path: Path) -> None:
    sample = pair()
    files = write(sample, tmp_path / "walk.nwb")
    assert (
        list(files) == [tmp_path / "walk.nwb"]
        and "session_start_time, species, sex, age" in files[tmp_path / "walk.nwb"]
    )
    module = opened(tmp_path / "walk.nwb").processing["behavior"]
    skeleton = module["Skeletons"]["figure"]
    assert list(skeleton.nodes) == list(sample.joint_names)
    assert np.asarray(skeleton.edges).tolist() == sample.bone_indices.tolist()
    for who in ("Anna", "Ben"):
        estimate = module[who]
        assert isinstance(estimate, ndx_pose.PoseEstimation) and estimate.skeleton is skeleton
        assert set(estimate.pose_estimation_series) == set(sample.joint_names)
        for joint, name in enumerate(sample.joint_names):
            series = estimate[name]
            assert (series.unit, series.conversion, series.rate, series.starting_time) == ("meters", 1, 25, 4)
            expected = np.array([places_of(sample, who, frame)[joint] for frame in range(100, 120)]) / 1000
            np.testing.assert_allclose(series.data[:], expected, atol=1e-6)
            mine = (sample.identity["instance"] == who).nonzero()[0]
            np.testing.assert_allclose(
                series.confidence[:][sample.identity["frame"][mine] - 100], sample.confidence[mine, joint], rtol=1e-6
            )
            assert "is the camera; x right" in series.reference_frame


def test_one_body_is_called_as_readers_expect_and_pixels_say_so(tmp_path: Path) -> None:
    write(replace(prediction(4), unit="px"), tmp_path / "a.nwb", nwb=SAID)
    file = opened(tmp_path / "a.nwb")
    series = file.processing["behavior"]["PoseEstimation"]["neck"]
    assert series.unit == "pixels" and "is the joint 'hip'" in series.reference_frame
    np.testing.assert_allclose(series.data[:], prediction(4).pose[:, 1], rtol=1e-6)
    assert file.session_start_time == datetime.fromisoformat(SAID["session_start_time"])
    assert (file.subject.species, file.subject.age, file.experimenter) == ("Homo sapiens", "P34Y", ("Curie, Marie",))


def test_nwbinspector_finds_nothing_critical(tmp_path: Path) -> None:
    """What is left is for people to say: who they are, when it was and what species it is."""
    inspector = pytest.importorskip("nwbinspector")
    write(pair(), tmp_path / "bare.nwb")
    write(pair(), tmp_path / "said.nwb", nwb=SAID)
    found = {name: list(inspector.inspect_nwbfile(nwbfile_path=tmp_path / f"{name}.nwb")) for name in ("bare", "said")}
    assert {one.check_function_name for one in found["bare"]} == {
        "check_description", "check_session_start_time_old_date", "check_experimenter_exists", "check_institution",
        "check_subject_species_exists",
    }  # fmt: skip
    assert not [one for one in found["bare"] if one.importance.value >= inspector.Importance.CRITICAL.value]
    assert {one.check_function_name for one in found["said"]} == {"check_description"}  # of the subject


def test_pynwb_finds_it_valid(tmp_path: Path) -> None:
    write(pair(), tmp_path / "walk.nwb")
    assert not pynwb.validate(path=str(tmp_path / "walk.nwb"))


def test_movement_opens_it(tmp_path: Path) -> None:
    load_dataset = pytest.importorskip("movement.io").load_dataset
    sample = pair()
    write(sample, tmp_path / "walk.nwb")
    found = load_dataset(tmp_path / "walk.nwb", source_software="NWB", pose_estimation_key="Ben")
    expected = [places_of(sample, "Ben", frame)[2] / 1000 for frame in range(100, 120)]
    np.testing.assert_allclose(found.position.sel(keypoints="head").squeeze(), expected, atol=1e-6)


def test_what_it_cannot_say_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.nwb"
    with pytest.raises(UserError, match="the frame rate is not known. Give it: fps=30"):
        write(replace(prediction(4), fps=None), path)
    for given, told in (
        ({"session_start_time": "yesterday"}, "expected a date and time such as 2026"),
        ({"specie": "Mus musculus"}, "nwb.specie: no such word. Did you mean 'species'"),
        ({"sex": "female"}, "expected M, F, U"),
    ):
        with pytest.raises(UserError, match=told):
            write(prediction(4), path, nwb=given)
    assert not path.exists()
    write(pair(), path)
    with pytest.raises(UserError, match="holds 3D poses that uplift wrote, which cannot be lifted"):
        read(path)


def test_names_that_hdf5_has_no_room_for(tmp_path: Path) -> None:
    sample = pair()
    odd = {"Anna": "../x:y", "Ben": "Skeletons"}
    sample.identity["instance"] = np.array([odd[str(who)] for who in sample.identity["instance"]])
    write(sample, tmp_path / "a.nwb")
    module = opened(tmp_path / "a.nwb").processing["behavior"]
    assert set(module.data_interfaces) == {"Skeletons", ".._x_y", "Skeletons_2"}
