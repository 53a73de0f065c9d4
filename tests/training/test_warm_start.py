"""A fit that starts from a trained lifter (init=): its network, and its weights by the names of joints."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from bodies import QUICK, body_arrays, refusal, status_of, write_body

import uplift
from uplift.config.loading import load_settings
from uplift.config.settings import LifterSettings
from uplift.models.lifter import Lifter
from uplift.models.transfer import copy_weights
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import shared_joints

SMALL = tuple(word for word in QUICK if not word.startswith(("lifter.options", "priors.critic")))
READY = (
    *SMALL, "student.options.units=16", "student.last_options.units=24", "student.options.blocks=2", "lifter.signs=12",
    "trainer.max_steps=6",
)  # fmt: skip
STUDENT = LifterSettings(options={"units": 20, "blocks": 2, "norm": True}, signs=16, cameras="any")


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of the default recipe in short."""
    folder = tmp_path_factory.mktemp("ready")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_body(folder / "a.npz")
        assert status_of("fit", "skeleton=h36m17", "data.train=a.npz", *READY) == 0
    return (folder / "runs/h36m17/last").resolve()


def renamed(skeleton: Skeleton, order: list[int], leave_out: tuple[str, ...] = ()) -> Skeleton:
    """Return the skeleton with joints in another order and written with capitals, some of them left out."""
    plain = skeleton.to_dict()
    kept = [skeleton.joints[place] for place in order if skeleton.joints[place] not in leave_out]
    plain |= {"name": "other", "joints": kept, "from": {}, "midpoints": {}, "facing": {}, "trunk": None}
    plain["bones"] = [bone for bone in plain["bones"] if set(bone) <= set(kept)]
    plain["mirror"] = [pair for pair in plain["mirror"] if set(pair) <= set(kept)]
    plain = {key: plain[key] for key in ("name", "joints", "root", "bones", "mirror", "gravity")}
    return Skeleton.from_dict(yaml.safe_load(_upper(yaml.safe_dump(plain), kept)))


def _upper(text: str, names: list[str]) -> str:
    words = set(names)
    return "\n".join(
        " ".join(word.upper() if word.strip() in words else word for word in line.split(" "))
        for line in text.split("\n")
    )


