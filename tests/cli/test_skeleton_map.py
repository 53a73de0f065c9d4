"""skeleton map: what becomes of a file's joints is told before anything is lifted, and nothing is applied unseen."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from uplift.cli import skeleton as skeleton_map
from uplift.cli.main import main
from uplift.cli.skeleton import map_joints
from uplift.data.formats import read
from uplift.data.load import in_joints_of
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import load_skeleton
from uplift.skeleton.draw import skeleton_layout
from uplift.skeleton.match import match_joints
from uplift.skeleton.propose import guess_parts, seen_in, stretched

COCO = load_skeleton("coco17").joints[:17]


def people(names=COCO, frames=10, **more) -> PoseData:
    """Return a standing person by COCO's keypoints in order, or as many of them as there are names."""
    rng = np.random.default_rng(0)
    place = 100 * skeleton_layout(load_skeleton("coco17"))[: len(names)]
    keypoints = (place + rng.normal(300, 5, (frames, len(names), 2))).astype(np.float32)
    return PoseData(keypoints, np.full((frames, len(names)), 0.5, np.float32), tuple(names), **more)


@pytest.fixture
def told(monkeypatch):
    """Return a function from data and words to the text and the verdict."""

    def run(data: PoseData, *words: str) -> tuple[str, bool]:
        monkeypatch.setattr(skeleton_map, "read_files", lambda *_: ([data], []))
        lines, fits = map_joints(["file.json", *words])
        return "\n".join(lines), fits

    return run


def test_every_joint_says_what_it_is_made_of_and_how_often_it_is_seen(told):
    data = people()
    data.confidence[:4, COCO.index("left_hip")] = 0
    data.keypoints[4, COCO.index("left_hip")] = np.nan
    text, fits = told(data, "skeleton=h36m17")
    assert fits
    assert "file.json: 10 frames, 17 joints" in text
    assert "h36m17, by its layout 'coco17':" in text
    rows = {line.split()[0]: " ".join(line.split()[2:]) for line in text.splitlines() if " <- " in line}
    assert list(rows) == list(load_skeleton("h36m17").joints)
    assert rows["rknee"] == "right_knee seen in 100.0% of frames, confidence 0.50"
    assert rows["lhip"] == "left_hip seen in 50.0% of frames, confidence 0.50"
    assert rows["hip"] == "mean of left_hip, right_hip seen in 50.0% of frames, confidence 0.50"
    assert rows["headtop"] == "MISSING"
    assert "unused: left_eye, right_eye, left_ear, right_ear" in text
    assert "it can be lifted: 10 of 10 frames show 3 joints or more; hidden in all of them, so guessed: headtop" in text


def test_midpoints_are_told_as_means(told):
    text, fits = told(people(), "skeleton=coco17")
    assert fits and "coco17, by name:" in text
    assert re.search(r"pelvis +<- mean of left_hip, right_hip", text) and "unused" not in text


def test_individuals_categories_and_notes_are_told(told):
    data = people(identity={"instance": np.arange(10) % 3, "category": np.array(["cow", "dog"] * 5)})
    data = replace(data, notes=("read as COCO (guessed; format=coco)",))
    text, _ = told(data, "skeleton=coco17")
    assert "10 frames of 3 individuals (cow, dog), 17 joints" in text
    assert "  read as COCO (guessed; format=coco)" in text


def test_what_is_mostly_hidden_is_advised_against(told):
    text, fits = told(people(), "skeleton=coco_wholebody133")
    assert fits and "hidden in all of them, so guessed: 116 of 135 joints" in text
    assert "A skeleton with fewer joints suits this file better" in text


def test_joints_with_the_names_of_others_are_noticed(told):
    """As many keypoints as a layout has, in another order: OpenPose's BODY_25 and BODY_25B."""
    body_25, body_25b = load_skeleton("openpose25"), load_skeleton("openpose25b")
    place = 100 * skeleton_layout(body_25b)[:25] + np.random.default_rng(0).normal(300, 5, (10, 25, 2))
    data = PoseData(place.astype(np.float32), np.ones((10, 25), np.float32), body_25.joints)
    for skeleton in ("openpose25", "h36m17", "coco17", "mpii16"):
        text, fits = told(data, f"skeleton={skeleton}")
        assert not fits and re.search(r"it should not be lifted: its bones are [2-6]\.\d times as long", text)
        assert "In their order they look like layout=openpose25b. layout= has no effect here, as the file n" in text
    text, fits = told(replace(data, joint_names=body_25b.joints[:25]), "skeleton=h36m17")
    assert fits and "it can be lifted" in text


