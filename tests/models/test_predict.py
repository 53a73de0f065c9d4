"""Predictions: rows stay rows, sizes and places, steady bones; and what the command says and writes."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import body_arrays, refusal
from lifts import H36M, small_lifter

from uplift.cli.main import main
from uplift.config.settings import LifterSettings
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.csv import write_keypoints_csv
from uplift.data.formats.deeplabcut import write_deeplabcut_csv
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.metrics.pose_metrics import never_seen_so_long
from uplift.models.lifter import Lifter
from uplift.models.metric_scale import KnownLength
from uplift.models.model import Model
from uplift.models.predict import infer
from uplift.skeleton import Skeleton, load_skeleton

SKELETON = load_skeleton("h36m17")
SIZE = KnownLength(("rhip", "rknee"), 430.0)


@pytest.fixture(scope="module")
def model() -> Model:
    torch.manual_seed(0)
    settings = LifterSettings(options={"units": 16, "blocks": 1})
    return Model(Lifter(SKELETON, settings).eval(), SKELETON, settings)


@pytest.fixture(scope="module")
def film() -> PoseData:
    """Two bodies in one film, their rows one frame after the other."""
    data = simulate(SKELETON, 120, seed=4)
    rows = np.arange(120)
    identity = {"sequence": np.full(120, "film"), "frame": rows // 2, "instance": np.array(["a", "b"])[rows % 2]}
    return replace(data.without_truth(), identity=identity)


def bone(pose: np.ndarray, one: str, other: str) -> np.ndarray:
    return np.linalg.norm(pose[:, SKELETON.index(one)] - pose[:, SKELETON.index(other)], axis=-1)


def test_the_order_of_rows_changes_nothing(model: Model, film: PoseData):
    straight = model.predict(film)
    order = np.random.default_rng(0).permutation(len(film))
    mixed = model.predict(film.select(order))
    np.testing.assert_allclose(mixed.pose, straight.pose[order], rtol=1e-3, atol=1e-2)
    assert mixed.identity["frame"].tolist() == film.identity["frame"][order].tolist()


def test_a_clip_is_mended_as_if_it_were_alone_whatever_stands_between_its_frames(model: Model, film: PoseData):
    both, plain = model.predict(film), model.predict(film, refine=False)
    alone = model.predict(film.select(film.identity["instance"] == "a"))
    # Not to the digit: what bones usually are is told by all bodies of a file.
    assert np.abs(alone.pose - both.pose[::2]).mean() < 0.05 * np.abs(both.pose - plain.pose).mean()


def test_a_size_gives_millimetres_and_a_place(model: Model, film: PoseData):
    pixels, metric = model.predict(film), model.predict(film, size=SIZE)
    assert (pixels.unit, metric.unit) == ("px", "mm")
    assert pixels.root is None and metric.root is not None
    both = (bone(metric.pose, "rhip", "rknee") + bone(metric.pose, "lhip", "lknee")) / 2
    assert np.median(both) == pytest.approx(430, rel=0.02)
    ratio = metric.pose[:, 1:] / pixels.pose[:, 1:]
    assert np.allclose(ratio, ratio[:, :1, :1], rtol=1e-3)  # a scale for each frame and nothing else
    assert metric.uncertainty is not None and pixels.uncertainty is not None
    np.testing.assert_allclose(metric.uncertainty[:, 1] / pixels.uncertainty[:, 1], ratio[:, 0, 0], rtol=1e-3)
    seen = metric.points[..., :2] / metric.points[..., 2:] * film.focal_px + np.array(film.centre_px)
    assert np.median(np.linalg.norm(seen - film.keypoints, axis=-1)) < 2


@pytest.mark.parametrize("refine", [False, True])
def test_a_pose_lies_on_the_rays_of_its_keypoints(model: Model, film: PoseData, refine: bool):
    """Root and joints: in pixels at the root's depth, the root is at a focal length along its ray."""
    shift = np.array([[-400.0, 250.0]])  # far from the middle, where the camera that looks at the root is turned most
    data = replace(film, keypoints=(film.keypoints + shift).astype(np.float32))
    pose = infer(model.lifter, data, model.settings, refine=refine).pose.double().numpy()
    rays = np.concatenate([data.keypoints - np.array(data.centre_px), np.full((120, 17, 1), data.focal_px)], -1)
    place = rays[:, SKELETON.root_index] / np.linalg.norm(rays[:, SKELETON.root_index], axis=-1, keepdims=True)
    points = pose + data.focal_px * place[:, None]
    seen = points[..., :2] / points[..., 2:] * data.focal_px + np.array(data.centre_px)
    np.testing.assert_allclose(seen, data.keypoints, atol=0.02)


def test_without_a_known_camera_there_is_no_place(model: Model, film: PoseData):
    assert model.predict(replace(film, focal_px=None), size=SIZE).root is None


def test_the_size_of_the_skeleton_file_needs_no_word(film: PoseData):
    own = Skeleton.from_dict({**SKELETON.to_dict(), "size": {"along": ["rhip", "rknee"], "mm": 12.0}})
    torch.manual_seed(0)
    settings = LifterSettings(options={"units": 16, "blocks": 1})
    metric = Model(Lifter(own, settings).eval(), own, settings).predict(film)
    assert metric.unit == "mm"
    assert np.median(bone(metric.pose, "rhip", "rknee")) == pytest.approx(12, rel=0.1)


def test_constant_bones(model: Model, film: PoseData):
    steady = model.predict(film, size=SIZE, constant_bones=True)
    for who in "ab":
        thigh = bone(steady.pose, "rhip", "rknee")[film.identity["instance"] == who]
        assert np.ptp(thigh) < 0.01
    assert np.ptp(bone(model.predict(film, size=SIZE).pose, "rhip", "rknee")) > 1


