"""From settings to masks: what is made up, read, chosen, labelled, held out, and what training may see of it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mask_files import blob, save

from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.data.formats.masks_npz import write_masks_npz
from uplift.data.load_masks import LoadedMasks, known_shapes, load_masks, truth_of_labelled, views_of
from uplift.data.masks import MaskData
from uplift.data.select import chosen_rows
from uplift.data.synthetic.masks import simulate_masks
from uplift.errors import UserError


@pytest.fixture(autouse=True)
def folder(here: Path) -> Path:
    return here


def loaded(*words: str, task: str = "masks") -> LoadedMasks:
    return load_masks(load_settings(task, [*words, "data.side=16"]))


@lru_cache
def several(items: int = 12, views: int = 3, seed: int = 5, family: str = "seats") -> MaskData:
    return simulate_masks(family, items, seed=seed, side=16, views_per_shape=views)


def rendered(name: str, *arguments: int | str) -> MaskData:
    """Write masks with truth to a file and return them."""
    data = several(*arguments)  # type: ignore[arg-type]
    write_masks_npz(data, name)
    return data


def test_made_up_masks_are_the_same_for_the_same_seed_and_the_test_shows_other_shapes() -> None:
    words = ("data.simulate=30", "data.family=chairs")
    one, again, other = loaded(*words), loaded(*words), loaded(*words, "seed=1")
    assert one.test is not None
    assert again.test is not None
    np.testing.assert_array_equal(one.train.masks, again.train.masks)
    np.testing.assert_array_equal(one.test.masks, again.test.masks)
    assert (one.train.masks != other.train.masks).any()
    assert (len(one.train), len(one.test)) == (30, 3)
    assert one.train.truth is not None
    assert one.test.truth is not None
    assert len(set(one.train.truth.shape.tolist())) == 30  # one view of each
    corners = {mesh.vertices.tobytes() for mesh in one.train.truth.meshes}
    assert not corners & {mesh.vertices.tobytes() for mesh in one.test.truth.meshes}
    assert one.notes[0] == "train: 30 masks from simulated chairs"
    assert one.notes[-1] == "test: 3 masks from simulated chairs, other shapes"


@given(mean=st.floats(-60, 85), sd=st.floats(0, 30), distance=st.floats(2, 50))
@settings(max_examples=30)
def test_cameras_are_those_that_the_lifter_is_told_of(mean: float, sd: float, distance: float) -> None:
    chosen = Settings()
    chosen.shape.elevation_deg, chosen.shape.distance = (mean, sd), distance
    views = views_of(chosen)
    assert (views.elevation_mean_deg, views.elevation_sd_deg) == (mean, sd)
    low, high = views.elevation_deg
    assert low <= max(mean - 2 * sd, -90)
    assert high >= min(mean + 2 * sd, 90)
    assert views.distance[0] >= 2
    assert views.distance[0] <= distance <= views.distance[1]


def test_without_gravity_cameras_look_from_everywhere() -> None:
    assert not views_of(load_settings("masks", ["shape.gravity=false"])).upright
    assert views_of(load_settings("masks")).upright


@given(st.floats(0.05, 1), st.integers(0, 20))
@settings(max_examples=40)
def test_a_fraction_takes_all_views_of_a_shape_or_none_and_grows(fraction: float, seed: int) -> None:
    data = several(24, 3)
    assert data.truth is not None
    if round(fraction * 8) == 0:
        with pytest.raises(UserError, match="less than one"):
            chosen_rows(data, {"fraction": fraction}, seed)
        return
    rows = chosen_rows(data, {"fraction": fraction}, seed)
    taken = set(data.truth.shape[rows].tolist())
    assert len(taken) == round(fraction * 8)
    np.testing.assert_array_equal(rows, np.isin(data.truth.shape, list(taken)))
    more = chosen_rows(data, {"fraction": min(1.0, fraction + 0.3)}, seed)
    assert (more | ~rows).all()


def test_without_known_shapes_each_mask_is_one() -> None:
    data = several(24, 3).without_truth()
    assert chosen_rows(data, {"fraction": 0.25}).sum() == 6


def test_choice_and_hold_out_by_category() -> None:
    data = rendered("seats.npz", 30, 1, 3)
    assert data.category is not None
    kinds, counts = np.unique(data.category, return_counts=True)
    held, size = kinds[0], int(counts[0])
    found = loaded("data.train=seats.npz", f"data.hold_out.categories={held.upper()}")
    assert found.test is not None
    assert set(found.test.category.tolist()) == {held}  # type: ignore[union-attr]
    assert (len(found.test), len(found.train)) == (size, 30 - size)
    both = loaded("data.train=seats.npz", f"data.select.categories={kinds[0]},{kinds[1]}", "data.select.fraction=0.5")
    assert len(both.train) == round(0.5 * int(counts[:2].sum()))
    assert len(loaded("data.train=seats.npz", f"data.category={held}").train) == size


def test_labels_are_only_those_that_settings_name() -> None:
    data = several(12, 3)
    write_masks_npz(replace(data, labelled=np.arange(12) < 6), "marked.npz")
    plain = loaded("data.train=marked.npz", "data.test=marked.npz")
    assert plain.train.labelled is None
    assert plain.test is not None
    assert plain.test.labelled is None
    assert any("6 masks are marked as labelled in the file; not used" in note for note in plain.notes)
    some = loaded("data.train=marked.npz", "data.labelled.fraction=0.25")
    assert some.train.labelled is not None
    assert some.train.labelled.sum() == 3
    assert len(some.train) == 12
    assert "labelled: 3 of these masks, in 3D" in some.notes
    only = loaded("data.train=marked.npz", "data.labelled.fraction=0.25", "data.labelled.only=true")
    assert len(only.train) == 3
    assert only.train.labelled is not None
    assert only.train.labelled.all()


def test_labelled_masks_of_another_file_join_masks_without_truth() -> None:
    for number in range(3):
        save(Path(f"photos/{number}.png"), (255 * blob(seed=number)).astype(np.uint8))
    other = rendered("known.npz", 6, 2)
    found = loaded("data.train=photos", "data.labelled.file=known.npz")
    train = found.train
    assert len(train) == 9
    assert train.labelled is not None
    assert train.labelled.tolist() == [False] * 3 + [True] * 6
    known = known_shapes(train)
    assert known is not None
    assert known.truth is not None
    assert other.truth is not None
    np.testing.assert_allclose(known.truth.view, other.truth.view, atol=1e-6)
    for row in range(6):
        mesh = known.truth.meshes[known.truth.shape[row]]
        np.testing.assert_allclose(mesh.vertices, other.truth.meshes[other.truth.shape[row]].vertices, atol=1e-6)
    only = loaded("data.train=photos", "data.labelled.file=known.npz", "data.labelled.only=true")
    assert len(only.train) == 6


@given(st.lists(st.booleans(), min_size=12, max_size=12))
@settings(max_examples=30)
def test_training_sees_the_truth_of_labelled_items_alone(flags: list[bool]) -> None:
    data, labelled = several(12, 3), np.array(flags)
    assert data.truth is not None
    seen = truth_of_labelled(replace(data, labelled=labelled))
    if not labelled.any():
        assert seen.truth is None
        assert seen.labelled is None
        return
    assert seen.truth is not None
    np.testing.assert_array_equal(np.isfinite(seen.truth.scale), labelled)
    np.testing.assert_array_equal(seen.truth.view[~labelled], np.repeat(np.eye(3)[None], (~labelled).sum(), 0))
    allowed = {data.truth.meshes[shape].vertices.tobytes() for shape in data.truth.shape[labelled].tolist()}
    assert {mesh.vertices.tobytes() for mesh in seen.truth.meshes} - {b""} == allowed
    for row in np.flatnonzero(labelled):
        mesh = seen.truth.meshes[seen.truth.shape[row]]
        np.testing.assert_array_equal(mesh.vertices, data.truth.meshes[data.truth.shape[row]].vertices)
        np.testing.assert_array_equal(seen.truth.view[row], data.truth.view[row])
    whole = LoadedMasks(replace(data, labelled=labelled), data, []).for_training()
    assert whole.test is not None
    assert whole.test.truth is None


def test_files_of_a_task_lie_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("0", "1"):
        save(Path(f"mine/masks/{name}.png"), (255 * blob(seed=int(name))).astype(np.uint8))
        save(Path(f"mine/photos/{name}.jpg"), np.zeros((60, 80, 3), np.uint8))
    Path("mine/task.yaml").write_text("extends: masks\ndata: {train: masks, images: photos, side: 24}\n")
    found = load_masks(load_settings("mine/task.yaml"))
    assert found.train.side == 24
    assert found.train.images is not None
    assert all(Path(photo).is_file() for photo in found.train.images.tolist())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("data.train=seats.npz", "data.select.categories=sofaa"), "no mask with category 'sofaa'"),
        (("data.train=flat.npz", "data.select.categories=sofa"), "the file has no 'category'"),
        (("data.train=flat.npz", "data.labelled.fraction=1"), "holds no true shapes to learn from"),
        (("data.train=seats.npz", "data.labelled.file=flat.npz"), "holds no true shapes to learn from"),
        (("data.train=seats.npz", "data.labelled.file=gone.npz"), "No file"),
        (("data.train=seats.npz", "data.test=seats.npz", "data.hold_out.fraction=0.5"), "data.test and data.hold_out"),
        (("data.train=seats.npz", "data.hold_out.fraction=1"), "leaves no mask to train on"),
        (("data.train=seats.npz", "data.select.fraction=1.5"), "above 0 and at most 1"),
        (("data.train=seats.npz,photos",), "of several kinds"),
        (("data.train=seats.npz", "data.format=coco"), "seats.npz"),
        (("data.train=seats.npz", "data.test=nowhere.npz"), "No file"),
    ],
)
def test_what_is_refused(words: tuple[str, ...], says: str) -> None:
    rendered("seats.npz", 6, 1)
    write_masks_npz(replace(several(6, 1).without_truth(), category=None), "flat.npz")
    save(Path("photos/0.png"), (255 * blob()).astype(np.uint8))
    with pytest.raises(UserError) as caught:
        loaded(*words)
    assert says in str(caught.value)