@pytest.mark.parametrize(
    ("file", "name"),
    [("cmu/test.npz", "h36m17"), ("quadruped/test.npz", "quadruped28"), ("rat/test.npz", "rat23"),
     ("hand/test.npz", "hand21"), ("chair/test.npz", "chair10"), ("mpii/mpii.npz", "mpii16")],
)  # fmt: skip
def test_real_bodies_by_their_names_are_not_stretched(file, name, benchmark_data):
    skeleton = load_skeleton(name)
    data = read(benchmark_data(file))
    data = in_joints_of(data.select(np.linspace(0, len(data) - 1, 300).astype(int)), skeleton)
    visible = seen_in(data.keypoints, data.confidence)
    bones = skeleton.bone_indices.tolist()
    assert 1 <= stretched(data.keypoints, visible, bones) < 1.6
    if len(skeleton.joints) > 12:  # few joints are near each other in any order
        for seed in range(5):
            order = np.random.default_rng(seed).permutation(len(skeleton.joints))
            assert stretched(data.keypoints[:, order], visible, bones) > 1.9


def test_a_file_that_shows_nothing_cannot_be_lifted(told):
    data = people()
    text, fits = told(replace(data, confidence=data.confidence * 0), "skeleton=coco17")
    assert not fits and "it cannot be lifted: " in text and "no keypoint in 10 frames is visible" in text
    assert re.search(r"nose +<- nose +seen in +0.0% of frames$", text, re.M)


def test_other_names_get_guesses_to_paste_and_none_is_applied(told, tmp_path):
    names = ["Left Hip", "R.Hip", "Mid-Hip", "LeftKnee", "RightKnee", "leftAnkle", "rightAnkle", "Neck", "Snout"]
    text, fits = told(people(names), "skeleton=h36m17")
    assert not fits
    assert "it cannot be lifted as h36m17: the joints do not fit skeleton 'h36m17'" in text
    assert "Guesses by name; nothing of it is applied" in text
    block = text[text.index("# from:") :].replace("# ", "", 1).replace("\n# ", "\n")
    found = yaml.safe_load(block)["from"]["my_tracker"]
    assert found["lknee"] == "LeftKnee" and found["rankle"] == "rightAnkle" and found["hip"] == "Mid-Hip"
    assert found["thorax"] == "Neck" and found["nose"] == "Snout"
    assert "lelbow" not in found and "# lelbow: nothing is alike" in text
    plain = load_skeleton("h36m17").to_dict()
    with pytest.raises(UserError):
        match_joints(names, load_skeleton("h36m17"))
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(plain | {"from": {"my_tracker": found}}))
    assert match_joints(names, load_skeleton(file)).layout == "my_tracker"


def test_shipped_skeletons_that_fit_are_named(told):
    text, fits = told(people(), "skeleton=openpose25")
    assert fits
    text, fits = told(people(), "skeleton=rat23")
    assert not fits
    line = next(line for line in text.splitlines() if line.startswith("shipped skeletons that fit"))
    assert {"coco17", "h36m17", "halpe26", "openpose25"} <= set(line.split(": ")[1].split(", "))
    assert "coco_wholebody133" not in line and "rat23" not in line.split(": ")[1]


def test_nothing_alike_says_what_else_to_try(told):
    text, fits = told(people(["0", "1", "2", "3"]), "skeleton=rat23")
    assert not fits and "no names are alike" in text and "layout=SKELETON" in text


@pytest.mark.parametrize(
    ("name", "theirs", "expected"),
    [
        ("rat23", "snout leftear rightear tailbase", {"Snout": "snout", "EarL": "leftear", "EarR": "rightear"}),
        ("coco17", "Nose LEye REye MidHip", {"left_eye": "LEye", "right_eye": "REye", "pelvis": "MidHip"}),
        ("h36m17", "l_wrist r_wrist lwrist_2", {"lwrist": "l_wrist", "rwrist": "r_wrist"}),
        ("ap10k17", "tail_base tail_tip", {"root_of_tail": "tail_base"}),
    ],
)
def test_guesses_by_what_words_mean(name, theirs, expected):
    found = guess_parts(load_skeleton(name), theirs.split())
    assert {joint: found[joint] for joint in expected} == {joint: (name,) for joint, name in expected.items()}


