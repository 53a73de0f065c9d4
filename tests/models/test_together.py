"""Several cameras of one scene: exact synthetic scenes, cameras that disagree, matching, and a real video."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import refusal
from scipy.spatial.transform import Rotation

from uplift.cli.main import main
from uplift.config.settings import LifterSettings
from uplift.data.calibration import SceneCamera
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.geometry.lens import Lens
from uplift.models import together
from uplift.models.lifter import Lifter
from uplift.models.metric_scale import KnownLength
from uplift.models.model import Model
from uplift.models.prediction import Prediction
from uplift.models.together import match_views
from uplift.skeleton import Skeleton, load_skeleton

SKELETON = load_skeleton("h36m17")
FRAMES, SIZE = 60, (1000, 800)
FOCAL = (900.0, 1200.0, 1500.0, 1100.0)


class NoisyLifter(Model):
    """In place of a trained lifter: the true poses, each view's and joint's depth off by its own error."""

    noise_mm = 60.0

    def predict(self, data: PoseData, title: str = "", **options) -> Prediction:
        rng = np.random.default_rng(abs(hash(data.focal_px)) % 1000)
        assert data.pose is not None
        pose = data.pose + rng.normal(0, self.noise_mm, data.pose.shape) * (0.2, 0.2, 1)
        pose = (pose - pose[:, [SKELETON.root_index]]).astype(np.float32)
        pose[(data.confidence > 0).sum(1) == 0] = np.nan
        return Prediction(pose, pose, "px", data.keypoints, data.confidence, SKELETON.joints, SKELETON)


@pytest.fixture(scope="module")
def model() -> NoisyLifter:
    torch.manual_seed(0)
    settings = LifterSettings(options={"units": 16, "blocks": 1})
    return NoisyLifter(Lifter(SKELETON, settings).eval(), SKELETON, settings)


def true_cameras(count: int) -> list[SceneCamera]:
    """Cameras around a body at 0, 4 m away, looking down by 5 to 25 degrees, rolled; the first in its own frame."""
    found = []
    for at in range(count):
        turn = Rotation.from_euler("yxz", [at * 80, -5 - 6 * at, 8 * at * (-1) ** at], degrees=True)
        lens = Lens.ideal(FOCAL[at], SIZE)
        found.append(SceneCamera(f"cam{at + 1}", lens, turn.inv().as_matrix(), np.array([0.1 * at, 0.05, 4.0]) * 1000))
    return found


def scene(count: int = 3, noise_px: float = 0.5, seed: int = 1) -> tuple[list[PoseData], np.ndarray, list[SceneCamera]]:
    """Return views of a moving body, its joints in the world (mm), and the cameras."""
    rng = np.random.default_rng(seed)
    body = simulate(SKELETON, FRAMES, seed=seed)
    assert body.pose is not None
    size = np.linalg.norm(np.diff(body.pose[:, SKELETON.bone_indices], axis=2), axis=-1).sum() / FRAMES / 4000
    path = np.stack([np.linspace(-400, 400, FRAMES), np.zeros(FRAMES), 300 * np.sin(np.arange(FRAMES) / 15)], -1)
    world = body.pose / size + path[:, None]
    views = []
    for camera in true_cameras(count):
        there = world @ camera.rotation.T + camera.translation
        keypoints = camera.lens.project(there) + rng.normal(0, noise_px, (*there.shape[:2], 2))
        root = there[:, SKELETON.root_index]
        identity = {
            "frame": np.arange(FRAMES),
            "sequence": np.full(FRAMES, "walk"),
            "camera": np.full(FRAMES, camera.name),
        }
        views.append(
            PoseData(
                keypoints.astype(np.float32), np.ones(keypoints.shape[:2], np.float32), SKELETON.joints,
                pose=(there - root[:, None]).astype(np.float32), identity=identity, fps=30.0, image_size=SIZE,
                focal_px=camera.focal_px,
            )
        )  # fmt: skip
    return views, world, true_cameras(count)


def off_mm(found: Prediction, world: np.ndarray, camera: SceneCamera) -> np.ndarray:
    """Return the distance of each joint from the truth in the first camera's frame, after the best common scale."""
    there = world @ camera.rotation.T + camera.translation
    points = found.points.astype(np.float64)
    return np.linalg.norm(points * (points * there).sum() / (points**2).sum() - there, axis=-1)


