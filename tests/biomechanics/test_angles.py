"""Joint angles: those that a synthetic body was given, by scipy's Euler angles; mirror, scale, turning; uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uplift.biomechanics.angles import Angles, angles_of, joint_angles, wrapped
from uplift.config.files import shipped_names
from uplift.errors import UserError
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton, load_skeleton

HUMAN = load_skeleton("openpose25")
WITH_ANGLES = [name for name in shipped_names("skeletons") if load_skeleton(name).angles]
FRAMES = 400
TILT = Rotation.from_euler("x", 20, degrees=True).as_matrix()

# The ISB's axes of a segment, x ahead, y up, z to the right, of a body that faces the camera, in level axes.
ISB = np.array([[0, 0, -1.0], [0, -1.0, 0], [-1.0, 0, 0]]).T


def column(found: Angles, name: str) -> np.ndarray:
    return found.values[:, found.names.index(name)]


def isb(order: str, *degrees: np.ndarray) -> np.ndarray:
    """Return the rotations, in level axes, of a segment turned by intrinsic Euler angles about the ISB's axes."""
    return ISB @ Rotation.from_euler(order, np.stack(degrees, -1), degrees=True).as_matrix() @ ISB.T


def neutral() -> dict[str, np.ndarray]:
    """Return a body that stands straight and faces the camera (x its left, y down, z behind it), feet ahead."""
    points = {"MidHip": (0, 0, 0), "Neck": (0, -500, 0), "Nose": (0, -650, -90)}
    for side, x in (("L", 1), ("R", -1)):
        points |= {
            f"{side}Hip": (90 * x, 0, 0), f"{side}Knee": (90 * x, 420, 0), f"{side}Ankle": (90 * x, 830, 0),
            f"{side}Heel": (90 * x, 890, 60), f"{side}BigToe": (80 * x, 890, -190), f"{side}SmallToe": (100 * x, 890, -190),
            f"{side}Shoulder": (170 * x, -500, 0), f"{side}Elbow": (170 * x, -220, 0), f"{side}Wrist": (170 * x, 30, 0),
            f"{side}Eye": (30 * x, -680, -70), f"{side}Ear": (70 * x, -660, 0),
        }  # fmt: skip
    return {name: np.array(place, float) for name, place in points.items()}


FOOT = ("RHeel", "RBigToe", "RSmallToe")
BEYOND = {  # the outermost first
    "RElbow": ("RWrist",), "RShoulder": ("RElbow", "RWrist"), "RAnkle": FOOT, "RKnee": ("RAnkle", *FOOT),
    "RHip": ("RKnee", "RAnkle", *FOOT),
}  # fmt: skip


def turned(turns: dict[str, np.ndarray]) -> np.ndarray:
    """Return poses (frames 25 3) of a body whose right limbs are turned at joints by rotations (frames 3 3)."""
    points = {name: np.tile(place, (FRAMES, 1)) for name, place in neutral().items()}
    for joint in (name for name in BEYOND if name in turns):
        for point in BEYOND[joint]:
            points[point] = points[joint] + np.einsum("fij,fj->fi", turns[joint], points[point] - points[joint])
    return np.stack([points[joint] for joint in HUMAN.joints], 1)


def test_a_body_that_stands_straight_has_angles_of_zero() -> None:
    found = joint_angles(turned({}), HUMAN)
    unseen = [name for name, value in zip(found.names, found.values[0], strict=True) if np.isnan(value)]
    # Straight limbs do not show these.
    assert unseen == ["right_hip_rotation", "left_hip_rotation", "right_shoulder_plane", "left_shoulder_plane"]
    assert np.nanmax(np.abs(found.values)) < 1e-3


