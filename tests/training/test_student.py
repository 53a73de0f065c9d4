"""What the student is shown, and what it is asked for."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from modules import student_module

from uplift.config.settings import LifterSettings, StudentSettings
from uplift.data.clean import clean
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Perspective
from uplift.geometry.normalise import mean_radius
from uplift.models.lifter import Lifter
from uplift.skeleton import load_skeleton
from uplift.training.augmentation import ShownViews, ViewMaker
from uplift.training.pseudo_labels import PseudoPoses
from uplift.training.student import StudentModule

SKELETON = load_skeleton("h36m17")
ROOT = SKELETON.root_index
BATCH = StudentSettings().batch_size


@pytest.fixture(scope="module")
def poses() -> PseudoPoses:
    data, _ = clean(simulate(SKELETON, 300, seed=6), SKELETON)
    training_set = TrainingSet.of(data, SKELETON, count_root=False)
    pose = torch.from_numpy(data.pose) / 300
    gravity = torch.tensor([[0.0, 0.995, 0.0998]]).expand(300, 3)
    return PseudoPoses(SKELETON, pose, gravity, training_set.distance, training_set.confidence)


def views_of(poses: PseudoPoses, count: int, **settings: float) -> ShownViews:
    torch.manual_seed(0)
    return ViewMaker(poses, Perspective(), StudentSettings(**settings), count_root=False)(count)


def training(poses: PseudoPoses, lifter: LifterSettings | None = None, **settings: float) -> StudentModule:
    torch.manual_seed(0)
    made = Lifter(poses.skeleton, lifter or LifterSettings(options={"units": 16}))
    return student_module(made, poses, **settings)


def test_views_are_projections_of_their_targets(poses):
    views = views_of(poses, 200, occlude=0.5)
    projected = Perspective().project(views.pose, views.distance)
    torch.testing.assert_close(views.keypoints, projected, atol=1e-5, rtol=1e-5)
    # What is given differs only by where it is measured from, and that only where the root is hidden.
    moved = views.input - views.keypoints
    rooted = views.confidence[:, ROOT] > 0
    torch.testing.assert_close(moved[rooted], torch.zeros_like(moved[rooted]), atol=1e-5, rtol=0)
    others = [joint for joint in range(17) if joint != ROOT]
    assert moved[~rooted][:, others].std(1).max() < 1e-5
    assert moved[~rooted][:, others].abs().max() > 0.01


def test_the_radius_is_that_of_the_joints_that_are_shown(poses):
    views = views_of(poses, 200, occlude=0.8)
    assert (views.confidence == 0).any()
    radius = mean_radius(views.input, views.confidence, ROOT, count_root=False)
    torch.testing.assert_close(radius, torch.ones(200), atol=1e-5, rtol=1e-5)


def test_a_share_of_the_views_is_occluded(poses):
    views = views_of(poses, 4000, occlude=0.4)
    assert 0.03 < (views.confidence[:, ROOT] == 0).float().mean() < 0.1
    # A few of the views that take part happen to lose no joint at all.
    assert (views.confidence == 0).any(1).float().mean() == pytest.approx(0.37, abs=0.04)
    assert (views_of(poses, 50, occlude=0.0).confidence == 1).all()


def test_whole_limbs_go_missing(poses):
    hidden = views_of(poses, 4000, occlude=1.0, mirror=False).confidence == 0
    assert not hidden.all(1).any()
    arm = [SKELETON.index(joint) for joint in ("rshoulder", "relbow", "rwrist")]
    others = [joint for joint in range(len(SKELETON.joints)) if joint not in arm]
    assert (hidden[:, arm].all(1) & ~hidden[:, others].any(1)).sum() > 50


def test_confidence_reaches_the_network_as_it_is(poses):
    doubtful = replace(poses, confidence=torch.full_like(poses.confidence, 0.4))
    assert (views_of(doubtful, 50).confidence == 0.4).all()


def test_noise_comes_with_the_confidence_of_its_frame(poses):
    torch.manual_seed(1)
    confidence = torch.rand_like(poses.confidence) * 0.8 + 0.1
    noise = (confidence * 0.01).unsqueeze(-1).expand(-1, -1, 2).clone()
    views = views_of(replace(poses, confidence=confidence, noise=noise), 300, noise=True)
    # What the network sees is off by the noise, less that of the root, in units of the radius that is shown.
    off = (views.input - views.keypoints)[..., 0]
    expected = 0.01 * (views.confidence - views.confidence[:, [ROOT]])
    scale = (off * expected).sum(1, keepdim=True) / expected.square().sum(1, keepdim=True)
    torch.testing.assert_close(off, expected * scale, atol=1e-4, rtol=1e-3)
    assert scale.min() > 0


def test_frames_with_too_few_joints_teach_nothing_and_stay_finite(poses):
    confidence = torch.zeros_like(poses.confidence)
    confidence[:, :2] = 1
    views = views_of(replace(poses, confidence=confidence), 100, occlude=0.4)
    assert (views.weight == 0).all()
    assert views.pose.isfinite().all()
    assert views.pose.abs().max() < 50


def test_gravity_in_the_views_is_that_of_the_data(poses):
    """A camera that looks aside rolls a little; the views have that roll, and the tilt is what is asked for."""
    rolled = torch.nn.functional.normalize(torch.tensor([[0.2, 0.9, 0.3]]), dim=-1).expand(300, 3)
    standing = replace(poses, pose=poses.pose * 0 + torch.linspace(0, 1, 17)[:, None] * torch.tensor([0.0, 1, 0]))
    views = views_of(replace(standing, gravity=rolled), 50, mix=0.0, any_way=0.0, stretch=0.0)
    upright = torch.nn.functional.normalize(views.pose[:, -1], dim=-1)
    torch.testing.assert_close(upright, rolled[:50], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(views.tilt, rolled[:50, 2].asin())


def test_missing_joints_have_no_say_in_the_loss(poses):
    wrist = SKELETON.index("lwrist")
    confidence = poses.confidence.clone()
    confidence[:, wrist] = 0
    losses = []
    for wrong in (0.0, 9.0):
        pose = poses.pose.clone()
        pose[:, wrist] += wrong
        module = training(replace(poses, pose=pose, confidence=confidence), occlude=0.0, mix=0.0, mirror=False)
        losses.append(module.objective(BATCH)[1]["depth"])
    torch.testing.assert_close(losses[0], losses[1])


def test_every_output_of_the_network_learns(poses):
    noisy = replace(poses, noise=torch.randn(300, 17, 2) * 0.02)
    module = training(noisy, LifterSettings(options={"units": 16}, denoise=True), occlude=0.4)
    module.objective(BATCH)[0].backward()
    gradient = module.lifter.network.leave.weight.grad
    silent = (gradient.abs().sum(1) == 0).nonzero()[:, 0].tolist()
    # Only the root's spread has nothing to say: its depth is 0.
    assert silent == [3 * 17 + ROOT]


# Any cameras.


def views_of_any_camera(poses: PseudoPoses, count: int, **settings) -> ShownViews:
    torch.manual_seed(0)
    still = {"mix": 0.0, "mirror": False, "any_way": 0.0, "stretch": 0.0}
    chosen = StudentSettings(**{"own_share": 0.0, **still, **settings})
    return ViewMaker(poses, Perspective(), chosen, count_root=False, usual_distance=10.0)(count)


@pytest.fixture
def standing(poses) -> PseudoPoses:
    """Bodies whose joints lie along gravity: each view of them shows where that points."""
    return replace(poses, pose=poses.pose * 0 + torch.linspace(0, 1, 17)[:, None] * torch.tensor([0.0, 1, 0]))


def test_any_camera_of_known_focal_length_is_a_pinhole_that_looks_at_the_root(poses):
    views = views_of_any_camera(poses, 400, unknown_focal=0.0)
    torch.testing.assert_close(views.keypoints, Perspective().project(views.pose, views.distance), atol=1e-4, rtol=1e-4)
    assert torch.equal(views.told, views.distance)
    assert not views.guessed.any()


def test_any_camera_has_the_tilt_the_roll_and_the_distance_of_the_settings(standing, monkeypatch):
    monkeypatch.setattr("uplift.training.augmentation._ASIDE", 0.0)
    views = views_of_any_camera(standing, 4000, tilt_deg=(-10.0, 40.0), roll_deg=20.0, distance=(5.0, 20.0))
    down = views.pose[:, -1] / views.pose[:, -1].norm(dim=-1, keepdim=True)
    torch.testing.assert_close(views.gravity, down, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(views.tilt, down[:, 2].asin(), atol=1e-5, rtol=1e-5)
    tilt, roll = down[:, 2].asin().rad2deg(), torch.atan2(-down[:, 0], down[:, 1]).rad2deg()
    assert (-10 <= tilt.min() < -9) and (39 < tilt.max() <= 40)
    assert (-20 <= roll.min() < -19) and (19 < roll.max() <= 20)
    far = views.distance * (views.pose[:, 16].norm(dim=-1) ** -1)  # in lengths of the body
    assert (5 <= far.min() * (1 + 1e-5) < 5.1) and (19.8 < far.max() <= 20 * (1 + 1e-5))


def test_a_guessed_focal_length_is_off_and_so_is_the_distance_that_is_told(poses, monkeypatch):
    monkeypatch.setattr("uplift.training.augmentation._ASIDE", 0.0)
    views = views_of_any_camera(poses, 4000, unknown_focal=1.0)
    # In the middle of the image the keypoints are the same whatever the focal length.
    torch.testing.assert_close(views.keypoints, Perspective().project(views.pose, views.distance), atol=1e-4, rtol=1e-4)
    blind = views.told == 10
    assert 0.1 < blind.float().mean() < 0.2
    off = (views.told / views.distance).log()[~blind]
    assert abs(off.mean()) < 0.03 and off.std() == pytest.approx(0.35, abs=0.03)
    assert views.guessed.all()


def test_a_share_of_the_views_is_from_cameras_like_their_own(standing):
    views = views_of_any_camera(standing, 2000, own_share=0.3)
    like_own = (views.gravity - standing.gravity[0]).norm(dim=-1) < 1e-4
    assert 0.25 < like_own.float().mean() < 0.35
    assert (like_own & views.guessed).sum() == 0
    unknown = replace(standing, guessed=torch.ones(300, dtype=torch.bool))
    alone = views_of(unknown, 50, mix=0.0)
    assert torch.equal(alone.told, alone.distance), "a student of own cameras is given what it is to use"
    views = views_of_any_camera(unknown, 2000, own_share=1.0)
    assert views.guessed.all() and (views.told == 10).all(), "as keypoints of an unknown camera are lifted"


def test_a_student_of_any_cameras_is_told_the_distance_and_learns_gravity(poses):
    lifter = LifterSettings(options={"units": 16}, cameras="any")
    module = training(poses, lifter, occlude=0.4)
    module.objective(BATCH)[0].backward()
    gradient = module.lifter.network
    assert (gradient.leave.weight.grad.abs().sum(1) == 0).nonzero()[:, 0].tolist() == [3 * 17 + ROOT]
    assert (gradient.enter.weight.grad.abs().sum(0)[-2:] > 0).all()