def turns_off(found: Sequence[SceneCamera], true: Sequence[SceneCamera]) -> list[float]:
    """Return by how many degrees each camera is turned wrong beside the first."""
    both = zip(found, true, strict=True)
    return [
        float(np.degrees(Rotation.from_matrix(a.rotation @ (b.rotation @ true[0].rotation.T).T).magnitude()))
        for a, b in both
    ]


def test_cameras_and_body_are_found_from_noisy_poses(model: NoisyLifter):
    views, world, cameras = scene(4)
    body, found = model.predict_together(views)
    assert max(turns_off(found, cameras)) < 0.5
    assert np.median(off_mm(body, world, cameras[0])) < 5
    assert all(one.error_px is not None and one.error_px < 1.5 for one in found)
    assert body.unit == "px" and body.root is not None
    place = body.pose[:, 0] * 0 + body.root  # a pixel is a pixel of the first camera at the body's distance
    assert np.median(place[:, 2]) == pytest.approx(FOCAL[0], rel=1e-3)


def test_the_order_of_cameras_changes_nothing_but_the_frame(model: NoisyLifter):
    views, _, cameras = scene()
    order = [2, 0, 1]
    straight, _ = model.predict_together(views)
    mixed, found = model.predict_together([views[at] for at in order])
    assert max(turns_off(found, [cameras[at] for at in order])) < 0.5
    one, other = straight.pose.reshape(-1, 3), mixed.pose.reshape(-1, 3)
    turn, rest = Rotation.align_vectors(one / np.linalg.norm(one), other / np.linalg.norm(other))
    del turn
    assert rest < 0.005


def test_focal_lengths_that_are_not_known_are_found(model: NoisyLifter):
    views, world, cameras = scene(4)
    body, found = model.predict_together([replace(view, focal_px=None) for view in views])
    assert [one.focal_px for one in found] == pytest.approx(list(FOCAL), rel=0.05)
    assert np.median(off_mm(body, world, cameras[0])) < 15
    assert any("focal lengths were not known" in note for note in body.notes)


def test_one_camera_gives_what_predict_gives(model: NoisyLifter):
    (view,), _, _ = scene(1)
    body, found = model.predict_together([view])
    np.testing.assert_array_equal(body.pose, model.predict(view).pose)
    assert len(found) == 1 and np.allclose(found[0].rotation, np.eye(3))


def test_what_one_camera_does_not_see_the_others_show(model: NoisyLifter):
    views, world, cameras = scene()
    wrist, late = SKELETON.index("lwrist"), slice(20, 40)
    hidden = views[0].confidence.copy()
    hidden[late, wrist] = 0
    hidden[50:55] = 0
    views[0] = replace(views[0], confidence=hidden)
    body, _ = model.predict_together(views)
    off = off_mm(body, world, cameras[0])
    assert np.median(off[late, wrist]) < 10 and np.median(off[50:55]) < 10
    assert body.filled is not None and not body.filled.any()


def test_frames_that_only_one_camera_has_are_there_too(model: NoisyLifter):
    views, world, cameras = scene()
    views = [views[0].select(slice(0, 40)), views[1].select(slice(0, 40)), views[2]]
    body, _ = model.predict_together(views)
    assert body.identity["frame"].tolist() == list(range(FRAMES))
    assert np.median(off_mm(body.select(slice(0, 40)), world[:40], cameras[0])) < 6
    assert np.median(off_mm(body, world, cameras[0])[40:]) < 150  # lifted, and placed by its own camera


@pytest.mark.parametrize("harm", ["lost", "swapped"])
def test_a_camera_that_disagrees_does_not_spoil_the_body(model: NoisyLifter, harm: str):
    views, world, cameras = scene()
    bad = views[1].keypoints.copy()
    if harm == "lost":
        bad[15:45] = bad[15:45].mean(1, keepdims=True) + np.random.default_rng(0).normal(0, 30, bad[15:45].shape)
    else:
        bad[15:45] = bad[15:45][:, SKELETON.mirror_permutation]
    views[1] = replace(views[1], keypoints=bad.astype(np.float32))
    body, found = model.predict_together(views)
    assert max(turns_off(found, cameras)) < 1
    off = off_mm(body, world, cameras[0])
    assert np.median(off[15:45]) < 15 and np.median(off[:15]) < 6


