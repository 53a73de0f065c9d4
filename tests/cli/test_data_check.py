"""What a task needs and has: files, joints, memory; and what is said where files are missing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bodies import body_arrays, refusal, status_of, write_body

from uplift.cli.data_check import check_data
from uplift.config import files as paths
from uplift.config.files import shipped, shipped_names
from uplift.config.loading import load_settings
from uplift.data.datasets import read_cached
from uplift.data.formats import read

pytestmark = pytest.mark.usefixtures("here", "trusting")

SET = """
from uplift.data.datasets import DataSet, WantedFile
from uplift.data.formats import read


class Beetles(DataSet):
    title = "Beetles 3.6"
    about = "From beetles.example after registration, for research alone.\\nBoth files go into one folder."

    def __init__(self, folder, noise: float = 0.0):
        super().__init__(folder)
        self.noise = noise

    def files(self, split):
        return [WantedFile(self.folder / f"{split}_2d.npz", "2D keypoints"),
                WantedFile(self.folder / "poses.bin", "3D poses, by the authors' script")]

    def read(self, split):
        return read(self.folder / f"{split}_2d.npz")
"""
TASK = """
extends: default
description: Beetles
skeleton: h36m17
data: {name: beetles, use: "beetles.py:Beetles", train: train, test: test}
"""


@pytest.fixture
def beetles(here: Path) -> Path:
    """Return the folder that a task of a set of one's own reads from, with all that it needs."""
    (here / "beetles.py").write_text(SET)
    (here / "beetles.yaml").write_text(TASK)
    folder = here / "data" / "beetles"
    folder.mkdir(parents=True)
    write_body(folder / "train_2d.npz")
    write_body(folder / "test_2d.npz", 20, seed=1)
    (folder / "poses.bin").write_bytes(bytes(5_000_000))
    return folder


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep every cache of these tests to itself."""
    monkeypatch.setenv("UPLIFT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def told(*words: str) -> str:
    lines, _ = check_data(words)
    return "\n".join(lines)


def test_a_task_of_files_says_size_frames_joints_and_memory(here: Path, capsys) -> None:
    folder = here / "sets" / "cmu"
    folder.mkdir(parents=True)
    write_body(folder / "train.npz", 60)
    write_body(folder / "test.npz", 20, pose=None, root=None, tilt_deg=None)
    assert status_of("data", "check", "task=cmu", f"data.root={folder}") == 0
    text = capsys.readouterr().out
    assert f"folder: {folder}\n" in text
    assert re.search(
        r"train: train.npz\n  present  train.npz, \d+ kB\n  to load: 60 frames of 17 joints, with poses", text
    )
    assert re.search(
        r"test: test.npz\n  present  test.npz, [\d.]+ kB\n  to load: 20 frames of 17 joints, no poses", text
    )
    assert text.endswith(f"next: uplift fit task=cmu data.root={folder}\n")


def test_the_memory_is_that_of_the_arrays_read(here: Path) -> None:
    arrays = body_arrays(6000)
    write_body(here / "a.npz", 6000, pose=arrays["pose"].astype(np.float64))
    data = read(here / "a.npz")
    held = [data.keypoints, data.confidence, data.pose, data.root, data.tilt_deg, *data.identity.values()]
    size = sum(array.nbytes for array in held if array is not None) / 1e6
    found = re.search(r"([\d.]+) MB in memory", told("skeleton=h36m17", "data.train=a.npz"))
    assert found is not None
    assert float(found[1]) == pytest.approx(size, rel=0.05)


def test_a_missing_file_says_where_how_and_what_next(here: Path, capsys) -> None:
    assert status_of("data", "check", "task=cmu") == 2
    text = capsys.readouterr().out
    for part in ("folder: " + str(here / "data/cmu"), "(not there)", "MISSING  train.npz", "MISSING  test.npz",
                 "Get it: ", "data.root=FOLDER", "task=demo", "then uplift data check task=cmu"):  # fmt: skip
        assert part in text
    assert "uplift fit task=cmu" not in text


def test_simulated_tasks_need_nothing(capsys) -> None:
    assert status_of("data", "check", "task=demo") == 0
    text = capsys.readouterr().out
    assert "20,000 frames: no files needed" in text
    assert text.endswith("next: uplift fit task=demo\n")


def test_a_set_before_and_after_it_is_cached(beetles: Path) -> None:
    text = told("task=beetles.yaml")
    assert text.count("present") == 4
    assert "train: Beetles 3.6, split 'train'" in text
    size = 5 + sum(array.nbytes for array in body_arrays(60).values() if hasattr(array, "nbytes")) / 1e6
    assert f"not read before; the first fit reads the files and keeps the arrays; the files hold {size:.1f} MB" in text
    from uplift.data.load import set_of

    source = set_of(load_settings("beetles.yaml"), "train")
    assert source is not None
    read_cached(source, "train")
    after = told("task=beetles.yaml")
    assert re.search(r"to load: 60 frames of 17 joints, \d+ kB in memory, from the cache", after)
    assert after.count("not read before") == 1  # the test frames
    write_body(beetles / "train_2d.npz", 50)
    assert told("task=beetles.yaml").count("not read before") == 2
    assert told("task=beetles.yaml", "data.options.noise=2").count("not read before") == 2


def test_labelled_frames_of_another_file(beetles: Path, here: Path, capsys) -> None:
    words = ["task=beetles.yaml", "data.labelled.file=labels.npz"]
    assert status_of("data", "check", *words) == 2
    text = capsys.readouterr().out
    assert f"labelled: {here / 'labels.npz'}\n  MISSING  labels.npz" in text
    write_body(here / "labels.npz", 7)
    assert status_of("data", "check", *words) == 0
    text = capsys.readouterr().out
    assert re.search(r"labelled: .*labels.npz\n  present  labels.npz, .*\n  to load: 7 frames of 17 joints", text)
    assert text.endswith("next: uplift fit task=beetles.yaml data.labelled.file=labels.npz trust=beetles.py\n")


def test_a_set_with_files_missing(beetles: Path, capsys) -> None:
    (beetles / "poses.bin").unlink()
    assert status_of("data", "check", "task=beetles.yaml") == 2
    text = capsys.readouterr().out
    assert text.count("MISSING  poses.bin: 3D poses, by the authors' script") == 2
    assert text.count("present") == 2
    assert "to load" not in text
    for part in ("From beetles.example", "a subfolder beetles/", "task=semi_cmu", "task=demo"):
        assert part in text


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (b"", "is empty"),
        (b"no archive", "cannot be read as an .npz file"),
        ({"joint_names": np.array([f"j{n}" for n in range(17)])}, "h36m17"),
        ({"joint_names": None}, "'joint_names'"),
        ({"joint_names": np.array(["hip"])}, "1 joint names for 17 joints"),
    ],
    ids=["empty", "not an archive", "other joints", "no names", "too few names"],
)
def test_a_wrong_file_is_told_from_a_missing_one(wrong, says: str, here: Path, capsys) -> None:
    if isinstance(wrong, bytes):
        (here / "a.npz").write_bytes(wrong)
    else:
        write_body(here / "a.npz", **wrong)
    assert status_of("data", "check", "skeleton=h36m17", "data.train=a.npz") == 2
    text = capsys.readouterr().out
    assert re.search(r"  WRONG    .*a\.npz", text)
    assert says in text
    assert "next: fix or replace what is wrong" in text


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "expected `uplift data check task=NAME`"),
        (["chek"], "expected `uplift data check task=NAME`"),
        (["check", "task=cmuu"], "Did you mean 'cmu'?"),
        (["check", "task="], "has no value"),
        (["check", "task=cmu", "data.rot=x"], "Did you mean 'data.root'?"),
        (["check", "skeleton=h36m17"], "set data.train=FILE"),
        (["check", "task=beetles.yaml", "data.options.nose=1"], "Did you mean 'noise'?"),
        (["check", "task=beetles.yaml", "data.train=trian"], "MISSING"),
    ],
)
def test_wrong_words(words: list[str], says: str, beetles: Path, capsys) -> None:
    assert status_of("data", *words) == 2
    captured = capsys.readouterr()
    assert says in captured.out + captured.err
    assert "Traceback" not in captured.err


def test_it_loads_nothing_heavy(beetles: Path) -> None:
    script = "import sys\nfrom uplift.cli.main import main\nassert main(['data', 'check', 'task=beetles.yaml', 'trust=beetles.py']) == 0\n"
    script += "assert not set(sys.modules) & {'torch', 'lightning', 'skimage', 'scipy'}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_the_tasks_list_tells_sets_apart(beetles: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    home = beetles.parent.parent / "package"
    (home / "shipped").mkdir(parents=True)
    (home / "shipped" / "skeletons").symlink_to(shipped("skeletons"))
    (home / "shipped" / "tasks").mkdir()
    (home / "shipped" / "tasks" / "default.yaml").write_text((shipped("tasks") / "default.yaml").read_text())
    (home / "shipped" / "tasks" / "bugs.yaml").write_text(
        TASK.replace("beetles.py", str(Path("beetles.py").absolute()))
    )
    monkeypatch.setattr(paths, "_PACKAGE", home)
    assert status_of("tasks") == 0
    assert re.search(r"^bugs +data present +Beetles", capsys.readouterr().out, re.M)
    (beetles / "poses.bin").unlink()
    assert status_of("tasks") == 0
    assert re.search(r"^bugs +data missing +Beetles", capsys.readouterr().out, re.M)


def test_a_fit_without_its_set_says_what_where_and_what_else(beetles: Path, here: Path, capsys) -> None:
    for file in beetles.iterdir():
        file.unlink()
    message = refusal(capsys, "fit", "task=beetles.yaml", "trust=beetles.py")
    assert message.splitlines() == [
        f"uplift: Beetles 3.6, which task 'beetles' needs: 2 files are not in {beetles}",
        "  train_2d.npz  2D keypoints",
        "  poses.bin     3D poses, by the authors' script",
        "From beetles.example after registration, for research alone.",
        "Both files go into one folder.",
        "Put them there, or name another folder: data.root=FOLDER (or UPLIFT_DATA=FOLDER, with a subfolder beetles/).",
        "Without: `uplift fit task=semi_cmu` runs on open data, `uplift fit task=demo` on none.",
    ]
    assert not (here / "runs").exists()
    (beetles / "poses.bin").write_bytes(b"x")
    assert "1 file is not in" in refusal(capsys, "fit", "task=beetles.yaml", "trust=beetles.py")


WITH_DATA = [name for name in shipped_names("tasks") if load_settings(name).data.train]


@pytest.mark.parametrize("task", WITH_DATA)
def test_every_shipped_task_says_so_in_a_few_lines(task: str, here: Path, capsys) -> None:
    message = refusal(capsys, "fit", f"task={task}")
    name = load_settings(task).data.name
    assert len(message.splitlines()) <= 20
    demo = "task=masks_demo" if load_settings(task).lifts == "masks" else "task=demo"
    for part in (f"task '{task}'", str(here / "data" / name), f"a subfolder {name}/", demo):
        assert part in message
    assert ("task=semi_cmu` runs on open data" in message) == (name != "cmu" and "masks" not in demo)
    assert status_of("data", "check", f"task={task}") == 2
    assert "MISSING" in capsys.readouterr().out


def test_many_files_take_few_lines(here: Path, capsys) -> None:
    actions = "Directions Discussion Eating Greeting Phoning Photo Posing Purchases Sitting SittingDown Smoking Waiting"
    for subject in ("S1", "S5", "S6", "S7", "S8", "S9", "S11"):
        for kind in ("D2_Positions", "D3_Positions_mono"):
            folder = here / "h36m" / subject / "MyPoseFeatures" / kind
            folder.mkdir(parents=True)
            for action in f"{actions} WalkDog WalkTogether Walking".split():
                name = (
                    {"Photo": "TakingPhoto", "WalkDog": "WalkingDog"}.get(action, action) if subject == "S5" else action
                )
                for end in ("", " 1"):
                    (folder / f"{name}{end}.54138969.cdf").write_bytes(bytes(500))
    assert status_of("data", "check", "task=h36m", f"data.root={here / 'h36m'}") == 0
    present = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  present")]
    assert len(present) == 7 * 15  # a line a subject and action, of 840 files
    assert (
        present[0] == "  present  S1 Directions: 4 files, 2.0 kB" and "  present  S5 Photo: 4 files, 2.0 kB" in present
    )


def test_a_pattern_of_many_files_takes_few_lines_too(here: Path, capsys) -> None:
    for number in range(13):
        write_body(here / f"v{number:02}.npz", 5)
    write_body(here / "v12.npz", 5, joint_names=np.array([f"j{n}" for n in range(17)]))
    assert status_of("data", "check", "skeleton=h36m17", "data.train=v*.npz") == 2
    text = capsys.readouterr().out
    assert text.count("present") == 1 and ": 13 files, " in text
    assert text.count("to load: 5 frames") == 10 and "  and 2 more\n  WRONG    " in text and "v12.npz" in text
