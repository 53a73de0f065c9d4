"""A stranger's prior that would fail in silence, or with a traceback, is refused with one clear message."""

from __future__ import annotations

from pathlib import Path

import pytest
from bodies import QUICK, refusal, status_of, write_body

GOOD = """
import torch
from uplift import Prior

class Ground(Prior):
    def __init__(self, skeleton, *, height: float = 0.0):
        super().__init__(skeleton)
        self.height = height

    def loss(self, lift):
        {loss}
"""
NO_GRADIENT = "depends on nothing that can be trained"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_body(tmp_path / "a.npz")
    return tmp_path


def words(*more: str) -> list[str]:
    """Return a fit with the prior of my_priors.py, long enough for the watch to lose its patience."""
    own = [
        "priors.ground.use=my_priors.py:Ground",
        "priors.ground.weight=0.1",
        "student.share=0",
        "trainer.max_steps=25",
    ]
    return ["fit", "skeleton=h36m17", "data.train=a.npz", *QUICK, *own, *more]


@pytest.mark.parametrize(
    "loss",
    [
        "return (lift.level_pose[..., 1].amax(1) - self.height).square()",
        "return (lift.pose[..., 2].mean() - 1e9).clamp_min(0)  # a hinge that is always satisfied",
        "return lift.reprojected.square().mean().double()",
        "return lift.rotated[:, 0].abs().sum(-1).half()",
    ],
)
def test_a_right_prior_trains(here: Path, loss: str) -> None:
    (here / "my_priors.py").write_text(GOOD.format(loss=loss))
    assert status_of(*words("priors.ground.height=1", "trainer.max_steps=3")) == 0
    assert ",ground," in (here / "runs" / "h36m17" / "last" / "metrics.csv").read_text()