def test_calibrated_cameras_give_millimetres_and_places(model: NoisyLifter):
    views, world, cameras = scene(2)
    body, found = model.predict_together(views, cameras=cameras[::-1])
    there = world @ cameras[0].rotation.T + cameras[0].translation
    assert body.unit == "mm"
    assert np.median(np.linalg.norm(body.points - there, axis=-1)) < 5
    assert turns_off(found, cameras) == pytest.approx([0, 0], abs=1e-5)


def test_a_size_gives_millimetres(model: NoisyLifter):
    views, world, cameras = scene()
    hip, knee = (SKELETON.index(name) for name in ("rhip", "rknee"))
    thigh = float(np.linalg.norm(world[0, hip] - world[0, knee]))
    body, found = model.predict_together(views, size=KnownLength(("rhip", "rknee"), thigh))
    there = world @ cameras[0].rotation.T + cameras[0].translation
    assert body.unit == "mm"
    assert np.median(np.linalg.norm(body.points - there, axis=-1)) < 60  # 4 m away: 1 % of the distance
    far = np.linalg.norm(found[1].position)
    assert far == pytest.approx(np.linalg.norm(cameras[1].position - cameras[0].position), rel=0.02)


def test_two_bodies_stay_apart(model: NoisyLifter):
    one, world, cameras = scene()
    two, other, _ = scene(seed=5)
    both = []
    for a, b in zip(one, two, strict=True):
        joined = PoseData.concat([a, b])
        instance = np.repeat(["anna", "bert"], FRAMES)
        both.append(replace(joined, identity={**joined.identity, "instance": instance}))
    body, _ = model.predict_together(both)
    assert body.identity["instance"].tolist() == ["anna"] * FRAMES + ["bert"] * FRAMES
    assert np.median(off_mm(body, np.concatenate([world, other]), cameras[0])) < 6


def test_long_clips_are_solved_in_blocks(model: NoisyLifter, monkeypatch: pytest.MonkeyPatch):
    views, _, _ = scene()
    whole, _ = model.predict_together(views)
    monkeypatch.setattr(together, "_BLOCK", 25)
    parts, _ = model.predict_together(views)
    apart = np.linalg.norm(parts.points - whole.points, axis=-1)
    assert np.median(apart) < 1 and apart.max() < 0.1 * np.ptp(whole.pose)


# Which frames go together.


def test_rows_are_matched_by_frame_number_or_by_row():
    views, _, _ = scene(2)
    late = views[1].select(slice(10, None))
    assert (match_views([views[0], late]).rows[1] >= 0).sum() == FRAMES - 10
    assert match_views([views[0], late]).rows[1, 10] == 0
    plain = [replace(view, identity={"sequence": view.identity["sequence"]}) for view in (views[0], late)]
    assert match_views(plain).rows[1, 0] == 0


def test_names_of_sequences_may_differ_in_the_camera():
    views, _, _ = scene(2)
    names = [np.repeat([f"run_cam{at}", f"walk_cam{at}"], 30) for at in (1, 2)]
    frame = np.tile(np.arange(30), 2)
    views = [replace(v, identity={"sequence": n, "frame": frame}) for v, n in zip(views, names, strict=True)]
    moments = match_views([views[0], views[1].select(np.arange(60)[::-1])])
    assert (moments.rows[1] == 59 - moments.rows[0]).all()
    assert len(moments.triples()) == 2 * 28


def test_views_without_common_frames_are_refused(model: NoisyLifter):
    views, _, _ = scene(2)
    away = replace(views[1], identity={**views[1].identity, "frame": np.arange(FRAMES) + 1000})
    with pytest.raises(UserError, match="cam2 shares 0 frames with cam1"):
        model.predict_together([views[0], away])
    twice = PoseData.concat([views[1], views[1]])
    with pytest.raises(UserError, match="one body twice"):
        match_views([views[0], twice])


def test_cameras_of_other_names_or_sizes_are_refused(model: NoisyLifter):
    views, _, cameras = scene(2)
    others = [replace(one, name=f"gopro{at}") for at, one in enumerate(cameras)]
    with pytest.raises(UserError, match="no camera fits the view 'cam1'"):
        model.predict_together(views, cameras=others)
    small = [replace(one, lens=Lens.ideal(500.0, (640, 480))) for one in cameras]
    with pytest.raises(UserError, match="640 x 480"):
        model.predict_together(views, cameras=small)


# A real video, MediaPipe's own 3D in place of a lifter's.

BEAM = Path(os.environ.get("UPLIFT_DATA", "/nowhere")) / "beam"