def test_joints_that_were_not_seen_are_told(model: Model, film: PoseData):
    gone = film.confidence.copy()
    gone[::3, 4] = 0
    found = model.predict(replace(film, confidence=gone))
    assert found.filled is not None
    np.testing.assert_array_equal(found.filled, gone == 0)
    assert np.isfinite(found.pose).all()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, model: Model) -> Path:
    path = tmp_path_factory.mktemp("run") / "lifter.pt"
    model.save(path)
    return path


def test_the_command_writes_what_is_asked_for(run: Path, here: Path, capsys: pytest.CaptureFixture):
    np.savez(here / "film.npz", **body_arrays(40))
    words = ["predict", f"run={run}", "input=film.npz"]
    assert main([*words, "output=a.csv", "bone=rhip,rknee", "bone_mm=430", "axes=blender", "bones=constant"]) == 0
    said = capsys.readouterr().out
    assert "unit mm" in said and "placed: the camera is" in said and "wrote a.csv" in said
    with (here / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40 and {row["axes"] for row in rows} == {"blender"}
    assert main([*words, "output=b.trc", "bone=rhip,rknee", "bone_mm=430"]) == 0
    said = capsys.readouterr().out
    written = sorted(path.name for path in here.glob("b_*.trc"))
    assert len(written) > 1 and f"wrote {written[0]}" in said
    assert "exists already" in refusal(capsys, *words, "output=b.trc", "bone=rhip,rknee", "bone_mm=430")
    assert main([*words, "output=c.npz", "axes=opensim"]) == 0
    capsys.readouterr()
    assert "in the axes 'opensim'" in refusal(capsys, "evaluate", "poses=c.npz", "data.test=film.npz")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["axes=blendr"], "Did you mean 'blender'"),
        (["bones=steady"], "free or constant"),
        (["bone=rhip,rknee"], "go together"),
        (["height_mm=tall"], "expected a number"),
        (["image_size=big"], "1920x1080"),
        (["fps=-3"], "fps=-3, expected a number above 0"),
        (["min_confidence=7"], "expected a number from 0 to 1"),
        (["format=deplabcut"], "no such format"),
        (["min_confidence=1", "hight_mm=3"], "Did you mean 'height_mm'"),
        (["output=a.trc"], "mm"),
        (["output=a.html", "axes=blender"], "a page turns poses itself"),
    ],
)
def test_wrong_words(words: list[str], says: str, run: Path, here: Path, capsys: pytest.CaptureFixture):
    np.savez(here / "film.npz", **body_arrays(20))
    output = [] if any(word.startswith("output=") for word in words) else ["output=a.npz"]
    assert says in refusal(capsys, "predict", f"run={run}", "input=film.npz", *output, *words)
    assert [path.name for path in here.iterdir()] == ["film.npz"]


@pytest.mark.parametrize("writer", [write_keypoints_csv, write_deeplabcut_csv])
def test_the_same_keypoints_in_another_format_give_the_same_poses(writer, model: Model, film: PoseData, tmp_path: Path):
    writer(film, tmp_path / "film.csv")
    read = load_file(tmp_path / "film.csv", SKELETON, ReadOptions(focal_px=film.focal_px, image_size=film.image_size))
    found, wanted = model.predict(read), model.predict(film)
    place = {
        (int(f), str(i)): row
        for row, (f, i) in enumerate(zip(film.identity["frame"], film.identity["instance"], strict=True))
    }
    rows = [place[int(f), str(i)] for f, i in zip(read.identity["frame"], read.identity["instance"], strict=True)]
    assert sorted(rows) == list(range(len(film)))
    np.testing.assert_allclose(found.pose, wanted.pose[rows], rtol=1e-3, atol=0.05)


def test_joints_with_the_names_of_others_are_doubted(
    here: Path, model: Model, run: Path, capsys: pytest.CaptureFixture
):
    arrays = body_arrays(40)
    arrays["keypoints"] = simulate(SKELETON, 40, seed=1).keypoints
    np.savez(here / "right.npz", **arrays)
    arrays["keypoints"] = np.roll(arrays["keypoints"], 5, axis=1)
    np.savez(here / "wrong.npz", **arrays)
    for name, doubted in (("right", False), ("wrong", True)):
        assert main(["predict", f"run={run}", f"input={name}.npz", f"output={name}_poses.npz"]) == 0
        assert ("WARNING: the bones of h36m17" in capsys.readouterr().out) == doubted


def test_bones_longer_than_they_ever_look_are_warned_of():
    pose = simulate(SKELETON, 300, seed=5).pose
    assert never_seen_so_long(pose, SKELETON) < 0.1
    deep = pose * np.array([1, 1, 5.0], np.float32)
    assert never_seen_so_long(deep, SKELETON) > 0.3
    assert np.isnan(never_seen_so_long(pose * np.nan, SKELETON))


def test_hypotheses_of_a_frame_without_any_joint_are_as_blank_as_its_pose() -> None:
    data = simulate(H36M, frames=12, seed=0)
    confidence = data.confidence.copy()
    confidence[5] = 0
    model = Model(small_lifter(signs=8), H36M, LifterSettings(signs=8))
    found = model.predict(replace(data, confidence=confidence), hypotheses=3)
    assert found.hypotheses is not None
    assert np.isnan(found.pose[5]).all() and np.isnan(found.hypotheses[5]).all()
    assert np.isfinite(np.delete(found.hypotheses, 5, 0)).all()
    with pytest.raises(UserError, match="lifter.signs"):
        Model(small_lifter(), H36M, LifterSettings()).predict(data, hypotheses=3)
