"""Which skeletons are known to be human: those with most of COCO's names."""

from __future__ import annotations

import numpy as np
import pytest

from uplift.data.human import standing_human
from uplift.skeleton import Skeleton, load_skeleton


@pytest.mark.parametrize(("count", "known"), [(11, False), (12, True)])
def test_twelve_joints_of_coco_make_a_human_and_others_have_no_place(count: int, known: bool) -> None:
    usual = load_skeleton("coco17")
    names = [joint for joint in usual.joints if joint not in usual.midpoints][-count:]
    joints = ["tail", *names]
    body = Skeleton.from_dict(
        {"joints": joints, "root": "tail", "bones": [["tail", name] for name in names], "gravity": True}
    )
    places = standing_human(body)
    assert np.isnan(places[0]).all() and np.isfinite(places[1:]).all() == known
    if known:
        assert (
            places[joints.index("left_ankle"), 1] - places[joints.index("left_shoulder"), 1] > 0.6
        )  # body heights, y down
