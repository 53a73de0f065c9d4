"""Every dataclass of rows: selecting, joining and moving them reaches every field that holds rows."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from jaxtyping import Float, Shaped

import uplift
from uplift.data.mask_tensors import MaskSet
from uplift.data.masks import MaskData, Placed
from uplift.data.poses import PoseData
from uplift.data.samples import SHARED, TRUTH, Samples
from uplift.data.tensors import Batch, TrainingSet
from uplift.models.ground import Ground
from uplift.models.lifter import Lifted
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.models.shape_lifter import LiftedShapes
from uplift.models.view_hypotheses import ViewHypotheses
from uplift.skeleton import load_skeleton
from uplift.training.augmentation import ShownViews
from uplift.training.pseudo_labels import PseudoPoses

N, J, SIDE = 6, 17, 8
SKELETON = load_skeleton("h36m17")
RNG = np.random.default_rng(0)


def a(*shape: int) -> np.ndarray:
    return RNG.random((N, *shape)).astype(np.float32)


def t(*shape: int) -> torch.Tensor:
    return torch.rand(N, *shape)


def placed() -> Placed:
    return Placed([], np.arange(N), a(3, 3), a(), a(2), a())


MASKS = RNG.integers(0, 255, (N, SIDE, SIDE)).astype(np.uint8)
NAMES = [f"mask {row}" for row in range(N)]
TEXT = np.array(list("abcdef"))
# Every field is known, so that one that is not selected shows.
EXAMPLES: dict[type[Samples], Samples] = {
    PoseData: PoseData(
        a(J, 2), a(J), SKELETON.joints, a(J, 3), a(3), identity={"frame": np.arange(N), "subject": TEXT}, tilt_deg=a(),
        gravity=a(3), root_filled=a() > 0.5, labelled=a() > 0.5, masks=MASKS, mask_box=a(3), lens=np.zeros(N, int),
    ),
    Placed: placed(),
    MaskData: MaskData(MASKS, NAMES, a(2), a(), TEXT, TEXT, placed(), a() > 0.5, extra={"area": a(2)}),
    TrainingSet: TrainingSet(
        SKELETON, t(J, 2), t(J), t(), t(), torch.arange(N), torch.arange(N) > 0, torch.arange(N), 10.0, t(3, 3), t(J, 3), t(),
        t(), torch.from_numpy(MASKS), t(3, 3), t() > 0.5,
    ),
    Batch: Batch(t(J, 2), t(J), t(), t(), t(J, 3), t(), t(), torch.from_numpy(MASKS), t(3, 3), torch.arange(N), t() > 0.5),
    MaskSet: MaskSet(
        t(8, 8), t(2), torch.from_numpy(MASKS), t() > 0.5, t(3, 3), t(), t(2), torch.arange(N), torch.rand(2, 4, 4, 4)
    ),
    ViewHypotheses: ViewHypotheses(t(2), t(2), t(2), t(2), t(2, 2), t(2)),
    Prediction: Prediction(
        a(J, 3), a(J, 3), "mm", a(J, 2), a(J), SKELETON.joints, SKELETON, a(), {"frame": np.arange(N)}, truth=a(J, 3),
        uncertainty=a(J), root=a(3), filled=a(J) > 0.5, gravity=a(3), hypotheses=a(2, J, 3), weights=a(2),
        ground=Ground(a(3), a(3), a(J) > 0.5),
    ),
    Ground: Ground(a(3), a(3), a(J) > 0.5),
    ShapePrediction: ShapePrediction(
        a(4, 4, 4), a(3, 3), a(), a(2), a(), MASKS, NAMES, a(2), a(), images=TEXT, uncertainty=a(4, 4, 4),
        probability=a(), second_view=a(3, 3), second_probability=a(),
    ),
    PseudoPoses: PseudoPoses(SKELETON, t(J, 3), t(3), t(), t(J), t(J, 2), t() > 0.5, t() > 0.5),
    ShownViews: ShownViews(t(J, 2), t(J), t(J, 2), t(J, 3), t(), t(3), t(), t(J), t(), t() > 0.5, t() > 0.5),
    Lifted: Lifted(t(J, 3), t(), t(J, 2), t(J), t(3), t(), t(12)),
    LiftedShapes: LiftedShapes(t(4, 4, 4), t(4, 4, 4), t(3, 3), t(), t(2), t(), t(), t(3, 3), t()),
}  # fmt: skip
examples = pytest.mark.parametrize("samples", EXAMPLES.values(), ids=lambda samples: type(samples).__name__)
# What a selection gives new numbers, by class.
RENUMBERED = {TrainingSet: {"clip", "body", "follows"}}


def rows_of(samples: Samples) -> dict[str, Any]:
    """Return every leaf that holds rows, by a name of its own."""
    found: dict[str, Any] = {}
    for item in fields(samples):
        value = getattr(samples, item.name)
        if item.metadata.get("shared") or item.name in RENUMBERED.get(type(samples), ()):
            continue
        if isinstance(value, Samples):
            found |= {f"{item.name}.{name}": leaf for name, leaf in rows_of(value).items()}
        elif isinstance(value, dict):
            found |= {f"{item.name}[{key}]": leaf for key, leaf in value.items()}
        elif isinstance(value, np.ndarray | torch.Tensor | list):
            found[item.name] = value
    return found


def same(one: Samples, other: Samples) -> bool:
    ours, theirs = rows_of(one), rows_of(other)
    return ours.keys() == theirs.keys() and all(np.array_equal(ours[name], theirs[name]) for name in ours)


def every_class() -> set[type[Samples]]:
    for module in pkgutil.walk_packages(uplift.__path__, "uplift."):
        if module.name.startswith(("uplift.data", "uplift.models", "uplift.training", "uplift.metrics")):
            importlib.import_module(module.name)
    return {cls for cls in Samples.__subclasses__() if cls.__module__.startswith("uplift.")}


def test_every_class_of_samples_has_an_example():
    assert every_class() == set(EXAMPLES)


@examples
def test_an_example_knows_every_field_of_rows(samples: Samples):
    unknown = {item.name for item in fields(samples) if getattr(samples, item.name) is None}
    assert not {name for name in unknown if "[np.ndarray" in str(type(samples).__dataclass_fields__[name].type)}
    assert not {name for name in unknown if "Tensor" in str(type(samples).__dataclass_fields__[name].type)}


@examples
@pytest.mark.parametrize("rows", [[4, 0, 0], [False, True, True, False, False, True], slice(1, 4), []], ids=str)
def test_selecting_reaches_every_row(samples: Samples, rows: Any):
    if not isinstance(rows, slice):
        rows = np.array(rows, dtype=bool if len(rows) == N else int)
    taken = np.arange(N)[rows]
    tensors = isinstance(samples, TrainingSet) and not isinstance(rows, slice)
    chosen = samples.select(torch.from_numpy(rows) if tensors else rows)
    assert len(samples) == N and len(chosen) == len(taken)
    before, after = rows_of(samples), rows_of(chosen)
    assert before.keys() == after.keys()
    for name, leaf in before.items():
        assert list(map(str, after[name])) == [str(leaf[row]) for row in taken], name


@examples
def test_selecting_twice_is_selecting_once(samples: Samples):
    first, second = torch.tensor([5, 3, 3, 0]), torch.tensor([2, 0, 3])
    assert same(samples.select(first).select(second), samples.select(first[second]))


@examples
def test_parts_join_to_what_they_were(samples: Samples):
    parts = [samples.select(slice(0, 2)), samples.select(slice(2, N))]
    joined = type(samples).concat(parts)
    assert len(joined) == N and same(joined, samples)


@examples
def test_moving_reaches_every_tensor(samples: Samples):
    moved = samples.to("meta")
    tensors = [getattr(moved, item.name) for item in fields(moved)]
    assert all(value.device.type == "meta" for value in tensors if isinstance(value, torch.Tensor))
    assert same(samples.to("cpu"), samples)


@pytest.mark.parametrize("samples", [EXAMPLES[PoseData], EXAMPLES[MaskData]], ids=["poses", "masks"])
def test_nothing_from_3d_is_left_without_truth(samples: Samples):
    bare = samples.without_truth()
    gone = {name for name, value in vars(bare).items() if value is None and getattr(samples, name) is not None}
    assert gone == (
        {"pose", "root", "tilt_deg", "gravity", "labelled"} if isinstance(samples, PoseData) else {"truth", "labelled"}
    )
    assert (len(bare) == N and bare.without_truth() == bare) or same(bare, bare.without_truth())


@dataclass
class Walk(Samples):
    """A class of a user's own."""

    step: Float[np.ndarray, "steps joints 2"]
    names: list[str]
    known: np.ndarray | None = None
    table: Shaped[np.ndarray, "3 any"] | None = field(default=None, metadata=SHARED)
    more: dict[str, Shaped[np.ndarray, "steps ..."]] = field(default_factory=dict)
    truth: Float[np.ndarray, "steps joints 3"] | None = field(default=None, metadata=TRUTH)


