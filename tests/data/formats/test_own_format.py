"""A format of a user's own: ten lines in a file, and everything that reads files takes it; what is wrong with it is named."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
import yaml
from bodies import QUICK, body_arrays, refusal, status_of, write_body
from hypothesis import given
from hypothesis import strategies as st

import uplift
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions


@pytest.fixture(autouse=True, scope="module")
def as_users_run_it():
    """Switch off the checks of types, which only tests have: a user's code may give lists."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jaxtyping.config, "jaxtyping_disable", True)
        yield


READER = '''
import numpy as np

import uplift


class MyFormat(uplift.Format):
    """Text files of my tracker.

    With more words.
    """

    ending = ".trk"

    def read(self, path, options):
        names, *lines = path.read_text().splitlines()
        names = names.split()[1:]
        rows = np.array([line.split() for line in lines], float)
        joints = rows[:, 1:].reshape(len(rows), len(names), -1)
        identity = {"sequence": path.stem, "frame": rows[:, 0]}
        pose = None if joints.shape[2] == 3 else joints[..., 3:]
        return uplift.PoseData(joints[..., :2], joints[..., 2], names, pose, identity=identity)


class Whole(MyFormat):
    ending = ""
    title = "a folder of mine"

    def read(self, path, options):
        return super().read(path / "b.trk" if path.is_dir() else path, options)
'''


def text_of(arrays: dict, rows: slice, pose: bool = False) -> str:
    """Return frames as the tracker writes them: the frame, then x, y, score, and x, y, z of the pose, for each joint."""
    lines = [f"frame {' '.join(arrays['joint_names'])}"]
    for row in range(*rows.indices(len(arrays["keypoints"]))):
        numbers = [str(arrays["frame"][row])]
        for joint in range(len(arrays["joint_names"])):
            numbers += [repr(float(value)) for value in arrays["keypoints"][row, joint]] + ["0.75"]
            numbers += [repr(float(value)) for value in arrays["pose"][row, joint]] if pose else []
        lines.append(" ".join(numbers))
    return "\n".join(lines) + "\n"


@pytest.fixture
def mine(here: Path) -> Path:
    """Return the current folder, with the reader and a folder of three clips of ten frames in its format."""
    (here / "my_reader.py").write_text(READER)
    (here / "tracks").mkdir()
    for number, name in enumerate("abc"):
        text = text_of(body_arrays(), slice(10 * number, 10 * number + 10))
        (here / f"tracks/{name}.trk").write_text(text)
    (here / "tracks/notes.md").write_text("nothing")
    return here


OWN = "my_reader.py:MyFormat"


# What is read is what the file says.


@pytest.mark.parametrize("name", ["a.trk", "b.trk"])
def test_a_file_is_read_as_its_class_says(mine: Path, name: str) -> None:
    start = 10 * "abc".index(name[0])
    expected = body_arrays()
    found = read(f"tracks/{name}", ReadOptions(format=OWN))
    assert np.array_equal(found.keypoints, expected["keypoints"][start : start + 10])
    assert found.keypoints.dtype == found.confidence.dtype == np.float32
    assert (found.confidence == np.float32(0.75)).all()
    assert found.joint_names == tuple(expected["joint_names"])
    assert found.identity["frame"].tolist() == list(range(10))
    assert found.identity["sequence"].tolist() == [name[0]] * 10
    assert found.notes == ("read as Text files of my tracker (my_reader.py:MyFormat)",)
    assert found.source == f"tracks/{name}"
    assert found.pose is None


def test_the_files_of_a_folder_are_joined_and_others_counted(mine: Path) -> None:
    found = read("tracks", ReadOptions(format=OWN))
    assert np.array_equal(found.keypoints, body_arrays()["keypoints"][:30])
    assert found.identity["sequence"].tolist() == ["a"] * 10 + ["b"] * 10 + ["c"] * 10
    assert len(np.unique(found.clips())) == 3
    assert found.notes[-1] == "1 files of other kinds in the folder were left out"