def test_guesses_keep_to_their_side():
    for joint, parts in guess_parts(load_skeleton("h36m17"), ["leftknee", "rightknee", "leftelbow"]).items():
        assert len(parts) == 1 and joint[0] == parts[0][0]


def test_the_command_ends_with_the_verdict(here, capsys):
    data = people()
    np.savez("coco.npz", keypoints=data.keypoints, confidence=data.confidence, joint_names=np.array(COCO))
    assert main(["skeleton", "map", "coco.npz", "skeleton=h36m17"]) == 0
    assert "it can be lifted" in capsys.readouterr().out
    assert main(["skeleton", "map", "coco.npz", "skeleton=hand21"]) == 2
    assert "it cannot be lifted as hand21" in capsys.readouterr().out
    assert main(["skeleton", "map", "coco.npz", "skeleton=coco17", "min_confidence=0.6"]) == 2
    assert "0.0% of frames" in capsys.readouterr().out
    for words, said in (
        ([], "takes a FILE or FOLDER"),
        (["coco.npz"], "needs skeleton="),
        (["none.npz", "skeleton=coco17"], "No file none.npz"),
        (["coco.npz", "skeleton=coco18"], "Did you mean 'coco17'"),
        (["coco.npz", "skeleton=coco17", "formt=npz"], "Did you mean 'format'"),
        (["coco.npz", "skeleton=coco17", "format=npx"], "format=npx"),
    ):
        assert main(["skeleton", "map", *words]) == 2
        assert said in capsys.readouterr().err


def test_a_file_with_an_equals_sign_in_its_name_is_a_file(here, capsys):
    data = people()
    np.savez("run.rng=0.npz", keypoints=data.keypoints, joint_names=np.array(COCO))
    assert main(["skeleton", "map", "run.rng=0.npz", "skeleton=coco17"]) == 0


def write_csv(file: str, names, frames: int, scale: float = 1.0) -> None:
    """Write the person with the joints in the order of ``names``, as a plain table."""
    data = people(frames=frames)
    places = [COCO.index(name) for name in names]
    header = ",".join(f"{name}_{what}" for name in names for what in "xy")
    np.savetxt(file, data.keypoints[:, places].reshape(frames, -1) * scale, delimiter=",", header=header, comments="")


@pytest.mark.parametrize("words", [["*.csv"], ["a.csv,b.csv"], ["a.csv", "b.csv"]], ids=["pattern", "commas", "shell"])
def test_several_files_are_one_table_whatever_the_order_of_their_columns(here, capsys, words):
    write_csv("a.csv", COCO, 10)
    write_csv("b.csv", COCO[::-1], 20)
    assert main(["skeleton", "map", *words, "skeleton=coco17"]) == 0
    told = capsys.readouterr().out
    assert f"{','.join(words)}: 30 frames, 17 joints" in told and "30 of 30 frames" in told
    assert main(["skeleton", "new", "mine.yaml", "--from", *words]) == 0
    assert yaml.safe_load(Path("mine.yaml").read_text())["joints"][:17] == list(COCO)


def test_files_of_other_joints_are_told_one_by_one(here, capsys):
    write_csv("a.csv", COCO, 10)
    write_csv("b.csv", COCO[:9], 20)
    assert main(["skeleton", "map", "*.csv", "skeleton=coco17"]) == 2
    told = capsys.readouterr().out
    assert "a.csv: 10 frames, 17 joints" in told and "b.csv: 20 frames, 9 joints" in told
    assert main(["skeleton", "new", "mine.yaml", "--from", "*.csv"]) == 2
    assert "the files have different joints" in capsys.readouterr().err and not Path("mine.yaml").exists()


def test_shares_of_the_image_need_its_size(here, capsys):
    write_csv("a.csv", COCO, 10, 0.001)
    assert main(["skeleton", "map", "a.csv", "skeleton=coco17"]) == 2
    assert "image_size=" in capsys.readouterr().err
    assert main(["skeleton", "map", "a.csv", "skeleton=coco17", "image_size=1000x1000"]) == 0
    assert main(["skeleton", "new", "mine.yaml", "--from", "a.csv", "image_size=1000x1000"]) == 0
