"""Every wrong input ends with one clear error and status 2, and nothing hostile runs."""

from __future__ import annotations

import io
import pickle
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import QUICK, body_arrays, own_data, refusal, status_of, write_body

IDENTITY = ("subject", "action", "sequence", "camera", "frame")
HANDS = body_arrays(60, skeleton="hand21")


class Payload:
    """Pickles to code that makes a file."""

    def __init__(self, path: Path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a finished run of h36m17."""
    folder = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert status_of("fit", *own_data(folder / "good.npz"), "trainer.max_steps=4") == 0
    return (folder / "runs/h36m17/last").resolve()


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained, tmp_path / "run"))


def header_of_3_gb() -> bytes:
    stream = io.BytesIO()
    shape = (3_000_000_000 // (17 * 2 * 4), 17, 2)
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return stream.getvalue() + bytes(2000)


def truncated(path: Path) -> None:
    write_body(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def huge(path: Path) -> None:
    write_body(path, keypoints=None)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("keypoints.npy", header_of_3_gb())


def pickled(path: Path) -> None:
    trap = np.empty((), object)
    trap[()] = Payload(path.with_name("marker"))
    write_body(path, keypoints=trap)


def bare_pickle(path: Path) -> None:
    path.write_bytes(pickle.dumps(Payload(path.with_name("marker"))))


# What is wrong, how it is made, and what every command that reads the file says.
FILES = {
    "other joints": (lambda p: write_body(p, **{k: HANDS[k] for k in ("keypoints", "joint_names", "pose")}), "joint"),
    "few joints": (
        lambda p: write_body(p, joint_names=np.array(["hip", *"abcdefghijklmnop"])),
        "joint",
    ),
    "a joint twice": (
        lambda p: write_body(p, joint_names=np.array(["hip", *body_arrays()["joint_names"][:16]])),
        "hip",
    ),
    "all pixels equal": (lambda p: write_body(p, keypoints=np.full((60, 17, 2), 7.0)), "all joints in one point"),
    "all nan": (lambda p: write_body(p, keypoints=np.full((60, 17, 2), np.nan)), "no keypoint in 60 frames is visible"),
    "all missing": (lambda p: write_body(p, confidence=np.zeros((60, 17))), "no keypoint in 60 frames is visible"),
    "no frames": (
        lambda p: write_body(p, **{k: v[:0] for k, v in body_arrays().items() if np.ndim(v) and len(v) == 60}),
        "no frames",
    ),
    "empty": (lambda p: p.write_bytes(b""), "is empty (0 bytes)"),
    "truncated": (truncated, "truncated"),
    "text": (lambda p: p.write_text("frame,x,y\n"), "truncated, or another format"),
    "pickled": (pickled, "pickled Python objects"),
    "bare pickle": (bare_pickle, "another format"),
    "lengths": (lambda p: write_body(p, subject=np.array(["S1"] * 59)), "'subject' has shape (59,), expected (60,)"),
    "pose lengths": (lambda p: write_body(p, pose=np.zeros((59, 17, 3))), "'pose' is float64 of shape (59, 17, 3)"),
    "strings": (
        lambda p: write_body(p, keypoints=np.full((60, 17, 2), "1.5")),
        "'keypoints' is <U3 of shape (60, 17, 2), expected numbers",
    ),
    "3 GB": (huge, "claims 2,999,999,928 bytes but holds 2,000"),
    "folder": (lambda p: p.mkdir(), "is an empty folder"),
    "nothing": (lambda p: None, "a.npz"),
    "csv": (None, "is not in a known format"),
}


@pytest.mark.parametrize("verb", ["fit", "predict", "evaluate"])
@pytest.mark.parametrize("kind", FILES)
def test_a_wrong_data_file(kind: str, verb: str, here: Path, run: Path, capsys: pytest.CaptureFixture) -> None:
    make, says = FILES[kind]
    path = here / ("a.npz" if make else "a.csv")
    make(path) if make else path.write_text("1,2\n")
    words = {
        "fit": ["fit", "skeleton=h36m17", f"data.train={path}", *QUICK],
        "predict": ["predict", f"run={run}", f"input={path}", "output=out.npz"],
        "evaluate": ["evaluate", f"run={run}", f"data.test={path}"],
    }[verb]
    before = sorted(run.rglob("*"))
    message = refusal(capsys, *words)
    assert says in message
    assert path.name in message
    assert not (here / "marker").exists()
    assert not (here / "out.npz").exists()
    assert not (here / "runs").exists()
    assert sorted(run.rglob("*")) == before


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pose": None}, "no array 'pose'"),
        ({"joint_names": None}, "no array 'joint_names'"),
        ({"pose": np.zeros((59, 17, 3))}, "expected numbers of shape (59,)"),
        ({"pose": np.zeros((59, 17, 3)), **dict.fromkeys(("tilt_deg", *IDENTITY))}, "'pose' has shape (59, 17, 3)"),
        ({"pose": np.zeros((60, 17, 2))}, "'pose' is float64 of shape (60, 17, 2)"),
        ({"pose": np.full((60, 17, 3), "x")}, "'pose' is <U1"),
        ({"pose": np.full((60, 17, 3), np.nan)}, "nothing to compare"),
        ({"joint_names": np.array("hip")}, "'joint_names'"),
        ({"joint_names": np.arange(17)}, "'joint_names'"),
        ({"joint_names": np.array(list("abcdefghijklmnopq"))}, "no shipped skeleton has its joints"),
        ({"unit": np.array("cm")}, "'unit' is 'cm'"),
        ({"tilt_deg": np.zeros(3)}, "'tilt_deg' is float64 of shape (3,)"),
        ({"tilt_deg": np.array(["x"] * 60)}, "'tilt_deg'"),
        ({"hypotheses": np.zeros((60, 5, 17, 3))}, "'hypotheses' without 'weights'"),
        ({"hypotheses": np.zeros((60, 17, 3)), "weights": np.ones((60, 1))}, "'hypotheses' has shape (60, 17, 3)"),
        (
            {"hypotheses": np.zeros((60, 2, 17, 3)), "weights": np.ones((60, 2))},
            "'weights' of row 0 are 1, 1, expected",
        ),
        ({"subject": np.array(["S9"] * 60)}, "'subject' is not that of"),
        ({"sequence": np.array(["a"] * 59)}, "'sequence' has shape (59,)"),
        ({"frame": np.arange(60)[::-1]}, "'frame' is not that of"),
    ],
)
def test_wrong_poses(changes: dict, says: str, here: Path, capsys: pytest.CaptureFixture) -> None:
    write_body(here / "truth.npz")
    write_body(here / "poses.npz", **changes)
    assert says in refusal(capsys, "evaluate", "poses=poses.npz", "data.test=truth.npz")


def test_poses_without_truth_and_wrong_files(here: Path, run: Path, capsys: pytest.CaptureFixture) -> None:
    write_body(here / "poses.npz")
    write_body(here / "bare.npz", pose=None)
    assert "holds no 'pose'" in refusal(capsys, "evaluate", "poses=poses.npz", "data.test=bare.npz")
    assert "holds no 'pose'" in refusal(capsys, "evaluate", f"run={run}", "data.test=bare.npz")
    assert "has no test frames: give data.test=FILE" in refusal(capsys, "evaluate", f"run={run}")
    pickled(here / "trap.npz")
    pose = {"pose": np.load("trap.npz", allow_pickle=False)["root"], "joint_names": np.array(["hip"])}
    assert pose["pose"].shape == (60, 3)
    trap = np.empty((), object)
    trap[()] = Payload(here / "marker")
    write_body(here / "trap.npz", pose=trap)
    assert "pickled Python objects" in refusal(capsys, "evaluate", "poses=trap.npz", "data.test=poses.npz")
    assert not (here / "marker").exists()
    status = status_of("evaluate", "poses=poses.npz", "data.test=poses.npz")
    assert status == 0


def whole(run: Path) -> dict:
    return torch.load(run / "lifter.pt", weights_only=True)


def write_hostile(run: Path) -> None:
    torch.save({**whole(run), "extra": Payload(run / "marker")}, run / "lifter.pt")


def write_bare_hostile(run: Path) -> None:
    (run / "lifter.pt").write_bytes(pickle.dumps(Payload(run / "marker")))


def write_changed(run: Path, **changes) -> None:
    torch.save({**whole(run), **changes}, run / "lifter.pt")


def write_other_network(run: Path, **changes) -> None:
    write_changed(run, lifter={**whole(run)["lifter"], **changes})


# How a lifter.pt is made wrong, and what is said about it.
LIFTERS = {
    "hostile": (write_hostile, "holding more than tensors and plain data"),
    "hostile and bare": (write_bare_hostile, "holding more than tensors and plain data"),
    "empty": (lambda r: (r / "lifter.pt").write_bytes(b""), "cannot be read as a lifter"),
    "truncated": (
        lambda r: (r / "lifter.pt").write_bytes((r / "lifter.pt").read_bytes()[:3000]),
        "cannot be read as a lifter",
    ),
    "text": (lambda r: (r / "lifter.pt").write_text("hello"), "cannot be read as a lifter"),
    "a tensor": (lambda r: torch.save(torch.ones(3), r / "lifter.pt"), "found Tensor"),
    "another format": (lambda r: write_changed(r, uplift_format=99), "uplift_format is 99"),
    "no state": (lambda r: write_changed(r, state=None), "is not a valid lifter"),
    "state of text": (lambda r: write_changed(r, state={"a": "b"}), "is not a valid lifter"),
    "no skeleton": (lambda r: write_changed(r, skeleton=None), "lifter.pt"),
    "odd skeleton": (lambda r: write_changed(r, skeleton={"joints": 3}), "lifter.pt"),
    "other weights": (
        lambda r: write_changed(r, state={k: v[:1] for k, v in whole(r)["state"].items()}),
        "not a valid lifter",
    ),
    "odd settings": (lambda r: write_changed(r, lifter={"colour": "red"}), "is not a valid lifter"),
    "settings of a wrong type": (lambda r: write_other_network(r, options=3), "lifter.pt"),
    "a size of text": (lambda r: write_other_network(r, options={"units": "many"}), "units"),
    "an unknown network": (lambda r: write_other_network(r, network="nothing"), "nothing"),
    "a network that is none": (
        lambda r: write_other_network(r, network="subprocess:Popen", options={}),
        "runs only with your consent",
    ),
    "a list for a number": (
        lambda r: write_other_network(r, refine={"iterations": [1]}),
        "iterations",
    ),
    "a number out of range": (lambda r: write_other_network(r, camera_noise=-1), "lifter.pt"),
    "weights that are not finite": (
        lambda r: write_changed(
            r, state={k: v * float("nan") if v.dim() == 2 else v for k, v in whole(r)["state"].items()}
        ),
        "weights that are not finite",
    ),
    "a camera that is none": (lambda r: write_other_network(r, camera="pinhole"), "pinhole"),
}


@pytest.mark.parametrize("kind", LIFTERS)
def test_a_wrong_lifter(kind: str, here: Path, run: Path, capsys: pytest.CaptureFixture) -> None:
    make, says = LIFTERS[kind]
    make(run)
    write_body(here / "a.npz")
    message = refusal(capsys, "predict", f"run={run}", "input=a.npz", "output=out.npz")
    assert says in message
    assert says in refusal(capsys, "evaluate", f"run={run}", "data.test=a.npz")
    assert not (run / "marker").exists()
    assert not (here / "out.npz").exists()


def test_a_network_file_that_the_settings_do_not_name_is_not_run(here: Path, run: Path, capsys) -> None:
    """Weights that come from elsewhere cannot start a file that lies beside them."""
    (here / "evil.py").write_text("open('marker', 'w')\nfrom torch import nn\nclass Net(nn.Module): pass\n")
    write_other_network(run, network="evil.py:Net")
    write_body(here / "a.npz")
    message = refusal(capsys, "predict", f"run={run}", "input=a.npz", "output=out.npz")
    assert "evil.py" in message
    assert not (here / "marker").exists()


def test_a_hostile_checkpoint_does_not_run(here: Path, run: Path, capsys: pytest.CaptureFixture) -> None:
    path = run / "checkpoints" / "teacher.ckpt"
    state = torch.load(path, weights_only=True)
    state["done"] = 0.5
    for content in ({**state, "callbacks": Payload(run / "marker")}, Payload(run / "marker")):
        torch.save(content, path)
        message = refusal(capsys, "fit", f"resume={run}")
        assert "holding more than tensors and plain data" in message
        assert not (run / "marker").exists()


def test_a_checkpoint_of_another_skeleton(here: Path, run: Path, capsys: pytest.CaptureFixture) -> None:
    write_body(here / "hand.npz", skeleton="hand21")
    for words in (
        ["predict", f"run={run}", "input=hand.npz", "output=out.npz"],
        ["evaluate", f"run={run}", "data.test=hand.npz"],
    ):
        message = refusal(capsys, *words)
        assert "h36m17" in message
        assert "hand.npz" in message
    words = ["fit", "skeleton=hand21", "data.train=hand.npz", *QUICK, f"init={run}"]
    assert "was trained on skeleton 'h36m17' (17 joints: hip, rhip" in refusal(capsys, *words)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "the file is empty"),
        (b"\x00\x01", "config.yaml"),
        (b"task: [", "not YAML"),
        (b"seed: !!python/object/apply:os.system ['touch marker']", "YAML tag"),
        (b"colour: red", "unknown setting 'colour'"),
    ],
)
def test_a_wrong_config_of_a_run(content: bytes, says: str, here: Path, run: Path, capsys) -> None:
    (run / "config.yaml").write_bytes(content)
    message = refusal(capsys, "fit", f"resume={run}")
    assert says in message
    assert "config.yaml" in message
    assert not (here / "marker").exists()


def test_a_skeleton_with_python_tags_does_not_run(here: Path, capsys: pytest.CaptureFixture) -> None:
    write_body(here / "a.npz")
    (here / "body.yaml").write_text("joints: !!python/object/apply:os.system ['touch marker']\n")
    for words in (["fit", "skeleton=body.yaml", "data.train=a.npz"], ["skeleton", "check", "body.yaml"]):
        assert "YAML tag" in refusal(capsys, *words)
    assert not (here / "marker").exists()


def test_lightnings_refusals_are_ours(here: Path, capsys: pytest.CaptureFixture) -> None:
    words = ["fit", *own_data(here / "a.npz")]
    for setting in (
        "trainer.accelerator=abacus", "trainer.accelerator=gpu", "trainer.precision=99", "trainer.devices=none",
        "trainer.devices=0", "trainer.devices=-2", "trainer.logger=paper",
    ):  # fmt: skip
        assert setting in refusal(capsys, *words, setting).replace("'", "")


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("accelerator=tpu", "trainer.accelerator=tpu"),
        ("accelerator=abacus", "trainer.accelerator=abacus"),
        ("precision=7", "trainer.precision='7': expected one of auto, 32-true"),
        ("precision=64-true", "trainer.precision='64-true': expected one of auto, 32-true"),
        ("strategy=none", "trainer.strategy=none"),
        ("profiler=[a]", "trainer.profiler=['a']: expected text"),
        ("detect_anomaly=x", "trainer.detect_anomaly='x': expected true or false"),
        ("min_steps=1.5", "trainer.min_steps=1.5: expected a whole number"),
        ("gradient_clip_val=true", "trainer.gradient_clip_val=True: expected a whole number or a number"),
    ],
)
def test_flags_are_refused_before_data_is_read(setting: str, says: str, here: Path, capsys) -> None:
    (here / "a.npz").write_text("no data")
    assert says in refusal(capsys, "fit", "skeleton=h36m17", "data.train=a.npz", f"trainer.{setting}")


def test_test_frames_of_other_joints_are_refused_before_the_fit(here: Path, capsys: pytest.CaptureFixture) -> None:
    write_body(here / "hand.npz", skeleton="hand21")
    assert "hand.npz" in refusal(capsys, "fit", *own_data(here / "a.npz"), "data.test=hand.npz")
    assert not (here / "runs").exists()
