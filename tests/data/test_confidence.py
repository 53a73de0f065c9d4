"""What confidences are worth: made-up detectors of known errors, whatever scale their confidences have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lifts import H36M

from uplift.config.settings import LifterSettings
from uplift.data.clean import clean
from uplift.data.confidence import calibrated
from uplift.data.poses import PoseData

SETTINGS = LifterSettings()
RADIUS_PX = 84.0
JOINTS = len(H36M.joints)


def film(frames: int = 1500, seed: int = 0) -> PoseData:
    """Return a body whose joints swing smoothly about a standing pose, at 30 frames a second."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / 30
    turns = rng.uniform(0.2, 1.0, (4, 1, JOINTS, 2))
    swing = sum(np.sin(2 * np.pi * (one * time + rng.random((JOINTS, 2)))) for one in turns)
    place = rng.standard_normal((JOINTS, 2)) * RADIUS_PX + 500
    points = (place + swing * rng.uniform(1, 10, (JOINTS, 1))).astype(np.float32)
    identity = {"sequence": np.repeat("one", frames), "frame": np.arange(frames)}
    return clean(PoseData(points, np.ones((frames, JOINTS), np.float32), H36M.joints, identity=identity), H36M)[0]


def detected(data: PoseData, seed: int = 1) -> tuple[PoseData, np.ndarray]:
    """Return ``data`` with errors and confidences that tell them roughly, and the errors' mean lengths, px."""
    rng = np.random.default_rng(seed)
    mean = np.exp(rng.normal(np.log(2.0), 0.7, data.confidence.shape))
    mean[rng.random(mean.shape) < 0.03] = 40.0
    error = rng.standard_normal((*mean.shape, 2)) * (mean / np.sqrt(np.pi / 2))[..., None]
    confidence = 0.9 - 0.2 * np.log(mean) + rng.normal(0, 0.02, mean.shape)
    keypoints = (data.keypoints + error).astype(np.float32)
    return replace(data, keypoints=keypoints, confidence=np.clip(confidence, 0.01, 1).astype(np.float32)), mean


def radius_of(data: PoseData) -> float:
    middle = np.median(data.keypoints, axis=1, keepdims=True)
    return float(np.median(np.linalg.norm(data.keypoints - middle, axis=-1)))


def test_confidence_tells_the_error_of_a_made_up_detector() -> None:
    exact = film()
    data, mean = detected(exact)
    found = calibrated(data, H36M, SETTINGS).confidence
    said = 0.05 / np.maximum(found, 1e-9) - 0.05
    for low, high in ((1.0, 1.5), (1.5, 3.0), (3.0, 6.0)):
        among = (mean > low) & (mean < high) & (found > 0)
        assert np.median(said[among]) == pytest.approx(np.median(mean[among]) / radius_of(exact), rel=0.3)
    assert (found[mean == 40.0] == 0).mean() > 0.9  # an error of half of the body is worse than none
    assert (found[mean < 6] > 0).mean() > 0.99


@pytest.mark.parametrize(
    "rescaled", [lambda c: 0.6 * c, np.square, lambda c: 0.3 + 0.1 * c], ids=["0.6", "square", "narrow"]
)
def test_only_the_order_of_confidences_counts(rescaled) -> None:
    data, _ = detected(film(300))
    changed = replace(data, confidence=rescaled(data.confidence.astype(np.float64)).astype(np.float32))
    found, other = (calibrated(one, H36M, SETTINGS) for one in (data, changed))
    np.testing.assert_allclose(other.confidence, found.confidence, atol=2e-3)
    np.testing.assert_array_equal(other.keypoints, found.keypoints)


@pytest.mark.parametrize("told", [0.2, 1.0])
def test_exact_keypoints_are_exact_whatever_their_confidence(told: float) -> None:
    rng = np.random.default_rng(2)
    data = film()
    data = replace(data, confidence=np.where(rng.random(data.confidence.shape) < 0.3, told, 1).astype(np.float32))
    assert calibrated(data, H36M, SETTINGS).confidence.min() > 0.95


def test_a_keypoint_that_jumps_out_and_back_is_missing_and_a_missing_root_stands_between_its_neighbours() -> None:
    data = film(60)
    keypoints = data.keypoints.copy()
    wrist, root = H36M.index("lwrist"), H36M.root_index
    keypoints[20, wrist, 0] += RADIUS_PX
    keypoints[40, root, 1] += RADIUS_PX
    found = calibrated(replace(data, keypoints=keypoints), H36M, SETTINGS)
    assert {tuple(place) for place in np.argwhere(found.confidence == 0)} == {(20, wrist), (40, root)}
    neighbours = [H36M.index(joint) for joint in ("rhip", "lhip", "spine")]
    np.testing.assert_allclose(found.keypoints[40, root], keypoints[40, neighbours].mean(0), rtol=1e-5)
    assert found.root_filled is not None and found.root_filled[40]


def test_a_few_frames_say_nothing_and_given_confidences_stay() -> None:
    data, _ = detected(film(60))
    one = data.select(slice(7, 8))
    assert (calibrated(one, H36M, SETTINGS).confidence == 1).all()
    given = LifterSettings(confidence="given")
    assert calibrated(data, H36M, given) is data


def test_stills_are_worth_what_they_are_in_a_typical_detector_and_missing_stays_missing() -> None:
    data, _ = detected(film(600))
    confidence = data.confidence.copy()
    confidence[::7, 3] = 0
    found = calibrated(replace(data, confidence=confidence, identity={}), H36M, SETTINGS).confidence
    assert (found[::7, 3] == 0).all()
    order = np.argsort(confidence[found > 0], kind="stable")
    assert (np.diff(found[found > 0][order]) >= 0).all()
    assert 0.7 < np.median(found[found > 0]) < 0.95
