"""Proof that a 2D-only fit looks at no 3D: noise in its place, or nothing, changes no bit of the weights."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import torch
from bodies import QUICK, body_arrays, status_of, write_body

RNG = np.random.default_rng(7)
TRUTH = {
    "true": {},
    "noise": {
        "pose": RNG.normal(0, 1e4, (60, 17, 3)),
        "root": RNG.normal(0, 1e6, (60, 3)),
        "tilt_deg": RNG.uniform(-90, 90, 60),
        "roll_deg": np.random.default_rng(8).uniform(-90, 90, 60),
    },
    "nan": {"pose": np.full((60, 17, 3), np.nan), "root": np.full((60, 3), np.nan), "tilt_deg": np.full(60, np.nan)},
    "absent": {"pose": None, "root": None, "tilt_deg": None},
}


def fitted(folder: Path, *overrides: str, **changes) -> tuple[dict[str, torch.Tensor], str]:
    """Return the weights and metrics of a quick fit of both stages."""
    folder.mkdir()
    write_body(folder / "a.npz", **changes)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert status_of("fit", "skeleton=h36m17", "data.train=a.npz", *QUICK, *overrides) == 0
    run = folder / "runs" / "h36m17" / "last"
    return torch.load(run / "lifter.pt", weights_only=True)["state"], (run / "metrics.csv").read_text()


@pytest.mark.parametrize(
    ("overrides", "kinds"),
    [((), TRUTH), (("lifter.intrinsics=off", "priors.consistency.weight=0.5"), ("true", "noise"))],
)
def test_3d_in_the_train_file_changes_no_bit(tmp_path: Path, overrides: tuple[str, ...], kinds: Iterable[str]) -> None:
    results = {kind: fitted(tmp_path / kind, *overrides, **TRUTH[kind]) for kind in kinds}
    weights, metrics = results.pop("true")
    for name, (other, other_metrics) in results.items():
        assert other.keys() == weights.keys()
        assert all(torch.equal(other[key], weights[key]) for key in weights), name
        assert other_metrics == metrics, name


def test_the_proof_can_fail(tmp_path: Path) -> None:
    """The same comparison tells a change of one 2D coordinate, and of the seed."""
    weights, _ = fitted(tmp_path / "a")
    keypoints = body_arrays()["keypoints"]
    keypoints[:, 3, 0] += 1
    for name, (overrides, changes) in {"b": ((), {"keypoints": keypoints}), "c": (("seed=1",), {})}.items():
        other, _ = fitted(tmp_path / name, *overrides, **changes)
        assert any(not torch.equal(other[key], weights[key]) for key in weights), name
