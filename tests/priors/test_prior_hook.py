"""A stranger's prior, in a file outside the package, through the command line."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from bodies import own_data, refusal, status_of

FLAT_GROUND = '''\
import uplift


class FlatGround(uplift.Prior):
    """Both feet of a standing body rest on one plane."""

    def __init__(self, skeleton, height=0.0):
        super().__init__(skeleton)
        self.feet = [skeleton.index("rankle"), skeleton.index("lankle")]
        self.height = height

    def loss(self, lift):
        right, left = lift.level_pose[:, self.feet, 1].unbind(1)
        both = lift.confidence[:, self.feet].prod(1)
        return both * (right - left - self.height).square()
'''
ALL_HOOKS = """\
import torch
import uplift


class Everything(uplift.Prior):
    def __init__(self, skeleton, factor=2.0):
        super().__init__(skeleton)
        self.factor = factor
        self.line = torch.nn.Linear(2 * len(skeleton.joints), 1)
        self.prepared = 0

    def prepare(self, data):
        self.prepared = len(data)
        assert abs(float(data.keypoints.norm(dim=-1).max())) < 100

    def judge(self, keypoints):
        return self.line(keypoints.flatten(1))[:, 0]

    def loss(self, lift):
        return self.factor * self.judge(lift.reprojected)

    def critic_loss(self, real, seen):
        assert not seen.requires_grad and not real.requires_grad
        return self.judge(real).square().mean() - self.judge(seen).mean() + self.line.weight.square().sum()

    def metrics(self, lift):
        return {"prepared": self.prepared, "factor": self.factor}
"""


@pytest.fixture
def work(tmp_path, monkeypatch) -> Path:
    """A folder of the user's own to run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _prior_file(folder: Path, text: str, name: str = "my_priors.py") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def _metrics(folder: Path) -> dict[str, list[float]]:
    (file,) = [p for p in folder.glob("runs/*/*/metrics.csv") if not p.parent.is_symlink()]
    found: dict[str, list[float]] = {}
    for row in csv.DictReader(file.open()):
        found.setdefault(row["name"], []).append(float(row["value"]))
    return found


def test_own_prior_trains(work):
    """Relative path, its own option, a loss for each frame; its loss is in metrics.csv and falls."""
    _prior_file(work, FLAT_GROUND)
    words = own_data(work / "bodies.npz")
    assert status_of(
        "fit", *words, "priors.ground.use=my_priors.py:FlatGround", "priors.ground.weight=50", "priors.ground.height=0.5",
        "student.share=0", "teacher.learning_rate=0.01", "trainer.max_steps=30", "trainer.log_every=1",
    ) == 0  # fmt: skip
    ground = _metrics(work)["ground"]
    assert len(ground) == 30
    assert sum(ground[-5:]) < 0.5 * sum(ground[:5])


def test_all_hooks_are_called(work):
    _prior_file(work, ALL_HOOKS)
    words = own_data(work / "bodies.npz")
    assert status_of(
        "fit", *words, "priors.all.use=my_priors.py:Everything", "priors.all.weight=0.01", "priors.all.factor=3.5"
    ) == 0  # fmt: skip
    found = _metrics(work)
    assert found["all_factor"][0] == 3.5
    assert found["all_prepared"][0] == 60
    assert {"all", "all_own"} <= set(found)


def test_in_a_task_file_paths_are_relative_to_it(work):
    folder = work / "tasks"
    folder.mkdir()
    _prior_file(folder, FLAT_GROUND)
    (folder / "mine.yaml").write_text(
        "extends: default\nskeleton: h36m17\npriors:\n  ground: {use: 'my_priors.py:FlatGround', weight: 0.1, height: 0.2}\n"
    )
    words = [w for w in own_data(work / "bodies.npz") if not w.startswith("skeleton=")]
    assert status_of("fit", "task=tasks/mine.yaml", "trust=tasks/my_priors.py", *words) == 0
    assert "ground" in _metrics(work)