@pytest.mark.parametrize(
    ("loss", "says"),
    [
        ("return lift.pose.detach().square().mean()", NO_GRADIENT),
        ("return torch.zeros(len(lift.pose))", NO_GRADIENT),
        ("return torch.from_numpy(lift.pose.detach().numpy()).mean()", NO_GRADIENT),
        ("return lift.keypoints.square().mean()", NO_GRADIENT),
        ("return (lift.pose[..., 1] > -1e9).all(1)", NO_GRADIENT),
        ("return lift.pose.mean() * float('nan')", "loss is nan at step 0"),
        ("return (lift.pose[:, 0] - lift.pose[:, 0]).norm(dim=-1).log()", "loss is -inf at step 0"),
        ("return lift.pose", "returned shape (16, 17, 3), expected one number"),
        ("return lift.pose.mean((1, 2))[:5]", "returned shape (5,)"),
        ("return lift.pose[:, 99].mean()", "IndexError"),
        ("raise RuntimeError('no ground')", "RuntimeError: no ground"),
    ],
)
def test_a_wrong_loss_is_refused(here: Path, capsys: pytest.CaptureFixture, loss: str, says: str) -> None:
    (here / "my_priors.py").write_text(GOOD.format(loss=loss))
    capsys.readouterr()
    status = status_of(*words())
    error = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("teacher ")]
    assert status == 2, error
    assert error[0].startswith("uplift: priors.ground: "), error
    assert says in error[0]
    assert len(error) == 1
    if says.endswith(("Error", "ground")):
        assert "my_priors.py, line 11" in error[0]


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("    pass", "has no loss(self, lift)"),
        ("    def loss(self): return 0", "TypeError"),
        ("    def __init__(self): pass\n    def loss(self, lift): return lift.pose.mean()", "skeleton"),
        (
            "    def __init__(self, skeleton): self.k = 3\n    def loss(self, lift): return 0",
            "super().__init__(skeleton)",
        ),
        ("    def __init__(self, skeleton): self.w = torch.nn.Parameter(torch.ones(1))", "Ground.__init__ failed"),
        ("    def __init__(self, skeleton): 1 / 0", "ZeroDivisionError"),
        ("    def prepare(self, data): data.frames", "prepare failed"),
        (
            "    def critic_loss(self, real, seen): return 3\n    def loss(self, lift): return lift.pose.mean()",
            "critic_loss",
        ),
        (
            "    def metrics(self, lift): return lift.nothing\n    def loss(self, lift): return lift.pose.mean()",
            "metrics failed",
        ),
        ("    def metrics(self, lift): return 3\n    def loss(self, lift): return lift.pose.mean()", "metrics"),
    ],
)
def test_a_wrong_class_is_refused(here: Path, capsys: pytest.CaptureFixture, body: str, says: str) -> None:
    (here / "my_priors.py").write_text(f"import torch\nfrom uplift import Prior\n\nclass Ground(Prior):\n{body}\n")
    capsys.readouterr()
    status = status_of(*words())
    error = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("teacher ")]
    assert status == 2, error
    assert error[0].startswith("uplift: priors.ground"), error
    assert says in error[0]
    assert len(error) == 1


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["priors.ground.hight=3"], "priors.ground.hight"),
        (["priors.ground.hight=3"], "Did you mean 'height'?"),
        (["priors.ground.height=tall"], "expected a number"),
        (["priors.ground.weight=much"], "priors.ground.weight='much': expected a number"),
        (["priors.ground.weight=-1"], "expected a number of at least 0"),
        (["priors.ground.use=my_priors.py:Grund"], "Did you mean 'Ground'?"),
        (["priors.ground.use=my_prior.py:Ground"], "no file"),
        (["priors.ground.use=my_priors.py"], "file.py:Class"),
        (["priors.ground.use=bone"], "Did you mean 'bones'?"),
        (["priors.ground.use=no_such_module:Ground"], "cannot import 'no_such_module'"),
        (["priors.ground.use=pathlib:Path"], "not a subclass of uplift.Prior"),
        (["priors.ground.use=my_priors.py:torch"], "no class 'torch'"),
        (["priors.type.use=my_priors.py:Ground"], "priors.type: 'type' cannot be a prior's name"),
        (["priors.critic.weight=0", "priors.ground=3"], "priors.ground is 3, expected settings"),
    ],
)
def test_a_wrong_setting_is_refused(here: Path, capsys: pytest.CaptureFixture, more: list[str], says: str) -> None:
    (here / "my_priors.py").write_text(GOOD.format(loss="return lift.pose.square().mean()"))
    assert says in refusal(capsys, *words(*more))


@pytest.mark.parametrize("content", ["import nothing_such\n", "def\n", "1/0\n", "import sys; sys.exit(0)\n", "\x00"])
def test_a_file_that_does_not_run_is_refused(here: Path, capsys: pytest.CaptureFixture, content: str) -> None:
    (here / "my_priors.py").write_text(content)
    message = refusal(capsys, *words())
    assert f"{here / 'my_priors.py'} does not run" in message


def test_no_prior_on_is_refused(here: Path, capsys: pytest.CaptureFixture) -> None:
    off = [
        f"priors.{name}.weight=0"
        for name in ("critic", "flow", "consistency", "pairwise", "handedness", "bones", "symmetry")
    ]
    assert "No prior is on" in refusal(capsys, "fit", "skeleton=h36m17", "data.train=a.npz", *QUICK, *off)


def test_own_parameters_alone_are_trained(here: Path) -> None:
    """A loss that reaches only the prior's own parameters is connected: it learns beside the lifter."""
    body = (
        "    def __init__(self, skeleton):\n        super().__init__(skeleton)\n"
        "        self.mean = torch.nn.Parameter(torch.zeros(()))\n"
        "    def loss(self, lift): return (self.mean - lift.scale.mean()).square()\n"
    )
    (here / "my_priors.py").write_text(f"import torch\nfrom uplift import Prior\n\nclass Ground(Prior):\n{body}\n")
    assert status_of(*words("trainer.max_steps=3", "priors.ground.weight=1e-3")) == 0
