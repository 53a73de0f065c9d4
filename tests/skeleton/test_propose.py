"""A skeleton out of a tracker's file: names, partners, bones by distance, and a YAML that is valid as written."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped

from uplift.cli.main import main
from uplift.config.files import shipped_names
from uplift.data.formats import read
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.draw import skeleton_layout
from uplift.skeleton.propose import apart, facing_guess, joining_bones, mirror_pairs, proposal_text, propose, seen_in

BY_NUMBER = ("face68", "coco_wholebody133")  # names that say no side


def tracked(skeleton: Skeleton, frames: int = 60, seed: int = 0) -> PoseData:
    """Return 2D of a body with bones of fixed length, each turned at random, its camera too."""
    rng = np.random.default_rng(seed)
    place = np.zeros((frames, len(skeleton.joints), 3))
    for joint, parent in skeleton.parents.items():
        if parent is not None:
            way = rng.normal(size=(frames, 3))
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            place[:, skeleton.index(joint)] = place[:, skeleton.index(parent)] + way
    keypoints = (place[..., :2] * rng.uniform(20, 60, (frames, 1, 1)) + 300).astype(np.float32)
    return PoseData(keypoints, np.ones(keypoints.shape[:2], np.float32), skeleton.joints)


def bones_of(skeleton: Skeleton) -> set[frozenset[str]]:
    return {frozenset(bone) for bone in skeleton.bones}


@pytest.mark.parametrize("name", shipped_names("skeletons"))
def test_partners_are_found_by_name(name):
    skeleton = load_skeleton(name)
    found = mirror_pairs(skeleton.joints)
    assert set(found) <= set(skeleton.mirror)
    if name not in BY_NUMBER:
        assert set(found) == set(skeleton.mirror)


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        ("paw1LH_top paw2LF_top paw3RF_top paw4RH_top nose_top", ["paw4RH_top paw1LH_top", "paw3RF_top paw2LF_top"]),
        ("snout leftear rightear tailbase", ["rightear leftear"]),
        ("lhip rhip hipl hipr", ["rhip lhip", "hipr hipl"]),
        ("leg_l_1 leg_r_1 leg_l_2 leg_r_2", ["leg_r_1 leg_l_1", "leg_r_2 leg_l_2"]),
        ("Left Eye|Right Eye|Nose", ["Right Eye Left Eye"]),
        ("tail ear pelvis thorax", []),
        ("ll lr rl rr", []),  # two possible partners each
        ("l1 r2 r3", []),
    ],
)
def test_names_of_trackers(names, pairs):
    found = mirror_pairs(names.split("|") if "|" in names else names.split())
    assert [" ".join(pair) for pair in found] == pairs


@given(st.lists(st.text("lrLRab_1", min_size=1, max_size=6), min_size=1, max_size=12, unique=True))
def test_partners_are_told_once_whatever_the_names(names):
    pairs = mirror_pairs(names)
    told = [name for pair in pairs for name in pair]
    assert len(set(told)) == len(told) and set(told) <= set(names)
    assert set(mirror_pairs(names[::-1])) == set(pairs)


@settings(max_examples=15, deadline=None)
@given(st.sampled_from(["h36m17", "rat23", "hand21", "fly13", "chair10"]), st.integers(0, 99), st.floats(0, 0.6))
def test_whatever_is_hidden_the_bones_join_all_joints_alike_on_both_sides(name, seed, hidden):
    skeleton = load_skeleton(name)
    data = tracked(skeleton, 12, seed)
    visible = np.random.default_rng(seed).random(data.confidence.shape) >= hidden
    score = apart(data.keypoints, visible, data.joint_names)
    pairs = mirror_pairs(data.joint_names)
    bones = joining_bones(score, data.joint_names, pairs)
    across = {one: other for pair in pairs for one, other in (pair, pair[::-1])}
    assert {frozenset(across.get(end, end) for end in bone) for bone in bones} == set(map(frozenset, bones))
    assert len(bones) == len(data.joint_names) - 1
    Skeleton.from_dict(
        {"joints": list(data.joint_names), "root": bones[0][0], "bones": [list(bone) for bone in bones]}
        | {"mirror": [list(pair) for pair in pairs]}
    )


@pytest.mark.parametrize("name", ["h36m17", "quadruped28", "fly13"])
def test_bones_of_fixed_length_are_found(name):
    skeleton = load_skeleton(name)
    found = propose(tracked(skeleton, 300), "x").skeleton
    assert len(bones_of(found) & bones_of(skeleton)) >= 0.9 * len(skeleton.bones)


@pytest.mark.parametrize(
    ("folder", "name", "least"),
    [("cmu", "h36m17", 16), ("quadruped", "quadruped28", 24), ("rat", "rat23", 17), ("hand", "hand21", 12)],
)
def test_bones_of_real_data_are_found(folder, name, least, benchmark_data):
    data = read(benchmark_data(f"{folder}/test.npz"))
    few = data.select(np.linspace(0, len(data) - 1, 200).astype(int))
    assert len(bones_of(propose(few, folder).skeleton) & bones_of(load_skeleton(name))) >= least


def test_the_size_of_the_picture_changes_nothing():
    data = tracked(load_skeleton("h36m17"))
    near = replace(data, keypoints=data.keypoints * np.linspace(0.2, 3, len(data))[:, None, None] + 50)
    assert propose(near, "x").skeleton == propose(data, "x").skeleton


def test_bones_and_partners_of_the_file_win():
    skeleton = load_skeleton("fly13")
    data = tracked(skeleton)
    odd = (("wingL", "eyeL"), ("wingR", "eyeR"), ("eyeL", "wingL"), ("head", "nobody"))
    found = propose(replace(data, bones=odd), "x")
    assert found.from_file == (("wingL", "eyeL"), ("wingR", "eyeR"))
    assert {frozenset(bone) for bone in odd[:2]} <= bones_of(found.skeleton)
    assert len(found.skeleton.bones) == 12 and not found.skeleton.loops
    ring = (("head", "thorax"), ("thorax", "abdomen"), ("abdomen", "head"))
    assert propose(replace(data, bones=ring), "x").skeleton.loops
    names = replace(data, joint_names=tuple(f"k{i}" for i in range(13)), mirror=(("k3", "k4"),))
    assert propose(names, "x").skeleton.mirror == (("k3", "k4"),)


def test_bones_that_are_not_the_same_on_both_sides_cost_the_partners():
    data = replace(tracked(load_skeleton("fly13")), joint_names=("m", "lh", "rh", *"xytpquvwzo"))
    data = replace(data, mirror=(("rh", "lh"),), bones=(("m", "lh"), ("m", "rh"), ("lh", "x"), ("rh", "y")))
    found = propose(data, "x")
    assert found.skeleton.mirror == () and found.unmirrored == (("rh", "lh"),)
    assert "left out: the bones above" in proposal_text(found, "x.yaml", "x.csv")


def test_the_root_is_central_seen_and_on_the_midline():
    skeleton = load_skeleton("h36m17")
    data = tracked(skeleton, 200)
    root = propose(data, "x").skeleton.root
    assert root in ("hip", "spine", "thorax")
    data.confidence[: len(data) // 2, skeleton.index(root)] = 0
    assert propose(data, "x").skeleton.root not in (root, *(joint for pair in skeleton.mirror for joint in pair))
    assert propose(data, "x", root="rknee").skeleton.root == "rknee"
    with pytest.raises(UserError, match=r"root=rkne: .*'rknee'"):
        propose(data, "x", root="rkne")


def test_where_every_joint_has_a_partner_the_root_is_made():
    found = propose(tracked(load_skeleton("chair10")), "x").skeleton
    assert found.root == "middle" and set(found.midpoints) == {"middle"}
    assert set(found.midpoints["middle"]) in [set(pair) for pair in found.mirror]
    assert not found.loops and len(found.bones) == 10
    paws = tracked(load_skeleton("chair10"), 40)
    paws = replace(paws, **_only(paws, 4) | {"joint_names": ("paw1LH", "paw2LF", "paw3RF", "paw4RH")})
    found = propose(paws, "x").skeleton
    assert len(found.bones) == 4 and not found.loops
    across = {one: other for pair in found.mirror for one, other in (pair, pair[::-1])}
    assert {frozenset(across.get(end, end) for end in bone) for bone in found.bones} == bones_of(found)


def test_where_no_joint_is_near_the_middle_the_root_is_made():
    """COCO: the nose is the one joint on the midline, and it is at the end of the body."""
    coco = load_skeleton("coco17")
    place = 100 * skeleton_layout(coco)[:17] + np.random.default_rng(0).normal(300, 5, (50, 17, 2))
    data = PoseData(place.astype(np.float32), np.ones((50, 17), np.float32), coco.joints[:17])
    found = propose(data, "x").skeleton
    assert set(found.midpoints[found.root]) in ({"left_hip", "right_hip"}, {"left_shoulder", "right_shoulder"})
    assert propose(data, "x", root="nose").skeleton.root == "nose"


def test_joints_never_seen_are_left_out():
    data = tracked(load_skeleton("h36m17"))
    data.confidence[:, 3] = 0
    data.keypoints[:, 6] = np.nan
    data.confidence[::3, 9] = 0
    data.confidence[1::3, 9] = 0
    found = propose(data, "x")
    assert found.hidden == ("rankle", "lankle") and found.seldom == ("nose",)
    assert "rankle" not in found.skeleton.joints
    text = proposal_text(found, "x.yaml", "x.csv")
    assert "# Left out, as no frame shows them: rankle, lankle" in text and "less than half of the frames: nose" in text


def test_joints_never_seen_together_still_make_one_skeleton():
    data = tracked(load_skeleton("h36m17"))
    data.confidence[::2, :8] = 0
    data.confidence[1::2, 8:] = 0
    assert len(propose(data, "x").skeleton.bones) == 16


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: replace(d, **_only(d, 2)), r"found 2 joints \(head, thorax\); a skeleton needs 3"),
        (lambda d: d.select(np.arange(0)), "no frames"),
        (lambda d: replace(d, confidence=d.confidence * 0), r"only 0 of 13 joints are visible in any of 60 frames"),
        (lambda d: replace(d, keypoints=d.keypoints * np.nan), "only 0 of 13"),
        (lambda d: replace(d, joint_names=("a b\n", *d.joint_names[1:])), "joint name 'a b"),
        (lambda d: replace(d, joint_names=("thorax", *d.joint_names[1:])), "joint 'thorax' 2 times"),
    ],
)
def test_what_makes_no_skeleton_is_refused(change, words):
    data = replace(tracked(load_skeleton("fly13")), source="fly.csv")
    with pytest.raises(UserError, match=words) as caught:
        propose(change(data), "x")
    assert str(caught.value).startswith("fly.csv: ")


def _only(data: PoseData, joints: int) -> dict:
    return {"keypoints": data.keypoints[:, :joints], "confidence": data.confidence[:, :joints],
            "joint_names": data.joint_names[:joints]}  # fmt: skip


def uncommented(text: str, key: str) -> str:
    """Return the text with the commented block of ``key`` taken in, as a user would."""
    return re.sub(
        rf"^# {key}:\n((?:#   .*\n)+)", lambda m: m[0].replace("# ", "", 1).replace("#   ", "  "), text, flags=re.M
    )


@pytest.mark.parametrize("gravity", [True, False])
@pytest.mark.parametrize("name", ["h36m17", "coco17", "quadruped28", "rat23", "fly32", "ap10k17", "hand21", "chair10"])
def test_the_text_is_valid_as_written_and_with_its_facing(name, gravity, tmp_path):
    found = propose(tracked(load_skeleton(name)), "mine", gravity=gravity)
    text = proposal_text(found, "mine.yaml", "mine.csv")
    assert max(map(len, text.splitlines())) <= 120
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    written = load_skeleton(file)
    assert (written.joints, written.root, written.mirror) == (
        found.skeleton.joints, found.skeleton.root, found.skeleton.mirror)  # fmt: skip
    assert bones_of(written) == bones_of(found.skeleton) and written.gravity is gravity and not written.facing
    guess = facing_guess(found.skeleton)
    if guess:
        file.write_text(uncommented(text, "facing"))
        assert load_skeleton(file).facing == guess


def test_the_guessed_directions_hold_in_true_poses(benchmark_data):
    for folder in ("cmu", "quadruped", "rat"):
        data = read(benchmark_data(f"{folder}/test.npz"))
        few = data.select(np.linspace(0, len(data) - 1, 400).astype(int))
        skeleton = propose(few, folder).skeleton
        skeleton = replace(skeleton, facing=facing_guess(skeleton))
        front, left = (skeleton.facing_matrix(name) @ few.pose.astype(float) for name in ("front", "left"))
        up = skeleton.facing_matrix("up") @ few.pose if "up" in skeleton.facing else np.array([0.0, -1.0, 0.0])
        assert ((np.cross(np.broadcast_to(up, front.shape), front) * left).sum(-1) > 0).mean() > 0.97, folder


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF), min_size=1, max_size=8).filter(
            lambda name: name == name.strip() and name.isprintable()
        ),
        min_size=3,
        max_size=8,
        unique=True,
    )
)
def test_any_names_make_a_file_that_is_read_again(tmp_path_factory, names):
    rng = np.random.default_rng(0)
    data = PoseData(
        rng.normal(100, 30, (5, len(names), 2)).astype(np.float32), np.ones((5, len(names)), np.float32), tuple(names)
    )
    file = tmp_path_factory.getbasetemp() / "names.yaml"
    file.write_text(proposal_text(propose(data, "on"), "names.yaml", "file.csv"))
    assert load_skeleton(file).joints[: len(names)] == tuple(names)


def test_the_command_writes_once_and_says_what_is_next(here, capsys):
    data = tracked(load_skeleton("fly13"))
    np.savez("fly.npz", keypoints=data.keypoints, joint_names=np.array(data.joint_names))
    assert main(["skeleton", "new", "fly.yaml", "--from", "fly.npz", "gravity=no", "root=thorax"]) == 0
    said = capsys.readouterr().out
    assert "13 joints, root thorax; 5 mirror pairs; bones: 0 from the file, 12 guessed by distance" in said
    assert "next: edit it, then uplift skeleton check fly.yaml" in said
    assert not load_skeleton("fly.yaml").gravity
    assert main(["skeleton", "check", "fly.yaml"]) == 0
    assert main(["skeleton", "new", "fly.yaml", "--from=fly.npz"]) == 2
    assert "is not overwritten" in capsys.readouterr().err
    assert main(["skeleton", "new", "other", "from=fly.npz"]) == 0
    for words, said in (
        (["--from"], "'from=' has no value"),
        (["--from", "none.npz"], "No file none.npz"),
        (["--from", "fly.npz", "gravity=maybe"], "expected one of yes, no"),
        (["root=thorax"], "goes with --from"),
        (["--from", "fly.npz", "rot=thorax"], "Did you mean 'root'"),
        (["--from", "fly.npz", "min_confidence=2"], "from 0 to 1"),
    ):
        assert main(["skeleton", "new", "third", *words]) == 2
        assert said in capsys.readouterr().err
    assert not (here / "third.yaml").exists()


def test_shapes_as_annotated():
    beartype = pytest.importorskip("beartype").beartype
    data = tracked(load_skeleton("fly13"), 5)
    visible = jaxtyped(typechecker=beartype)(seen_in)(data.keypoints, data.confidence)
    score = jaxtyped(typechecker=beartype)(apart)(data.keypoints, visible, data.joint_names)
    assert score.shape == (13, 13) and np.allclose(score, score.T)
