"""Training sets: some of their frames, sets joined, masks of mirrored frames, and which camera is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lifts import H36M, bodies, labelled_frames, seen_bodies, training_set

from uplift.config.settings import LifterSettings
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet, intrinsics_of, mean_bones, to_training_set, undistorted, with_labels
from uplift.errors import UserError
from uplift.geometry.lens import Lens
from uplift.geometry.normalise import Intrinsics

SIZES = (4, 9, 2, 7, 3, 5)


def clips(labelled: int | None = None) -> TrainingSet:
    """Return thirty frames in clips of `SIZES`, one clip labelled or none."""
    clip = torch.arange(6).repeat_interleave(torch.tensor(SIZES))
    frames = replace(training_set(30), clip=clip)
    if labelled is None:
        return frames
    labels = torch.full((30, 17, 3), torch.nan)
    labels[clip == labelled] = 1.0
    labels[clip == labelled, 3] = torch.nan  # one joint without a label
    return replace(frames, labels=labels)


@pytest.mark.parametrize("most", [1, 5, 12, 29])
@pytest.mark.parametrize("labelled", [None, 1])
def test_some_frames_are_whole_clips_and_all_that_are_labelled(most: int, labelled: int | None) -> None:
    frames = clips(labelled)
    for seed in range(5):
        found = frames.some(most, seed)
        sizes = torch.bincount(found.clip).tolist()
        kept = [
            place
            for place in range(6)
            if (found.keypoints[:, None] == frames.keypoints[frames.clip == place]).all((2, 3)).any()
        ]
        assert sizes == [SIZES[place] for place in kept]
        beyond = [SIZES[place] for place in kept if place != labelled]
        assert sum(beyond) <= most or len(beyond) == 1
        assert labelled is None or labelled in kept
    assert len({tuple(frames.some(most, seed).keypoints.flatten().tolist()) for seed in range(9)}) > 1
    # In seeded order, until no more fit: the next one would be too much.
    order = torch.randperm(6, generator=torch.Generator().manual_seed(3)).tolist()
    counts = np.cumsum([SIZES[place] for place in order])
    assert len(clips().some(most, 3)) == max(counts[0], max(counts[counts <= most], default=0))


def test_all_frames_are_the_set_itself() -> None:
    frames = clips()
    assert frames.some(30, 0) is frames and frames.some(31, 0) is frames


def test_a_frame_is_labelled_where_any_joint_of_it_is() -> None:
    assert not clips().labelled.any() and clips().labelled.shape == (30,)
    assert clips(1).labelled.tolist() == [4 <= row < 13 for row in range(30)]


def test_sets_are_joined_with_clips_of_their_own_and_masks_of_one_side() -> None:
    one, other = clips(), clips(2)
    joined = TrainingSet.concat([one, other])
    assert joined.clip.tolist() == [*one.clip.tolist(), *(other.clip + 6).tolist()]
    assert joined.rotation is None and joined.labelled.tolist() == [False] * 30 + other.labelled.tolist()
    masks = [torch.zeros(30, side, side, dtype=torch.uint8) for side in (8, 9)]
    maps = torch.eye(3).expand(30, 3, 3)
    with pytest.raises(UserError, match="masks of 9 px a side, the others of 8"):
        TrainingSet.concat([replace(one, masks=part, mask_map=maps) for part in masks])
    assert len(TrainingSet.concat([replace(one, masks=masks[0], mask_map=maps)] * 2)) == 60
    assert TrainingSet.concat([one.select(slice(0, 0)), one]).clip.tolist() == one.clip.tolist()


def test_masks_stay_where_mirrored_keypoints_are_led_back_to() -> None:
    """A joint of a mirrored frame is its partner's place in the picture, which is not mirrored."""
    frames = training_set(6)
    maps = torch.tensor([[0.5, 0, 0.1], [0, 0.4, -0.2], [0.05, 0.02, 1]]).expand(6, 3, 3)
    frames = replace(frames, masks=torch.zeros(6, 8, 8, dtype=torch.uint8), mask_map=maps)
    batch = frames.draw(torch.tensor([5, 0, 3]))
    assert torch.equal(batch.row, torch.tensor([5, 0, 3])) and torch.equal(batch.keypoints, frames.keypoints[batch.row])
    mirrored = batch.mirrored(torch.tensor([True, False, True]), torch.tensor(H36M.mirror_permutation))

    def place(one):
        points = torch.cat([one.keypoints, torch.ones(3, 17, 1)], -1) @ one.mask_map.mT
        return points[..., :2] / points[..., 2:]

    before, after = place(batch), place(mirrored)
    torch.testing.assert_close(after[[0, 2]][:, torch.tensor(H36M.mirror_permutation)], before[[0, 2]])
    torch.testing.assert_close(after[1], before[1])


