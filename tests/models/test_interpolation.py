"""Short gaps are bridged: which joints, where they are put, and that it helps those that are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.data.clean import clean
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet, intrinsics_of
from uplift.geometry.camera import Perspective
from uplift.models.lifter import Lifted
from uplift.models.predict import as_measured, gap_joints, interpolate_gaps, refine_lifted
from uplift.skeleton import load_skeleton

SKELETON = load_skeleton("h36m17")
WRIST, ROOT = SKELETON.index("lwrist"), SKELETON.root_index


def without(data: PoseData, rows: np.ndarray, joint: int) -> PoseData:
    confidence = data.confidence.copy()
    confidence[rows, joint] = 0
    return clean(replace(data, confidence=confidence), SKELETON, drop=False)[0]


def true_lift(data: PoseData, frames: TrainingSet) -> Lifted:
    """Return what a perfect lifter says: the true pose, in the model's units and camera."""
    pose = torch.from_numpy(data.pose)
    if frames.rotation is not None:
        pose = pose @ frames.rotation.mT
        unit = torch.from_numpy(np.linalg.norm(data.root, axis=1)) / frames.distance
    else:
        unit = (torch.from_numpy(data.root[:, 2]) / data.focal_px) * frames.scale
    pose = pose / unit[:, None, None]
    return Lifted(pose, torch.zeros(len(pose)), Perspective().project(pose, frames.distance))


@pytest.mark.parametrize("joint", [WRIST, ROOT])
def test_a_bridged_joint_is_where_it_was(joint):
    whole = clean(simulate(SKELETON, 400, seed=2), SKELETON)[0]
    data = without(whole, np.arange(1, 400, 5), joint)
    intrinsics = intrinsics_of(data, LifterSettings())
    frames = TrainingSet.of(data, SKELETON, count_root=False, intrinsics=intrinsics)
    gap = gap_joints(frames)
    lifted, pixels = true_lift(data, frames).keypoints, torch.from_numpy(data.keypoints)
    bridged, confidence = interpolate_gaps(frames, pixels, lifted, intrinsics)
    off = np.linalg.norm(bridged.numpy() - whole.keypoints, axis=-1)[gap.numpy()]
    # The camera looks at the stand-in of a missing root, not at it: a little perspective is left.
    assert np.median(off) < (0.01 if joint == WRIST else 1.5)
    assert (confidence[gap] == 1).all()
    assert torch.equal(bridged[~gap], pixels[~gap])


def test_what_a_missing_root_is_measured_from_does_not_shake_the_clip():
    """The stand-in of a missing root is elsewhere; a smooth motion seen from there stays smooth."""
    whole = clean(simulate(SKELETON, 300, seed=5), SKELETON)[0]
    data = without(whole, np.arange(1, 300, 4), ROOT)
    intrinsics = intrinsics_of(data, LifterSettings())
    frames = TrainingSet.of(data, SKELETON, count_root=False, intrinsics=intrinsics)
    true = true_lift(data, frames)
    where = as_measured(frames, true.keypoints)
    seen = frames.confidence > 0
    torch.testing.assert_close(where[seen], frames.keypoints[seen], atol=0.08, rtol=0)
    mended = refine_lifted(true, frames, Perspective(), RefineSettings())
    gone = ~seen[:, ROOT]
    off = (mended.pose - true.pose).norm(dim=-1).mean(1)
    assert off[gone].mean() < 1.6 * off[~gone].mean()


def test_only_joints_that_a_neighbour_in_time_shows():
    confidence = np.ones((8, 17), np.float32)
    confidence[2, 3] = 0  # one frame
    confidence[5:, 4] = 0  # to the end: the first has a neighbour
    confidence[1] = 0  # nothing is seen
    names = np.array(list("aaaaabbb"))
    data = PoseData(np.ones((8, 17, 2), np.float32), confidence, SKELETON.joints, identity={"sequence": names})
    found = {(frame, joint) for frame, joint in gap_joints(TrainingSet.of(data, SKELETON)).nonzero().tolist()}
    assert found == {(2, 3)}, "frame 5 starts another clip"


def test_whole_frames_need_no_bridge():
    data = clean(simulate(SKELETON, 30, seed=2), SKELETON)[0]
    frames = TrainingSet.of(data, SKELETON, count_root=False)
    assert not gap_joints(frames).any()
    pixels = torch.from_numpy(data.keypoints)
    found, confidence = interpolate_gaps(frames, pixels, true_lift(data, frames).keypoints, None)
    assert torch.equal(found, pixels) and torch.equal(confidence, frames.confidence)