def body(joints: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(seed)
    keypoints = torch.randn(7, joints, 2, generator=random)
    return keypoints, torch.ones(7, joints), 8 + 4 * torch.rand(7, generator=random)


def lifter(skeleton: Skeleton, settings: LifterSettings = STUDENT, seed: int = 0) -> Lifter:
    torch.manual_seed(seed)
    made = Lifter(skeleton, settings)
    for weight in made.parameters():
        torch.nn.init.normal_(weight, std=0.2)
    return made.eval()


def test_joints_in_another_order_lift_alike() -> None:
    """The same body, its joints shuffled and written otherwise: every output is the same, joint by joint."""
    skeleton = load_skeleton("h36m17")
    order = np.random.default_rng(0).permutation(17).tolist()
    given, into = lifter(skeleton), lifter(renamed(skeleton, order), seed=1)
    shared = copy_weights(into, given)
    assert len(shared) == 17
    keypoints, confidence, distance = body(17)
    keypoints = keypoints - keypoints[:, [skeleton.root_index]]
    confidence[:, [3, 12]] = 0
    guessed = torch.arange(7) % 2 == 0
    expected, found = (
        given(keypoints, confidence, distance, guessed),
        into(keypoints[:, order], confidence[:, order], distance, guessed),
    )
    for name in ("pose", "keypoints", "uncertainty"):
        assert torch.allclose(getattr(found, name), getattr(expected, name)[:, order], atol=1e-5), name
    assert torch.allclose(found.gravity, expected.gravity, atol=1e-5)
    assert torch.allclose(found.distance, expected.distance, atol=1e-5)


def test_missing_joints_and_another_root_are_as_joints_that_are_not_seen() -> None:
    """Without four joints and about the thorax, a body lifts as the whole one does with those joints hidden."""
    skeleton = load_skeleton("h36m17")
    without = ("rwrist", "lwrist", "rankle", "lankle")
    other = Skeleton.from_dict(renamed(skeleton, list(range(17)), without).to_dict() | {"root": "THORAX"})
    places = [skeleton.joints.index(joint.lower()) for joint in other.joints]
    given, into = lifter(skeleton), lifter(other, seed=1)
    assert set(copy_weights(into, given)) == set(other.joints)
    keypoints, confidence, distance = body(17)
    keypoints = keypoints - keypoints[:, [skeleton.root_index]]
    hidden = confidence.clone()
    hidden[:, [skeleton.joints.index(joint) for joint in without]] = 0
    expected = given(keypoints, hidden, distance)
    about = keypoints - keypoints[:, [skeleton.joints.index("thorax")]]
    found = into(about[:, places], confidence[:, places], distance)
    depth = expected.pose[:, places, 2]
    depth = depth - depth[:, [other.root_index]]
    assert torch.allclose(found.pose[..., 2], depth, atol=1e-4)
    assert given.knows_signs
    assert not into.knows_signs  # its limbs are other chains of bones: no signs rather than wrong ones
    uncertainty = expected.uncertainty[:, places]
    of_both = (uncertainty > 0) & (found.uncertainty > 0)  # the root has none
    assert torch.allclose(found.uncertainty[of_both], uncertainty[of_both], rtol=1e-4)


def test_depth_signs_follow_their_bones() -> None:
    skeleton = load_skeleton("h36m17")
    given, into = lifter(skeleton), lifter(renamed(skeleton, list(range(17))[::-1]), seed=1)
    copy_weights(into, given)
    keypoints, confidence, distance = body(17)
    order = list(range(17))[::-1]
    expected = given(keypoints, confidence, distance).signs
    found = into(keypoints[:, order], confidence[:, order], distance).signs
    named = [
        {
            tuple(one.skeleton.joints[joint].lower() for bone in chain for joint in bone): part
            for chain, part in zip(one.chains.chains, signs.split(one.chains.counts, 1), strict=True)
        }
        for one, signs in ((given, expected), (into, found))
    ]
    common = named[0].keys() & named[1].keys()
    assert len(common) >= 5
    assert all(torch.allclose(named[0][chain], named[1][chain], atol=1e-5) for chain in common)


def test_outputs_that_the_given_lifter_lacks_stay_as_they_were() -> None:
    skeleton = load_skeleton("h36m17")
    teacher = lifter(skeleton, LifterSettings(options=STUDENT.options, uncertainty=False, signs=0))
    into, fresh = lifter(skeleton, seed=1), lifter(skeleton, seed=1)
    copy_weights(into, teacher)
    keypoints, confidence, _ = body(17)
    distance = torch.full((7,), 10.0)
    depth = [one(keypoints, confidence, distance).pose[..., 2] for one in (into, teacher)]
    assert torch.allclose(*depth, atol=1e-5)
    new = [number for number, (what, _) in enumerate(into.output_names()) if what in ("uncertainty", "gravity x")]
    assert torch.equal(into.network.leave.weight[new], fresh.network.leave.weight[new])
    assert torch.equal(into.signs.leave.weight, fresh.signs.leave.weight)


def test_joints_in_common_are_found_by_name_and_by_layout() -> None:
    quadruped, ap10k = load_skeleton("quadruped28"), load_skeleton("ap10k17")
    shared = shared_joints(ap10k, quadruped)
    assert len(shared) == 13
    assert shared["left_knee"] == ("L_stifle",)
    assert "left_eye" not in shared
    back = shared_joints(quadruped, ap10k)  # by the same `from:`, read the other way
    assert back["L_stifle"] == ("left_knee",)
    assert len(back) == 13
    hip = shared_joints(load_skeleton("h36m17"), load_skeleton("coco17"))["hip"]
    assert set(hip) == {"left_hip", "right_hip"}
    assert shared_joints(load_skeleton("hand21"), quadruped) == {}


@pytest.mark.parametrize(("written", "meant"), [("person", "person"), ("runs/x", "{}/runs/x"), ("x.pt", "{}/x.pt")])
def test_a_name_is_that_of_a_ready_lifter(written: str, meant: str, here: Path) -> None:
    settings = load_settings(None, ["skeleton=h36m17", "data.train=a.npz", f"init={written}"])
    assert settings.init == meant.format(here)


def the_run(folder: Path, name: str = "h36m17") -> Path:
    return (folder / "runs" / name / "last").resolve()


def test_a_fit_of_no_steps_lifts_as_the_given_lifter(ready: Path, here: Path) -> None:
    write_body(here / "b.npz", seed=1)
    still = ("teacher.learning_rate=1e-12", "student.learning_rate=1e-12", "trainer.max_steps=4")
    assert status_of("fit", "skeleton=h36m17", "data.train=b.npz", *SMALL, *still, f"init={ready}") == 0
    run = the_run(here)
    one, other = uplift.load(ready), uplift.load(run)
    assert other.settings.options == one.settings.options
    assert other.settings.options["units"] == 24
    assert other.settings.signs == 12
    keypoints = body_arrays(seed=2)["keypoints"]
    assert np.allclose(one(keypoints), other(keypoints), rtol=1e-4, atol=1e-3)
    config, facts = yaml.safe_load((run / "config.yaml").read_text()), json.loads((run / "run.json").read_text())
    assert config["init"] == facts["init"]["lifter"] == str(ready / "lifter.pt")
    assert "units: 24" in facts["init"]["notes"][0] or len(facts["init"]["notes"]) == 2
    assert "init: the weights of" in (run / "report.md").read_text()


def test_a_fit_that_starts_from_the_last_run_resumes_bit_for_bit(
    ready: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit that ends after its teacher goes on without the lifter that it started from."""
    weights = []
    for name in ("whole", "broken"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        write_body(Path("b.npz"), seed=1)
        shutil.copytree(ready, "runs/h36m17/first")
        Path("runs/h36m17/last").symlink_to("first")
        words = ["skeleton=h36m17", "data.train=b.npz", *SMALL, "init=runs/h36m17/last", "student.rounds=1,1"]
        assert status_of("fit", *words) == 0
        run = the_run(tmp_path / name)
        if name == "broken":
            for gone in (run / "lifter.pt", run / "checkpoints/student_1.ckpt", run / "checkpoints/student_2.ckpt"):
                gone.unlink()
            shutil.rmtree("runs/h36m17/first")
            assert status_of("fit", f"resume={run}") == 0
            assert "init: the weights of" in (run / "report.md").read_text()
        weights.append(torch.load(run / "lifter.pt", weights_only=True)["state"])
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])


def test_a_users_own_skeleton_starts_from_the_joints_that_it_shares(ready: Path, here: Path, capsys) -> None:
    own = renamed(load_skeleton("h36m17"), list(range(17)), ("rwrist", "lwrist", "headtop")).to_dict()
    own["joints"].append("tail")
    own["bones"].append(["HIP", "tail"])
    Path("own.yaml").write_text(yaml.safe_dump({key: own[key] for key in ("joints", "root", "bones", "mirror")}))
    arrays = body_arrays(seed=1)
    names = [str(name).upper() for name in arrays["joint_names"]]
    arrays |= {"joint_names": np.array(["tail" if name == "HEADTOP" else name for name in names])}
    arrays = {key: value for key, value in arrays.items() if key not in ("pose", "root", "tilt_deg")}
    np.savez("own.npz", **arrays)
    assert status_of("fit", "skeleton=own.yaml", "data.train=own.npz", *SMALL, f"init={ready}") == 0
    assert "which has 14 of the 15 joints; new to it: tail" in capsys.readouterr().out
    assert len(uplift.load(the_run(here, "own")).skeleton.joints) == 15


def test_what_cannot_be_a_start_is_refused_in_a_line(ready: Path, here: Path, capsys) -> None:
    write_body(here / "a.npz")
    write_body(here / "hand.npz", skeleton="hand21")
    fit = ["fit", "skeleton=h36m17", "data.train=a.npz", *SMALL]
    message = refusal(capsys, *fit[:1], "skeleton=hand21", "data.train=hand.npz", *SMALL, f"init={ready}")
    assert "trained on skeleton 'h36m17' (17 joints: hip, rhip" in message
    assert "'hand21' (21 joints: wrist" in message
    assert "of these it has none" in message
    assert "init=" in refusal(capsys, *fit, f"init={ready}", "lifter.options.units=99")
    assert "No run" in refusal(capsys, *fit, "init=runs/none")
    assert not list(here.glob("runs/*/2*"))