def test_angles_are_the_isbs_euler_angles() -> None:
    draw = np.random.default_rng(0).uniform
    ranges = {
        "hip_flexion": (-40, 120), "hip_abduction": (-30, 50), "hip_rotation": (-40, 40), "knee_flexion": (15, 140),
        "ankle_dorsiflexion": (-40, 30), "shoulder_plane": (-90, 130), "shoulder_elevation": (15, 165),
        "elbow_flexion": (0, 145),
    }  # fmt: skip
    given = {name: draw(*ends, FRAMES) for name, ends in ranges.items()}
    none, twist = np.zeros(FRAMES), draw(-60, 60, FRAMES)
    turns = {
        # Grood and Suntay 1983: flexion about z, adduction about x, inward rotation about y.
        "RHip": isb("ZXY", given["hip_flexion"], -given["hip_abduction"], given["hip_rotation"]),
        "RKnee": isb("ZXY", -given["knee_flexion"], none, none),
        "RAnkle": isb("ZXY", given["ankle_dorsiflexion"], none, none),
        # Wu et al. 2005: the plane of elevation about y, elevation about x (negative), axial rotation about y.
        "RShoulder": isb("YXY", given["shoulder_plane"], -given["shoulder_elevation"], twist),
        "RElbow": isb("ZXY", given["elbow_flexion"], none, none),
    }
    found = joint_angles(turned(turns), HUMAN)
    for name, values in given.items():
        assert np.abs(wrapped(column(found, f"right_{name}") - values)).max() < 0.01, name
    rest = [name for name in found.names if not name.startswith("right_") and "plane" not in name]
    assert np.nanmax(np.abs([column(found, name) for name in rest])) < 1e-3  # nothing else moved


def test_a_trunk_has_the_angles_it_is_turned_by() -> None:
    draw = np.random.default_rng(1).uniform
    lean, bend, twist = draw(-20, 80, FRAMES), draw(-30, 30, FRAMES), draw(-40, 40, FRAMES)
    upper = [HUMAN.index(name) for name in ("Neck", "Nose", "LEar", "REar", "LShoulder", "RShoulder")]
    cases = (
        ((-lean, bend, 0 * twist), {"flexion": lean, "lateral_bend": bend}),
        ((0 * lean, 0 * bend, twist), {"rotation": twist}),
    )
    for turns, expected in cases:
        pose = turned({})
        pose[:, upper] = np.einsum("fij,fkj->fki", isb("ZXY", *turns), pose[:, upper])
        found = joint_angles(pose, HUMAN)
        for name, values in expected.items():
            assert np.abs(column(found, f"trunk_{name}") - values).max() < 0.01, name


def a_pose(skeleton: Skeleton, frames: int = 50) -> np.ndarray:
    return np.random.default_rng(2).normal(size=(frames, len(skeleton.joints), 3)) * 100


@pytest.mark.parametrize("name", WITH_ANGLES)
def test_a_mirrored_body_has_the_other_sides_angles(name: str) -> None:
    skeleton = load_skeleton(name)
    pose = a_pose(skeleton)
    found = joint_angles(pose, skeleton)
    assert len(found.names) == len(set(found.names)) and np.isfinite(found.values).mean() > 0.9
    assert (found.values[np.isfinite(found.values)] > -180.001).all()
    if not skeleton.mirror:
        return
    image = joint_angles((pose * [-1, 1, 1])[:, skeleton.mirror_permutation], skeleton)
    swap = {"right": "left", "left": "right"}
    for angle in found.names:
        across = "_".join(swap.get(word, word) for word in angle.split("_"))
        one, other = column(found, angle), column(image, across)
        same = np.abs(wrapped(one - other))
        opposite = np.abs(wrapped(one + other)) if across == angle else same  # of the midline: to the other side
        known = np.isfinite(one)
        assert (np.isfinite(other) == known).all()
        assert min(same[known].max(), opposite[known].max()) < 1e-2, angle


