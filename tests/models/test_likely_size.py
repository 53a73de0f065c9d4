"""Sizes that cannot be in millimetres are told, with the number and the unit that fits."""

from __future__ import annotations

import pytest

from uplift.models.likely_size import odd_size, small_size
from uplift.skeleton import Skeleton, load_skeleton

HUMAN = load_skeleton("coco17")
SHANK = ("right_knee", "right_ankle")
BEETLE = Skeleton("beetle", ("head", "thorax", "tail"), "thorax", (("thorax", "head"), ("thorax", "tail")))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"height_mm": 1.75}, "height_mm=1.75 makes coco17, a human, 1.75 mm high, expected 300 to 3,000 mm: metres? Then "
                              "give height_mm=1750"),
        ({"height_mm": 175.0}, "centimetres? Then give height_mm=1750"),
        ({"height_mm": 175000.0}, "175,000 mm high, expected 300 to 3,000 mm"),
        ({"bone": SHANK, "bone_mm": 0.43}, "metres? Then give bone_mm=430"),
        ({"bone": SHANK, "bone_mm": 43.0}, "centimetres? Then give bone_mm=430"),
        ({"camera_height_mm": 1.5}, "has the camera 1.5 mm above the ground that humans stand on, expected 50 to 1,000,000 "
                                    "mm: metres? Then give camera_height_mm=1500"),
    ],
)  # fmt: skip
def test_odd_sizes_are_told(given: dict, says: str) -> None:
    told = odd_size(HUMAN, given)
    assert told is not None
    assert told.startswith("WARNING: ")
    assert says in told


@pytest.mark.parametrize(
    "name", ["coco17", "h36m17", "mediapipe33", "openpose25", "coco_wholebody133", "mpi_inf_3dhp28"]
)
def test_sizes_of_people_are_not(name: str) -> None:
    skeleton = load_skeleton(name)
    for height in (500, 1200, 1750, 2100):  # a newborn, a child, adults
        assert odd_size(skeleton, {"height_mm": float(height)}) is None
    assert odd_size(skeleton, {"height_mm": 1.75}) is not None
    assert odd_size(skeleton, {"camera_height_mm": 1500.0}) is None
    assert odd_size(skeleton, {}) is None


def test_shanks_of_people_are_not() -> None:
    for shank in (150, 430, 520):  # a small child, adults
        assert odd_size(HUMAN, {"bone": SHANK, "bone_mm": float(shank)}) is None


def test_of_other_bodies_only_what_is_very_small_is_told() -> None:
    given = {"bone": ("head", "thorax"), "bone_mm": 0.6}
    assert odd_size(BEETLE, given) == "WARNING: bone_mm=0.6 is 0.6 mm: if metres are meant, give bone_mm=600"
    assert odd_size(BEETLE, given | {"bone_mm": 6.0}) is None
    assert small_size({"height_mm": None, "length_mm": 0.45}) is not None
    assert small_size({"height_mm": 450, "smooth": 2}) is None


def test_five_millimetres_are_not_small() -> None:
    assert small_size({"bone_mm": 5.0}) is None and small_size({"bone": 1.0, "bone_mm": None}) is None
    assert "bone_mm=4990" in str(small_size({"height_mm": 1700.0, "bone_mm": 4.99}))