BODY = "import uplift\n\n\nclass Mine(uplift.Prior):\n"
MISTAKES = {
    "unknown option": (FLAT_GROUND.replace("FlatGround", "Mine"), ["priors.mine.hight=1"], "Did you mean 'height'"),
    "text for a number": (FLAT_GROUND.replace("FlatGround", "Mine"), ["priors.mine.height=low"], "expected a number"),
    "option without a value": (BODY + "    def __init__(self, skeleton, share):\n        super().__init__(skeleton)\n", [],
                               "set priors.mine.share="),
    "no super": (BODY + "    def __init__(self, skeleton):\n        self.feet = 3\n\n    def loss(self, lift):\n"
                 "        return lift.pose.mean()\n", [], "must call super().__init__(skeleton) first"),
    "skeleton kept without super": (BODY + "    def __init__(self, skeleton):\n        self.skeleton = skeleton\n", [],
                                    "must call super().__init__(skeleton) first"),
    "parameter before super": ("import torch\n" + BODY + "    def __init__(self, skeleton):\n"
                               "        self.w = torch.nn.Parameter(torch.ones(1))\n        super().__init__(skeleton)\n",
                               [], "line 7"),
    "no skeleton": (BODY + "    def __init__(self):\n        super().__init__(None)\n", [], "'skeleton'"),
    "init fails": (BODY + "    def __init__(self, skeleton):\n        super().__init__(skeleton)\n"
                   "        skeleton.index('tail')\n", [], "no joint 'tail'"),
    "init fails otherwise": (BODY + "    def __init__(self, skeleton):\n        super().__init__(skeleton)\n"
                             "        self.x = 1 / 0\n", [], "line 7: ZeroDivisionError"),
    "no Prior": ("class Mine:\n    def __init__(self, skeleton):\n        pass\n", [], "not a subclass of uplift.Prior"),
    "does not run": ("import uplift\n1 / 0\n", [], "does not run: ZeroDivisionError"),
    "no Python": ("class Mine(:\n", [], "does not run: SyntaxError"),
    "no such class": (FLAT_GROUND.replace("FlatGround", "Mime"), [], "Did you mean 'Mime'"),
    "no loss": (BODY + "    pass\n", [], "has no loss"),
    "loss fails": (BODY + "    def loss(self, lift):\n        return lift.poses.mean()\n", [], "line 6"),
    "not a number": (BODY + "    def loss(self, lift):\n        return 3.0\n", [], "returned float"),
    "wrong shape": (BODY + "    def loss(self, lift):\n        return lift.pose\n", [], "one number (shape ())"),
    "detached": (BODY + "    def loss(self, lift):\n        return lift.pose.detach().square().mean()\n", [],
                 "depends on nothing that can be trained"),
    "NaN": (BODY + "    def loss(self, lift):\n        return (lift.pose * 0 / 0).mean()\n", [], "loss is nan"),
    "metrics fail": (BODY + "    def loss(self, lift):\n        return lift.pose.mean()\n\n"
                     "    def metrics(self, lift):\n        return {'x': lift.poses}\n", [], "line 9"),
    "prepare fails": (BODY + "    def prepare(self, data):\n        data.poses\n\n    def loss(self, lift):\n"
                      "        return lift.pose.mean()\n", [], "line 6"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_told_in_one_error(work, capsys, mistake):
    text, more, message = MISTAKES[mistake]
    _prior_file(work, text, f"own_{list(MISTAKES).index(mistake)}.py")
    use = f"priors.mine.use=own_{list(MISTAKES).index(mistake)}.py:Mine"
    assert status_of("fit", *own_data(work / "bodies.npz"), use, "priors.mine.weight=1", *more) == 2
    told = capsys.readouterr().err
    assert message in told
    assert "Traceback" not in told


def test_a_satisfied_hinge_is_no_mistake(work):
    _prior_file(
        work, BODY + "    def loss(self, lift):\n        return (lift.pose.norm(dim=-1).mean(1) - 1e6).clamp_min(0)\n"
    )
    assert (
        status_of("fit", *own_data(work / "bodies.npz"), "priors.mine.use=my_priors.py:Mine", "priors.mine.weight=1")
        == 0
    )


def test_missing_file(work, capsys):
    assert (
        status_of("fit", *own_data(work / "bodies.npz"), "priors.mine.use=nowhere.py:Mine", "priors.mine.weight=1") == 2
    )
    assert "no file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("hook", "says"),
    [
        (
            "loss(self, lift):\n        return lift.turned.mean()",
            "line 6: AttributeError: lift.turned is now called lift.rotated",
        ),
        ("own_loss(self, real, seen):\n        return real.mean()", "own_loss, which is now called critic_loss"),
    ],
)
def test_a_former_name_in_a_prior_is_an_error_with_the_new_one(
    hook: str, says: str, here: Path, capsys: pytest.CaptureFixture
) -> None:
    (here / "old.py").write_text(f"import uplift\n\n\nclass Old(uplift.Prior):\n    def {hook}\n")
    assert says in refusal(capsys, "fit", *own_data(here / "body.npz"), "priors.old.use=old.py:Old")


def test_the_former_name_of_a_setting_is_an_error_with_the_new_one(here: Path, capsys: pytest.CaptureFixture) -> None:
    assert "lifter.uncertainty" in refusal(capsys, "fit", *own_data(here / "body.npz"), "lifter.spread=false")