def test_a_class_without_an_ending_gets_the_folder(mine: Path) -> None:
    found = read("tracks", ReadOptions(format="my_reader.py:Whole"))
    assert np.array_equal(found.keypoints, body_arrays()["keypoints"][10:20])
    assert found.notes == ("read as a folder of mine (my_reader.py:Whole)",)


def test_files_with_a_pose_keep_it(mine: Path) -> None:
    Path("true.trk").write_text(text_of(body_arrays(), slice(0, 10), pose=True))
    found = read("true.trk", ReadOptions(format=OWN))
    assert found.pose is not None
    assert np.array_equal(found.pose, body_arrays()["pose"][:10])


def test_what_the_user_says_is_put_in_afterwards(mine: Path) -> None:
    options = ReadOptions(format=OWN, fps=50, image_size=(640, 480), focal_px=800, min_confidence=0.8)
    found = read("tracks/a.trk", options)
    assert (found.fps, found.image_size, found.focal_px) == (50, (640, 480), 800)
    assert not found.confidence.any()
    assert found.notes[-1] == "170 keypoints of confidence below 0.8 are taken as missing"


def test_a_class_of_an_installed_package(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy("my_reader.py", "trackers_of_mine.py")
    monkeypatch.syspath_prepend(mine)
    found = read("tracks/a.trk", ReadOptions(format="trackers_of_mine:MyFormat"))
    assert found.notes == ("read as Text files of my tracker (trackers_of_mine:MyFormat)",)


ARRAYS = '''
import numpy as np

import uplift


class Held(uplift.Format):
    """Whatever is held."""

    held = ()

    def read(self, path, options):
        return uplift.PoseData(*self.held)
'''
NUMBERS = st.one_of(st.integers(-5000, 5000), st.floats(-1e4, 1e4, width=32), st.just(np.nan), st.just(np.inf))


@given(
    keypoints=st.lists(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=3), min_size=1, max_size=4),
    scores=st.lists(st.one_of(st.floats(-1, 2, width=32), st.just(np.nan)), min_size=12, max_size=12),
    kind=st.sampled_from(["list", "float64", "float32"]),
)
def test_lists_and_arrays_of_any_numbers(tmp_path_factory, keypoints: list, scores: list, kind: str) -> None:
    folder = tmp_path_factory.getbasetemp()
    file = folder / "held.py"
    file.write_text(ARRAYS)
    (folder / "any.bin").write_text("x")
    from uplift.config.plugins import find_class
    from uplift.config.trust import granted

    confidence = [scores[3 * row : 3 * row + 3] for row in range(len(keypoints))]
    rows = (keypoints, confidence) if kind == "list" else (np.array(keypoints, kind), np.array(confidence, kind))
    with granted(frozenset({str(file.resolve())})):
        held = find_class(f"{file}:Held", {}, "format")
    held.held = (*rows, ["a", "b", "c"])  # type: ignore[attr-defined]
    expected = np.zeros((len(keypoints), 3), np.float32)
    for row, joints in enumerate(keypoints):
        for joint, (x, y) in enumerate(joints):
            score = confidence[row][joint]
            if np.isfinite(x) and np.isfinite(y) and score > 0:  # NaN is not above 0
                expected[row, joint] = min(score, 1)
    if not expected.any():
        with pytest.raises(uplift.UserError, match="no keypoint in . frames is visible"):
            read(folder / "any.bin", ReadOptions(format=f"{file}:Held"))
        return
    found = read(folder / "any.bin", ReadOptions(format=f"{file}:Held"))
    assert np.array_equal(found.confidence, expected)
    seen = expected > 0
    assert np.array_equal(found.keypoints[seen], np.array(keypoints, np.float32)[seen])


# Every command takes it.