def test_masks_are_led_to_by_what_leads_back_to_pixels() -> None:
    """(u, v) of a joint in its crop, from -1 at its upper left to 1, by the pixel of the joint; NaN without a mask."""
    data = replace(seen_bodies().select(slice(0, 3)), labelled=None)
    box = np.array([[100, -50, 800], [300, 200, 400], [0, 0, np.nan]], np.float32)
    masks = np.full((3, 8, 8), 255, np.uint8)
    data = replace(data, masks=masks, mask_box=box)
    expected = 2 * (data.keypoints - box[:, None, :2]) / box[:, None, 2:] - 1
    for settings in (LifterSettings(), LifterSettings(intrinsics="off")):
        frames = to_training_set(data, H36M, settings)
        points = torch.cat([frames.keypoints, torch.ones(3, 17, 1)], -1) @ frames.mask_map.mT
        np.testing.assert_allclose((points[..., :2] / points[..., 2:])[:2], expected[:2], atol=1e-4)
        assert frames.mask_map[2].isnan().any()
    empty = replace(data, masks=masks * np.array([1, 0, 1], np.uint8)[:, None, None])
    assert to_training_set(empty, H36M, LifterSettings()).mask_map[1].isnan().any()


def test_a_camera_is_used_where_it_is_known_and_wanted() -> None:
    data = seen_bodies()
    assert intrinsics_of(data, LifterSettings()) == Intrinsics(1145.0, (500.0, 500.0))
    for settings in (LifterSettings(intrinsics="off"), LifterSettings(camera="orthographic")):
        assert intrinsics_of(data, settings) is None
        assert to_training_set(data, H36M, settings).rotation is None
    for unknown in (replace(data, focal_px=None), replace(data, image_size=None)):
        assert intrinsics_of(unknown, LifterSettings()) is None
    lens = Lens((1200.0, 1100.0), (480.0, 520.0), (-0.2, 0.1, 0.0), image_size=(1000, 900))
    bent = replace(data, lenses=(lens,), lens=np.zeros(40, int))
    assert undistorted(bent, LifterSettings(intrinsics="off")) is bent
    straight = undistorted(bent, LifterSettings())
    assert straight.focal_px == 1150 and straight.image_size == (1000, 900)
    expected = lens.rays(data.keypoints.astype(float)) * 1150 + (500, 450)
    np.testing.assert_allclose(straight.keypoints, expected, atol=1e-3)
    made = [to_training_set(one, H36M, LifterSettings()) for one in (bent, straight)]
    for name in ("keypoints", "scale", "rotation"):
        assert torch.equal(*(getattr(one, name) for one in made))
    everywhere = LifterSettings(distance=7.0, radius="all", intrinsics="off")
    assert (to_training_set(data, H36M, everywhere).distance == 7).all()


def test_the_unit_of_a_label_is_by_the_root_where_it_is_known_else_by_the_keypoints() -> None:
    data: PoseData = seen_bodies()
    far = np.linalg.norm(data.root, axis=1)
    frames = labelled_frames(data)
    np.testing.assert_allclose(frames.label_unit * frames.distance, far, rtol=1e-5)
    lost = data.root.copy()
    lost[:20] = np.nan
    some = labelled_frames(replace(data, root=lost))
    assert torch.equal(some.label_unit[20:], frames.label_unit[20:])
    # About the keypoints' own scale: bodies are a few hundred mm deep at five metres.
    assert not torch.equal(some.label_unit[:20], frames.label_unit[:20])
    torch.testing.assert_close(some.label_unit[:20], frames.label_unit[:20], rtol=0.2, atol=0)
    flat = some.labels[:20, :, :2]
    slope = (flat * some.keypoints[:20]).sum((1, 2)) / flat.square().sum((1, 2))
    torch.testing.assert_close(slope, torch.ones(20), rtol=1e-4, atol=0)
    assert mean_bones(to_training_set(bodies(5), H36M, LifterSettings())) is None
    assert with_labels(frames, replace(data, pose=None)) is frames