WALK = Walk(
    np.zeros((4, 5, 2)), list("abcd"), np.arange(4), np.zeros((3, 7)), {"x": np.zeros((4, 9))}, np.zeros((4, 5, 3))
)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, ""),
        ({"truth": np.zeros((4, 6, 3))}, "'truth' has shape (4, 6, 3), expected (4, 5, 3)"),
        ({"truth": np.zeros((4, 5, 2))}, "'truth' has shape (4, 5, 2), expected (4, 5, 3)"),
        ({"truth": np.zeros((4, 5))}, "'truth' has shape (4, 5), expected (4, 5, 3)"),
        ({"step": np.zeros((4, 5))}, "'step' has shape (4, 5), expected (4, 5, 2)"),
        ({"names": ["a"]}, "'names' has shape (1,), expected (4,)"),
        ({"known": np.zeros((3, 2))}, "'known' has shape (3, 2), expected (4, 2)"),
        ({"more": {"x": np.zeros((5, 9))}}, "'x' has shape (5, 9), expected (4, 9)"),
        ({"table": np.zeros((9, 9))}, ""),
    ],
)
def test_the_first_array_of_another_shape_is_named(change: dict, says: str):
    walk = replace(WALK, **change)
    assert walk.misfit() == says


def test_sizes_can_be_given():
    assert WALK.misfit(joints=5) == ""
    assert WALK.misfit(joints=6) == "'step' has shape (4, 5, 2), expected (4, 6, 2)"


def test_what_only_some_parts_know_is_blank_for_the_others():
    both = Walk.concat([WALK, replace(WALK, known=None, truth=None, more={})])
    assert both.known is not None and both.known.tolist() == [0, 1, 2, 3, 0, 0, 0, 0]
    assert both.truth is not None and np.isnan(both.truth[4:]).all() and not both.truth[:4].any()
    assert both.more == {} and both.table is WALK.table and both.names == [*"abcd", *"abcd"]
    assert Walk.concat([WALK, WALK], known=None).known is None


def test_frames_follow_only_those_that_are_still_before_them():
    chosen = EXAMPLES[TrainingSet].select(torch.tensor([0, 1, 3, 4, 2]))
    assert chosen.follows.tolist() == [False, True, False, True, False]  # type: ignore[attr-defined]