def test_skeleton_map_and_new(mine: Path, capsys) -> None:
    assert status_of("skeleton", "map", "tracks", f"format={OWN}", "skeleton=h36m17") == 0
    text = capsys.readouterr().out
    assert "tracks: 30 frames, 17 joints\n  read as Text files of my tracker (my_reader.py:MyFormat)" in text
    assert "it can be lifted: 30 of 30 frames" in text
    assert status_of("skeleton", "new", "new.yaml", "--from", "tracks", f"format={OWN}") == 0
    assert f"uplift skeleton map tracks format={OWN} skeleton=new.yaml" in capsys.readouterr().out
    assert set(uplift.load_skeleton("new.yaml").joints) == set(body_arrays()["joint_names"].tolist())


def test_data_check_names_the_format(mine: Path, capsys) -> None:
    assert status_of("data", "check", "skeleton=h36m17", "data.train=tracks", f"data.format={OWN}") == 0
    text = capsys.readouterr().out
    assert re.search(r"to load: 30 frames of 17 joints, no poses, .* in memory; read as Text files of my tracker", text)
    (mine / "tracks/b.trk").write_text("frame head\n0 x y z\n")
    assert status_of("data", "check", "skeleton=h36m17", "data.train=tracks", f"data.format={OWN}") != 0
    assert "WRONG    " in (text := capsys.readouterr().out)
    assert re.search(r"tracks/b.trk: MyFormat.read failed in .*my_reader.py, line 18: ValueError: could not", text)


