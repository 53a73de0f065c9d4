"""One prediction against one truth: the figures of the single protocols, grouped, honest about gaps."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.metrics import pose_metrics as metrics
from uplift.metrics.alignment import ALIGNED_ERRORS
from uplift.metrics.baselines import flat_depth
from uplift.metrics.evaluate import evaluate
from uplift.metrics.protocols import PROTOCOLS, SHAPE_METRICS, metric_label, metric_order
from uplift.metrics.scores import GivenPoses, previous_rows
from uplift.skeleton import Skeleton, load_skeleton

SHIPPED = load_skeleton(Path(__file__).parents[2] / "skeletons" / "h36m17.yaml")
NOSE = {"front": (("thorax",), ("nose",)), "left": (("rshoulder",), ("lshoulder",))}
HUMAN = replace(SHIPPED, facing=NOSE)
ROOT = HUMAN.root_index
FLIPPED = ("mpjpe_gt_scale_best_of_flip", "n_mpjpe_best_of_flip", "p_mpjpe_best_of_flip")
PAPER = ["Directions", "Discussion", "Eating", "Greeting", "Phoning", "Photo", "Posing", "Purchases"]
PAPER += ["Sitting", "SittingDown", "Smoking", "Waiting", "WalkDog", "Walking", "WalkTogether"]


def some_truth(frames: int = 90, unit: str = "mm") -> PoseData:
    """Return noise of a body's size: three subjects, two actions, six clips of every third frame."""
    rng = np.random.default_rng(11)
    pose = rng.normal(size=(frames, 17, 3)) * 300
    pose -= pose[:, ROOT, None]
    number = np.arange(frames)
    identity = {
        "subject": np.array(["S1", "S2", "S3"])[number // 30],
        "action": np.array(["walk", "sit"])[(number % 4 == 0).astype(int)],
        "sequence": np.array(["a", "b"])[number // 15 % 2],
        "frame": number % 15 * 3,
    }
    return PoseData(
        keypoints=pose[..., :2].astype(np.float32),
        confidence=np.ones((frames, 17), np.float32),
        joint_names=HUMAN.joints,
        pose=pose.astype(np.float32),
        unit=unit,
        identity=identity,
        tilt_deg=rng.normal(size=frames),
    )


def guess(truth: PoseData, unit: str = "relative", **more) -> GivenPoses:
    noise = np.random.default_rng(2).normal(size=truth.pose.shape) * 100
    return GivenPoses((truth.pose + noise) / (1 if unit == "mm" else 300), truth.joint_names, unit, **more)


def error(name: str, pose: np.ndarray, truth: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return the mean joint error of each frame, or the smaller one of a pose and its depth flip."""
    base = name.removesuffix("_best_of_flip")
    poses = [pose] if base == name else [pose, metrics.flip_depth(pose)]
    counts = np.ones(pose.shape[:2]) if weight is None else weight
    return np.min([metrics.frame_mean(metrics.joint_errors(base, x, truth, ROOT, weight), counts) for x in poses], 0)


def test_overall_is_what_the_single_protocols_say():
    truth = some_truth()
    given = guess(truth, tilt_deg=np.full(90, 0.2))
    pose, target = given.pose, truth.pose.astype(float)
    scaled = pose * ((pose * target).sum((1, 2)) / (pose**2).sum((1, 2)))[:, None, None]
    off = np.linalg.norm(scaled - target, axis=-1)
    previous = previous_rows(truth.identity)
    expected = {
        **{name: error(name, pose, target) for name in (*ALIGNED_ERRORS[1:], *FLIPPED)},
        "pck@150": (off < 150).mean(1),
        "auc": np.mean([(off < threshold).mean(1) for threshold in np.linspace(0, 150, 31)], 0),
        "pck_z@150": (np.abs(scaled - target)[..., 2] < 150).mean(1),
        "stress": metrics.stress(scaled, target),
        "mpjve": metrics.mpjve(scaled, target, previous),
        "facing": error("p_mpjpe", pose, target) <= error("p_mpjpe", metrics.flip_depth(pose), target),
        "facing_sign": metrics.facing_sign(pose, HUMAN),
    }
    found = evaluate(given, truth, HUMAN)
    for name, values in expected.items():
        assert found.overall[name] == pytest.approx(np.nanmean(values), rel=1e-6), name
    assert found.overall["elevation_deg"] == pytest.approx(np.median(np.abs(0.2 - truth.tilt_deg)))
    lengths = metrics.bone_lengths(scaled, HUMAN)
    assert found.overall["bone_cv"] == pytest.approx(metrics.bone_cv(lengths, np.arange(90) // 30), rel=1e-5)
    leftover = {name for name in found.overall if not name.endswith("_action_mean")} - set(expected)
    assert leftover == {"elevation_deg", "elevation_deg_clip", "wrong_signs", "bone_cv", "symmetry"}


def test_groups_and_joints_derive_from_the_same_numbers():
    truth = some_truth()
    found = evaluate(guess(truth), truth, HUMAN)
    values = error("p_mpjpe", guess(truth).pose, truth.pose)
    by_action = {name: values[truth.identity["action"] == name].mean() for name in ("sit", "walk")}
    assert {name: of["p_mpjpe"] for name, of in found.per_action.items()} == pytest.approx(by_action)
    assert found.overall["p_mpjpe_action_mean"] == pytest.approx(np.mean(list(by_action.values())))
    assert found.overall["p_mpjpe_action_mean"] != pytest.approx(found.overall["p_mpjpe"], rel=1e-9)
    assert list(found.per_subject) == ["S1", "S2", "S3"]
    assert np.mean([of["n_mpjpe"] for of in found.per_subject.values()]) == pytest.approx(found.overall["n_mpjpe"])
    for name in ("p_mpjpe", "mpjpe_gt_scale", "pck@150", "p_mpjpe_best_of_flip"):
        mean = np.mean([of[name] for of in found.per_joint.values()])
        assert mean == pytest.approx(found.overall[name])
    assert found.per_joint["hip"]["mpjpe_gt_scale"] > 0
    assert list(found.per_joint) == list(HUMAN.joints)


def test_metric_error_needs_a_metric_prediction_and_pck_needs_mm():
    truth = some_truth()
    metric = evaluate(guess(truth, "mm"), truth, HUMAN)
    off = np.linalg.norm(guess(truth, "mm").pose - truth.pose, axis=-1)
    assert metric.overall["mpjpe"] == pytest.approx(off.mean())
    assert metric.overall["pck@150"] == pytest.approx((off < 150).mean())
    assert any("the metric pose (mm)" in note for note in metric.notes)
    relative = evaluate(guess(truth), truth, HUMAN)
    assert "mpjpe" not in relative.overall
    assert any("n_mpjpe scale" in note for note in relative.notes)
    other = evaluate(guess(truth), some_truth(unit="relative"), HUMAN)
    assert not any(name.startswith(("pck", "auc", "mpjpe_action")) for name in other.overall)
    assert other.overall["p_mpjpe"] == pytest.approx(relative.overall["p_mpjpe"])


def test_small_bodies_have_no_pck_as_150_mm_is_most_of_them():
    truth = some_truth()
    small = replace(truth, pose=truth.pose * np.float32(75 / np.ptp(truth.pose, axis=1).max()))
    found = evaluate(guess(small, "mm"), small, HUMAN)
    assert "mpjpe" in found.overall and not any(name.startswith(("pck", "auc")) for name in found.overall)
    (note,) = [note for note in found.notes if "pck" in note]
    size = float(note.split(" mm;")[0].split()[-1])
    assert 50 < size <= 75 * 3**0.5, note
    assert not any("pck" in line and "150" in line for line in found.table().splitlines() if note not in line)


def test_joints_are_matched_by_name():
    truth = some_truth()
    given = guess(truth)
    order = np.random.default_rng(0).permutation(17)
    names = (*(HUMAN.joints[j] for j in order), "tail")
    pose = np.concatenate([given.pose[:, order], np.full((90, 1, 3), 5.0)], 1)
    found = evaluate(replace(given, pose=pose, joint_names=names), truth, HUMAN)
    assert found.overall == pytest.approx(evaluate(given, truth, HUMAN).overall)
    assert any("tail" in note for note in found.notes)


def test_joints_missing_in_2d_count_apart():
    truth = some_truth()
    given = guess(truth)
    unseen = np.random.default_rng(4).random((90, 17)) < 0.2
    unseen[:2, 1:] = True
    spoilt = given.pose.copy()
    spoilt[unseen] *= 4
    found = evaluate(replace(given, pose=spoilt), replace(truth, confidence=1.0 - unseen), HUMAN)
    weight = 1.0 - unseen[2:]
    expected = error("p_mpjpe", given.pose[2:], truth.pose[2:], weight)
    assert found.frames == 88
    assert found.overall["p_mpjpe"] == pytest.approx(expected.mean())
    errors = metrics.joint_errors("p_mpjpe", spoilt[2:], truth.pose[2:], ROOT, weight)
    missing = metrics.frame_mean(errors, unseen[2:].astype(float))
    assert found.overall["p_mpjpe_missing"] == pytest.approx(np.nanmean(missing))
    assert found.overall["p_mpjpe_missing"] > found.overall["p_mpjpe"]


def test_unknown_truth_and_unknown_prediction_are_left_out_and_told():
    truth = some_truth()
    given = guess(truth)
    truth.pose[:, 4], given.pose[:30, 9], given.pose[5] = np.nan, np.inf, np.nan
    found = evaluate(given, truth, HUMAN)
    assert found.frames == 89
    assert found.overall["coverage"] == pytest.approx(1 - (29 + 16) / (90 * 16))
    assert np.isfinite(list(found.overall.values())).all()
    assert found.per_joint["lhip"] == {}
    assert any("left out" in note for note in found.notes)


@pytest.mark.parametrize("fill", [0.0, 3.7, 1e-35])
def test_a_prediction_without_extent_gives_numbers_and_plain_json(fill):
    truth = some_truth()
    given = GivenPoses(np.full((90, 17, 3), fill, np.float32), truth.joint_names, "mm")
    found = evaluate(given, truth, HUMAN)
    json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert found.overall["p_mpjpe"] > 100
    assert found.overall["facing_sign"] == 0


def test_root_of_the_prediction_is_not_moved():
    truth = some_truth()
    deep = truth.pose + np.array([0, 0, 100], np.float32)
    found = evaluate(GivenPoses(deep, truth.joint_names), truth, HUMAN)
    assert found.overall["mpjpe_gt_scale"] == pytest.approx(100)
    assert found.overall["p_mpjpe"] < 1e-3
    assert any("off the origin" in note for note in found.notes)


def test_wrong_predictions_are_refused_in_words():
    truth = some_truth()
    given = guess(truth, source="mine.npz")
    names = ("hipp", *HUMAN.joints[1:])
    with pytest.raises(UserError, match=r"mine.npz: lacks 1 of the 17 joints .* hip\. It has hipp instead"):
        evaluate(replace(given, joint_names=names), truth, HUMAN)
    with pytest.raises(UserError, match=r"shape \(80, 17, 3\), expected \(90, 17, 3\)"):
        evaluate(replace(given, pose=given.pose[:80]), truth, HUMAN)
    with pytest.raises(UserError, match="no 'pose'"):
        evaluate(given, truth.without_truth(), HUMAN)
    with pytest.raises(UserError, match=r"'frame' is not .* row 0 has 1, expected 0"):
        evaluate(replace(given, identity={"frame": truth.identity["frame"] + 1}), truth, HUMAN)
    with pytest.raises(UserError, match="nothing to compare"):
        evaluate(replace(given, pose=given.pose * np.nan), truth, HUMAN)


def test_previous_frames_stay_in_the_clip_and_do_not_cross_gaps():
    identity = {
        "sequence": np.array(["b", "a", "a", "a", "b", "a", "b"]),
        "camera": np.array([0, 0, 0, 0, 0, 1, 0]),
        "frame": np.array([9, 6, 0, 3, 6, 9, 0]),
    }
    assert previous_rows(identity).tolist() == [4, 3, -1, 2, -1, -1, -1]
    assert previous_rows({**identity, "frame": np.array([9, 6, 0, 3, 3, 9, 0])})[[0, 4]].tolist() == [-1, 6]
    assert previous_rows({key: identity[key] for key in ("sequence", "camera")}) is None
    assert previous_rows({"sequence": np.array(["a", "a"]), "frame": np.array([4, 4])}) is None
    assert previous_rows({"sequence": np.array(["a", "b"]), "frame": np.array([1, 2])}) is None


def test_chunks_change_nothing(monkeypatch):
    truth = some_truth()
    whole = evaluate(guess(truth), truth, HUMAN)
    monkeypatch.setattr("uplift.metrics.scores._CHUNK", 7)
    parts = evaluate(guess(truth), truth, HUMAN)
    assert parts.overall == pytest.approx(whole.overall)
    assert parts.per_joint["nose"] == pytest.approx(whole.per_joint["nose"])


def test_skeleton_without_facing_has_no_handedness():
    truth = some_truth()
    found = evaluate(guess(truth), truth, replace(HUMAN, facing={}, mirror=()))
    assert "facing_sign" not in found.overall
    assert "symmetry" not in found.overall
    assert found.overall["facing"] == pytest.approx(evaluate(guess(truth), truth, HUMAN).overall["facing"])


def test_table_has_the_papers_columns_in_order():
    truth = some_truth()
    truth.identity["action"] = np.array(sorted(PAPER) * 6)
    table = evaluate(guess(truth), truth, HUMAN, data="h36m").table()
    head = next(line for line in table.splitlines() if line.startswith("per action"))
    paper = "Direct. Discuss Eating Greet Phone Photo Pose Purch. Sitting SittingD Smoke Wait WalkD Walk WalkT"
    assert head.split()[2:] == [*paper.split(), "Avg"]
    row = next(line for line in table.splitlines() if line.startswith("p_mpjpe ") and len(line.split()) == 17)
    assert float(row.split()[-1]) == pytest.approx(np.mean([float(cell) for cell in row.split()[1:-1]]), abs=0.1)


ACTIVITIES = [
    "Standing/Walking",
    "Exercising",
    "Sitting",
    "Reaching/Crouching",
    "On The Floor",
    "Sports",
    "Miscellaneous",
]


def official_figures(pose: np.ndarray, target: np.ndarray, action: np.ndarray) -> dict[str, tuple[float, float]]:
    """Return PCK and AUC of each activity and of all frames as the test set's own script counts them.

    Joint by joint (its groups are weighted by their joints), errors strictly below 0, 5, ..., 150 mm.
    """
    error = np.linalg.norm(pose - target, axis=-1)[:, :14]
    found = {}
    for name in (*ACTIVITIES, "all"):
        chosen = error[(action == name) | (name == "all")]
        curve = [sum((chosen[:, joint] < limit).mean() for joint in range(14)) / 14 for limit in range(0, 151, 5)]
        found[name] = curve[-1], sum(curve) / 31
    return found


def test_mpi_inf_3dhp_as_its_own_script_counts():
    joints = load_skeleton("mpi_inf_3dhp17")
    rng = np.random.default_rng(5)
    target = rng.normal(size=(140, 17, 3)) * 300
    target -= target[:, 14, None]
    pose = target + rng.normal(size=target.shape) * rng.uniform(20, 120, (140, 1, 1))
    pose[:, 14] = 0
    pose[:2, 0] = target[:2, 0] + [[150, 0, 0], [149.9, 0, 0]]  # at the threshold is not below it
    # As many frames of an activity as the test set has unevenly: the mean of activities is not that of frames.
    action = np.repeat(ACTIVITIES, [40, 30, 25, 20, 10, 10, 5])
    truth = PoseData(
        keypoints=target[..., :2].astype(np.float32),
        confidence=np.ones((140, 17), np.float32),
        joint_names=joints.joints,
        pose=target,
        identity={"action": action},
    )
    found = evaluate(GivenPoses(pose, joints.joints, "mm"), truth, joints)
    expected = official_figures(pose, target, action)
    for name, figures in {**found.per_action, "all": found.overall}.items():
        assert (figures["pck14@150"], figures["auc14"]) == pytest.approx(expected[name]), name
    assert found.overall["pck14@150"] < found.overall["pck@150"]  # the root counts there, and is always right
    lines = found.table().splitlines()
    head = next(line for line in lines if line.startswith("per action"))
    assert head.split()[2:] == [
        "Stand/Walk",
        "Exercise",
        "Sit",
        "Reach/Crouch",
        "Floor",
        "Sports",
        "Misc",
        "Avg",
        "All",
    ]
    row = next(line for line in lines if line.startswith("auc14 ") and len(line.split()) == 10)
    means = [expected[name][1] for name in ACTIVITIES]
    assert row.split()[1:] == [f"{value:.3f}" for value in (*means, np.mean(means), expected["all"][1])]
    assert next(line for line in lines if line.startswith("frames ")).split()[1:] == [
        "40",
        "30",
        "25",
        "20",
        "10",
        "10",
        "5",
        "140",
    ]
    assert all(len(line) < 120 for line in lines)


def test_table_of_many_actions_says_where_the_rest_is():
    truth = some_truth()
    truth.identity["action"] = np.array([f"action number {place % 45}" for place in range(90)])
    table = evaluate(guess(truth), truth, HUMAN).table()
    assert "25 more actions" in table
    assert table.count("action number") == 20
    assert all(len(line) < 120 and line == line.rstrip() for line in table.splitlines())


def test_csv_holds_every_figure(tmp_path):
    truth = some_truth()
    found = evaluate(guess(truth), truth, HUMAN)
    found.write_csv(tmp_path / "evaluation.csv")
    with (tmp_path / "evaluation.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["protocol"]: float(row["value"]) for row in rows if row["group"] == "overall"} == found.overall
    joints = [row for row in rows if row["group"] == "joint" and row["name"] == "nose"]
    assert {row["protocol"]: float(row["value"]) for row in joints} == found.per_joint["nose"]
    assert next(row for row in rows if row["protocol"] == "p_mpjpe")["unit"] == "mm"


def test_every_figure_has_a_name_in_the_list_of_protocols():
    truth = some_truth()
    truth.confidence[:, 3] = 0
    found = evaluate(guess(truth, "mm", tilt_deg=truth.tilt_deg), truth, HUMAN)
    bases = {name.removesuffix("_action_mean").removesuffix("_missing").removesuffix("_clip") for name in found.overall}
    assert bases == set(PROTOCOLS) - {"coverage", "pck14@150", "auc14", "roll_deg"}


def read_truth(path: Path, skeleton: Skeleton) -> PoseData:
    with np.load(path, allow_pickle=False) as file:
        keys = ("subject", "action", "sequence", "camera", "frame")
        return PoseData(
            keypoints=file["keypoints"],
            confidence=np.ones(file["keypoints"].shape[:2], np.float32),
            joint_names=tuple(file["joint_names"]),
            pose=file["pose"],
            identity={key: file[key] for key in keys},
            tilt_deg=file["tilt_deg"],
        )


def test_real_motion_capture_has_the_known_floor(benchmark_data):
    truth = read_truth(benchmark_data("cmu/test.npz"), HUMAN)
    flat = flat_depth(truth.keypoints, truth.joint_names.index("hip"))
    found = evaluate(GivenPoses(flat, truth.joint_names), truth, HUMAN)
    assert found.overall["mpjpe_gt_scale"] == pytest.approx(135, abs=1)
    assert found.overall["p_mpjpe"] == pytest.approx(108, abs=1)
    itself = evaluate(GivenPoses(truth.pose, truth.joint_names, "mm"), truth, HUMAN)
    assert itself.overall["facing"] == 1
    assert itself.overall["p_mpjpe"] < 1e-2
    assert itself.overall["facing_sign"] == pytest.approx(0.975, abs=5e-4)
    assert itself.overall["mpjpe"] == itself.overall["mpjve"] == 0
    assert itself.overall["bone_cv"] < 0.02
    part = truth.select(np.arange(0, len(truth), 5))
    mirrored = evaluate(GivenPoses(metrics.flip_depth(part.pose), part.joint_names), part, HUMAN)
    assert mirrored.overall["p_mpjpe"] > 70
    assert mirrored.overall["p_mpjpe_reflect"] < 1e-2
    assert mirrored.overall["facing"] < 0.01
    assert mirrored.overall["facing_sign"] < 0.05


def test_every_metric_has_a_name_in_words() -> None:
    for names in (PROTOCOLS, SHAPE_METRICS):
        labels = [metric_label(name) for name in names]
        assert len(set(labels)) == len(labels) and not any("_" in label for label in labels)
    assert metric_label("p_mpjpe_action_mean") == "joint error, aligned, mean of action means"


def test_a_figure_comes_before_its_variants():
    names = ["p_mpjpe_missing", "n_mpjpe", "p_mpjpe_action_mean", "pck@150", "p_mpjpe", "mpjpe"]
    expected = ["mpjpe", "n_mpjpe", "p_mpjpe", "p_mpjpe_action_mean", "p_mpjpe_missing", "pck@150"]
    assert sorted(names, key=metric_order) == expected


def test_frames_of_actions_are_counted_and_the_truths_own_steadiness_is_told():
    truth = some_truth()
    found = evaluate(guess(truth), truth, HUMAN)
    assert found.action_frames == {"sit": 23, "walk": 67}  # every fourth of 90, from the first on
    start, end = HUMAN.bone_indices.T
    lengths = np.linalg.norm(truth.pose[:, end].astype(float) - truth.pose[:, start], axis=-1)
    of_subjects = [(rows.std(0) / rows.mean(0)).mean() for rows in np.split(lengths, 3)]
    told = next(note for note in found.notes if "bone_cv of the truth itself" in note)
    assert f"{np.mean(of_subjects):.4f}" in told