class MediaPipe(Model):
    """Poses as they come from MediaPipe."""

    def predict(self, data: PoseData, title: str = "", **options) -> Prediction:
        found = load_file(BEAM / f"mediapipe_world_{data.source.rpartition('_')[2]}", self.skeleton)
        assert found.pose is not None
        pose = np.nan_to_num(found.pose)
        return Prediction(pose, pose, "mm", data.keypoints, data.confidence, self.skeleton.joints, self.skeleton)


@pytest.mark.skipif(not BEAM.is_dir(), reason="needs UPLIFT_DATA")
def test_four_real_cameras(model: NoisyLifter):
    skeleton: Skeleton = load_skeleton("h36m17")
    views = [load_file(BEAM / f"beam_blazepose_cam{number}.npz", skeleton) for number in (1, 2, 3, 4)]
    body, found = MediaPipe(model.lifter, skeleton, model.settings).predict_together(views)
    truth = views[0].pose
    assert truth is not None
    known = np.isfinite(truth).all(-1)
    errors = []
    for pose, true, there in zip(body.pose, truth, known, strict=True):
        a, b = pose[there] - pose[there].mean(0), true[there] - true[there].mean(0)
        turn, _ = Rotation.align_vectors(b, a)
        a = turn.apply(a)
        errors.append(np.linalg.norm(a * (a * b).sum() / (a**2).sum() - b, axis=1).mean())
    assert np.mean(errors) < 35
    assert len(found) == 4


# The command line.


def test_the_command_takes_files_and_calibrations(model: NoisyLifter, tmp_path: Path, capsys):
    views, world, cameras = scene(3)
    model.save(tmp_path / "lifter.pt")
    names = [f"walk_cam0{number}.npz" for number in (1, 2, 3)]
    for name, view in zip(names, views, strict=True):
        np.savez(
            tmp_path / name, keypoints=view.keypoints, joint_names=np.array(SKELETON.joints), fps=30.0,
            image_size=np.array(SIZE), focal_px=view.focal_px, frame=np.arange(FRAMES),
        )  # fmt: skip
    lines = []
    for number, one in enumerate(cameras):
        vector = Rotation.from_matrix(one.rotation).as_rotvec().tolist()
        lines += [f"[cam_{number}]", f'name = "cam_0{number + 1}"', f"size = {[float(side) for side in SIZE]}",
                  f"matrix = [[{one.focal_px}, 0.0, 500.0], [0.0, {one.focal_px}, 400.0], [0.0, 0.0, 1.0]]",
                  "distortions = [0.0, 0.0, 0.0, 0.0]", f"rotation = {vector}",
                  f"translation = {(one.translation / 1000).tolist()}", "fisheye = false"]  # fmt: skip
    (tmp_path / "Calib.toml").write_text("\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0"]))
    words = [
        f"run={tmp_path / 'lifter.pt'}",
        f"input={tmp_path}/walk_*.npz",
        "together=true",
        f"output={tmp_path}/body.npz",
    ]
    main(["predict", *words, f"cameras={tmp_path}/Calib.toml", f"cameras_output={tmp_path}/found.toml"])
    said = capsys.readouterr().out
    assert "3 cameras together, as calibrated" in said and "taken as metres" in said
    with np.load(tmp_path / "body.npz") as body:
        there = world @ cameras[0].rotation.T + cameras[0].translation
        assert np.median(np.linalg.norm(body["pose"] + body["root"][:, None] - there, axis=-1)) < 10
    assert (tmp_path / "found.toml").read_text().count("matrix") == 3


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["cameras=a.toml"], "needs together=true"),
        (["together=true", "cameras_unit=m"], "which is not given"),
        (["together=true", "cameras_output=found.json"], "written as .toml"),
        (["together=true", "cameras=none.toml"], "No file"),
    ],
)
def test_words_that_do_not_go_together_are_refused(model: NoisyLifter, tmp_path: Path, capsys, words, expected):
    views, _, _ = scene(2)
    model.save(tmp_path / "lifter.pt")
    for name, view in zip(("a", "b"), views, strict=True):
        np.savez(tmp_path / f"{name}.npz", keypoints=view.keypoints, joint_names=np.array(SKELETON.joints))
    inputs = [f"run={tmp_path / 'lifter.pt'}", f"input={tmp_path}/a.npz,{tmp_path}/b.npz", f"output={tmp_path}/c.npz"]
    assert expected in refusal(capsys, "predict", *inputs, *words)