def test_a_run_is_used_from_other_folders(mine: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Fit by a task file in another folder, then evaluate, predict and resume where nothing of it is."""
    (mine / "mine.yaml").write_text(
        "extends: default\nskeleton: h36m17\n"
        f"data: {{root: tracks, train: a.trk, test: c.trk, format: '{OWN}', fps: 10}}\n"
    )
    (mine / "tracks/c.trk").write_text(text_of(body_arrays(), slice(20, 40), pose=True))
    (mine / "work").mkdir()
    monkeypatch.chdir(mine / "work")
    assert status_of("fit", "task=../mine.yaml", "trust=../my_reader.py", *QUICK) == 0
    assert "train: read as Text files of my tracker (my_reader.py:MyFormat)" in capsys.readouterr().out
    run = (mine / "work/runs/mine/last").resolve()
    kept = yaml.safe_load((run / "config.yaml").read_text())["data"]["format"]
    assert Path(kept).is_absolute()
    assert Path(kept).resolve() == mine / OWN

    (mine / "else").mkdir()
    monkeypatch.chdir(mine / "else")
    trust = "../my_reader.py"
    assert uplift.evaluate(run, trust=trust).frames == 20
    write_body(mine / "truth.npz", 12, seed=5)
    assert uplift.evaluate(run, mine / "truth.npz").frames == 12  # which is guessed
    Path("more.trk").write_text(text_of(body_arrays(), slice(0, 8), pose=True))
    assert uplift.evaluate(run, "more.trk", trust=trust).frames == 8
    for words in ([f"trust={trust}"], [f"trust={trust}", f"format=../{OWN}"]):
        assert status_of("predict", f"run={run}", "input=more.trk", f"output=out{len(words) - 1}.npz", *words) == 0
        assert "lifted 8 frames" in capsys.readouterr().out
    assert np.array_equal(np.load("out0.npz")["keypoints"], body_arrays()["keypoints"][:8])
    assert np.array_equal(np.load("out0.npz")["pose"], np.load("out1.npz")["pose"])

    (run / "lifter.pt").unlink()
    for state in (run / "checkpoints").iterdir():  # as if ended before the first of them
        state.unlink()
    assert status_of("fit", f"resume={run}", f"trust={trust}") == 0
    assert (run / "lifter.pt").is_file()


def test_a_fit_from_the_command_line_in_a_process_of_its_own(mine: Path) -> None:
    """Without the checks of types that the tests switch on."""
    write_body(mine / "truth.npz", 12, seed=5)
    words = ["fit", "skeleton=h36m17", "data.train=tracks", "data.test=truth.npz", f"data.format={OWN}", *QUICK]
    code = "import sys; from uplift.cli.main import main; sys.exit(main(sys.argv[1:]))"
    found = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "train: 30 frames from 3 files, a.trk to c.trk" in found.stdout
    assert "test: 12 frames from" in found.stdout


def test_labelled_frames_of_another_file(mine: Path) -> None:
    write_body(mine / "truth.npz", 12, seed=5)
    words = ["skeleton=h36m17", "data.train=tracks", f"data.format={OWN}", "data.labelled.file=truth.npz"]
    run = uplift.fit(None, *words, "data.labelled.fraction=1", *QUICK)
    assert "labelled: 12 frames from" in (run.path / "report.md").read_text()


def test_nothing_heavy_is_loaded() -> None:
    code = "import sys, uplift; uplift.Format, uplift.MaskFormat, uplift.MaskData; "
    code += "print([name for name in ('torch', 'pandas', 'skimage', 'lightning') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_truth_is_not_labelled_by_a_reader(mine: Path) -> None:
    """Settings alone say which poses training may learn from."""
    body = "data = uplift.PoseData(*GOOD, pose=np.zeros((2, 3, 3)), labelled=np.ones(2, bool))\n        return data"
    assert own(mine, body).labelled is None


# What is wrong ends in one error that says what and where.


def own(folder: Path, body: str, more: str = "", file: str = "x.dat") -> uplift.PoseData:
    """Return what a format of this ``body`` reads."""
    source = (
        "import numpy as np\nimport uplift\n"
        "GOOD = np.array([[[1., 2], [3, 4], [5, 7]]] * 2), np.ones((2, 3)), ['a', 'b', 'c']\n"
        f"class Mine(uplift.Format):\n    {more}\n    def read(self, path, options):\n        {body}\n"
    )
    path = folder / f"mine_{abs(hash(source))}.py"
    path.write_text(source)
    (folder / "x.dat").write_text("x")
    return read(folder / file, ReadOptions(format=f"{path}:Mine"))


LINE = r"x.dat: Mine.read failed in .*mine_\d+.py, line 7: "
AT = r"x.dat: Mine.read, in .*mine_\d+.py, line 7: "
AS = r"x.dat, as mine_\d+.py:Mine read it: "


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("1 / 0", LINE + "ZeroDivisionError: division by zero"),
        ("raise KeyError('k')", LINE + "KeyError: 'k'"),
        ("raise ValueError", LINE + "ValueError$"),
        ("import sys; sys.exit(3)", LINE + "SystemExit: 3"),
        ("open('/none/there')", LINE + "FileNotFoundError"),
        ("import json; json.loads('{')", LINE + "JSONDecodeError"),
        ("return uplift.PoseData(*GOOD, joints=3)", LINE + "TypeError"),
        ("raise uplift.UserError(f'{path}: no tracks')", "x.dat: no tracks$"),
        ("raise uplift.UserError('no tracks')", AT + "no tracks"),
        ("pass", AS + r"Mine.read returned nothing, expected uplift.PoseData\("),
        ("return GOOD", AS + "Mine.read returned tuple"),
        ("return uplift.PoseData", AS + "Mine.read returned _?[A-Za-z]*type"),
        ("yield uplift.PoseData(*GOOD)", AS + "Mine.read returned generator"),
        ("return uplift.PoseData(GOOD[0], np.ones((3, 3)), GOOD[2])", AT + r"'confidence' has shape \(3, 3\), expec"),
        ("return uplift.PoseData(GOOD[0], np.ones(2), GOOD[2])", AT + "'confidence' has shape"),
        ("return uplift.PoseData(GOOD[0], None, GOOD[2])", AT + "'confidence' is NoneType, expected an array of num"),
        ("return uplift.PoseData(*GOOD[:2], ['a', 'b'])", AT + "2 joint names for 3 joints"),
        ("return uplift.PoseData(*GOOD[:2], 'head')", AT + "4 joint names for 3 joints"),
        ("return uplift.PoseData(*GOOD[:2], ['a', 'b', 'a'])", AS + "it names 'a' twice"),
        ("return uplift.PoseData(np.zeros((2, 0, 2)), np.ones((2, 0)), [])", AS + "no joints"),
        ("return uplift.PoseData(np.zeros((0, 3, 2)), np.ones((0, 3)), GOOD[2])", AS + "no frames"),
        ("return uplift.PoseData(GOOD[0] * np.nan, *GOOD[1:])", AS + "no keypoint in 2 frames is visible"),
        ("return uplift.PoseData(GOOD[0], GOOD[1] * 0, GOOD[2])", AS + "no keypoint in 2 frames is visible"),
        (
            "return uplift.PoseData(GOOD[0], GOOD[1] * 980, GOOD[2])",
            "x.dat: confidence goes from 0 to 9[0-9]+, expected 0 to 1",
        ),
        ("return uplift.PoseData(GOOD[0][:, :, [0, 1, 1]], *GOOD[1:])", AT + r"'keypoints' has shape \(2, 3, 3\)"),
        ("return uplift.PoseData(GOOD[0].reshape(2, 6), *GOOD[1:])", AT + r"'keypoints' has shape \(2, 6\)"),
        ("return uplift.PoseData([[[1, 2], [3]]], *GOOD[1:])", AT + "'keypoints' has rows of different lengths"),
        (
            "return uplift.PoseData(GOOD[0].astype(str), *GOOD[1:])",
            AT + "'keypoints' is <U32 of shape .*array of numbers",
        ),
        ("return uplift.PoseData(GOOD[0] * 1j, *GOOD[1:])", AT + "'keypoints' is complex128"),
        ("return uplift.PoseData(*GOOD, pose=np.zeros((2, 4, 3)))", AT + r"'pose' has shape \(2, 4, 3\)"),
        ("d = uplift.PoseData(*GOOD); d.pose = GOOD[0]; return d", AS + r"'pose' is float64 of shape \(2, 3, 2\)"),
        ("d = uplift.PoseData(*GOOD); d.confidence = 'x'; return d", AS + r"'confidence' is <U1 of shape \(\)"),
        ("d = uplift.PoseData(*GOOD); d.fps = -1; return d", AS + "'fps' is .*expected one positive number"),
        ("d = uplift.PoseData(*GOOD); d.fps = 'fast'; return d", AS + "'fps' is"),
        ("d = uplift.PoseData(*GOOD); d.image_size = (640,); return d", AS + "'image_size' is"),
        (
            "d = uplift.PoseData(*GOOD, np.zeros((2, 3, 3)), unit='m'); return d",
            AS + "'unit' is 'm', expected one of mm",
        ),
        ("return uplift.PoseData(*GOOD, identity={'sequnce': 'a'})", AS + r"identity\['sequnce'\].* mean 'sequence'"),
        (
            "return uplift.PoseData(*GOOD, identity={'frame': ['a', 'b']})",
            AS + r"'frame' is <U1, expected nu",
        ),
        ("return uplift.PoseData(*GOOD, identity={'frame': [1, np.nan]})", AS + r"'frame' is not finite"),
        ("return uplift.PoseData(*GOOD, identity={'camera': [{}, {}]})", AS + r"'camera' is object"),
        (
            "return uplift.PoseData(*GOOD, identity={'frame': [1, 2, 3]})",
            AT + r"'frame' has shape \(3,\), expected \(2,\)",
        ),
        (
            "return uplift.PoseData(*GOOD, bones=(('a', 'x'),))",
            AS + "'bones' holds .*expected pairs of its joint names",
        ),
        ("d = uplift.PoseData(*GOOD); d.mirror = ('ab',); return d", AS + "'mirror' holds 'ab'"),
        ("d = uplift.PoseData(*GOOD); d.lens = np.zeros(2, int); return d", AS + "'lens' holds .* below 0"),
        ("return uplift.PoseData(*GOOD, masks=np.zeros((2, 9, 9), np.uint8))", AT + ".*'masks' without 'mask_box'"),
    ],
)
def test_what_is_read_is_checked(here: Path, body: str, says: str) -> None:
    with pytest.raises(uplift.UserError, match=says) as found:
        own(here, body)
    assert len(str(found.value)) < 500


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("def __init__(self, size): pass", "Mine.__init__ needs 'size', but formats are made without arguments"),
        ("def __init__(self): 1 / 0", "Mine.__init__ failed in .*, line 5: ZeroDivisionError"),
        ("ending = ('.a', '.b')", r"Mine.ending is \('.a', '.b'\), expected text"),
        ("title = 3", "Mine.title is 3, expected text"),
        ("ending = 'trk'", r"has no files that end with .trk, which mine_\d+.py:Mine reads \(in it: "),
    ],
)
def test_a_class_that_cannot_be_made(here: Path, more: str, says: str) -> None:
    with pytest.raises(uplift.UserError, match=says):
        own(here, "return uplift.PoseData(*GOOD)", more, file="")


def test_joints_that_differ_between_the_files_of_a_folder(mine: Path) -> None:
    (mine / "tracks/b.trk").write_text("frame head\n0 1 2 1\n")
    with pytest.raises(uplift.UserError, match=r"tracks/b.trk, as .* its joints are head, those of tracks/a.trk "):
        read("tracks", ReadOptions(format=OWN))


NAMES = """
import uplift
class Masks(uplift.MaskFormat):
    def read(self, path, options): return []
class Nothing(uplift.Format): pass
class Plain: pass
def function(): pass
"""


@pytest.mark.parametrize(
    ("format", "says"),
    [
        (
            "opnpose",
            "format=opnpose: no such format. Did you mean 'openpose'. Known: .*Your own is file.py:Class or pack",
        ),
        ("my_reader.py", "format=my_reader.py: which class of that file. Your own is file.py:Class"),
        ("my_raeder.py:MyFormat", "format: no file .*my_raeder.py"),
        ("my_reader.py:MyFromat", "format='my_reader.py:MyFromat': no class 'MyFromat' there. Did you mean 'MyFormat'"),
        ("names.py:function", "no class 'function' there"),
        ("names.py:Plain", "format: 'names.py:Plain' is not a subclass of uplift.Format"),
        ("names.py:Nothing", r"format=names.py:Nothing: Nothing has no method read\(self, path, options\)"),
        ("names.py:Masks", "Masks is a uplift.MaskFormat, expected a uplift.Format here"),
        ("broken.py:MyFormat", "format: .*broken.py does not run: NameError"),
        ("nothing.such:MyFormat", "format: cannot import 'nothing.such'"),
        ("subprocess:Popen", "is not a subclass of uplift.Format"),
    ],
)
def test_a_name_that_is_none(mine: Path, capsys, format: str, says: str) -> None:
    (mine / "names.py").write_text(NAMES)
    (mine / "broken.py").write_text("undefined")
    message = refusal(capsys, "skeleton", "map", "tracks", f"format={format}", "skeleton=h36m17")
    assert re.search(says, message)


def test_an_empty_file_and_one_that_is_not_there(mine: Path, capsys) -> None:
    Path("empty.trk").touch()
    words = "skeleton", "map", f"format={OWN}", "skeleton=h36m17"
    assert "empty.trk is empty (0 bytes), expected keypoints" in refusal(capsys, *words, "empty.trk")
    assert "No file none.trk" in refusal(capsys, *words, "none.trk")


def test_a_fit_of_a_reader_that_fails_is_one_error(mine: Path, capsys) -> None:
    (mine / "tracks/c.trk").write_text("frame a b\n0 1 2 3\n")
    message = refusal(capsys, "fit", "skeleton=h36m17", "data.train=tracks", f"data.format={OWN}", *QUICK)
    assert re.search(
        r"tracks/c.trk: MyFormat.read failed in .*my_reader.py, line 19: ValueError: cannot reshape", message
    )