@pytest.mark.parametrize("name", ["h36m17", "quadruped28", "hand21"])
def test_scale_and_a_turn_about_the_vertical_change_no_angle_of_the_body(name: str) -> None:
    skeleton = load_skeleton(name)
    pose, turn = a_pose(skeleton), Rotation.from_euler("y", 70, degrees=True).as_matrix()
    found, other = joint_angles(pose, skeleton), joint_angles(0.01 * pose @ turn.T + [5, 6, 7], skeleton)
    moved = np.abs(wrapped(found.values - other.values))
    heading = [name for name in found.names if np.nanmax(moved[:, found.names.index(name)]) > 0.01]
    assert heading in ([], ["pelvis_rotation"])
    if heading:  # about y, which points down, is clockwise from above: to its right
        change = wrapped(column(other, "pelvis_rotation") - column(found, "pelvis_rotation"))
        assert np.nanmax(np.abs(change + 70)) < 0.01


def test_what_is_missing_leaves_its_own_angles_blank() -> None:
    pose = a_pose(HUMAN)
    pose[0, HUMAN.index("RWrist")] = np.nan
    found = joint_angles(pose, HUMAN)
    assert np.isnan(column(found, "right_elbow_flexion")[0]) and np.isfinite(column(found, "left_elbow_flexion")[0])


def a_prediction(pose: np.ndarray, **more: object) -> Prediction:
    """Return a prediction seen by a camera that looks 20 degrees down."""
    flat = np.zeros((*pose.shape[:2], 2)), np.ones(pose.shape[:2])
    return Prediction(pose @ TILT.T, pose, "mm", *flat, HUMAN.joints, HUMAN, **more)


def test_a_prediction_has_the_angles_of_its_level_pose() -> None:
    pose = a_pose(HUMAN)
    found = joint_angles(a_prediction(pose))
    assert found.uncertainty is None
    assert np.nanmax(np.abs(wrapped(found.values - joint_angles(pose, HUMAN).values))) < 1e-3


def test_uncertainty_is_the_error_that_noise_along_the_bones_makes() -> None:
    knee, rng, step = np.full(FRAMES, 60.0), np.random.default_rng(4), 6.0
    sure = a_prediction(turned({"RKnee": isb("ZXY", -knee, 0 * knee, 0 * knee)}))
    noise, spread = np.zeros(sure.pose.shape), np.zeros(sure.pose.shape[:2])
    for parent, child in HUMAN.bone_indices[np.argsort([_depth(joint) for _, joint in HUMAN.bones])]:
        noise[:, child, 2] = noise[:, parent, 2] + rng.normal(size=FRAMES) * step
        spread[:, child] = np.hypot(spread[:, parent], step)
    hidden = np.zeros(spread.shape, bool)
    for name in ("no joint", "RAnkle"):
        if name in HUMAN.joints:  # not seen: the same in depth, and as much across, is a length in 3D
            place = HUMAN.index(name)
            hidden[:, place], noise[:, place, :2] = True, rng.normal(size=(FRAMES, 2)) * spread[:, [place]]
            spread[:, place] *= np.sqrt(3)
        found = joint_angles(replace(sure, uncertainty=spread, filled=hidden))
        pose = sure.pose + noise
        noisy = joint_angles(replace(sure, pose=pose, level_pose=pose @ TILT))
        assert found.uncertainty is not None
        for angle in ("right_knee_flexion", "trunk_flexion", "left_ankle_dorsiflexion", "trunk_rotation"):
            error = column(noisy, angle) - column(found, angle)
            expected = found.uncertainty[:, found.names.index(angle)]
            assert np.sqrt((error**2).mean()) == pytest.approx(float(np.sqrt((expected**2).mean())), rel=0.12), angle


def _depth(joint: str) -> int:
    parent = HUMAN.parents[joint]
    return 0 if parent is None else 1 + _depth(parent)


def test_a_skeleton_without_angles_says_so() -> None:
    bare = replace(HUMAN, name="mine", angles={})
    with pytest.raises(UserError, match="'mine' names no joint angles: write angles:"):
        joint_angles(a_pose(bare), bare)


def test_a_run_with_an_older_copy_of_a_shipped_skeleton_has_its_angles() -> None:
    assert angles_of(replace(HUMAN, angles={})) == HUMAN.both_sides
