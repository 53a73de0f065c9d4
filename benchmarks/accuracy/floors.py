"""Baselines that a lifter must beat: the 3D pose of the nearest training frame, and the observed 2D at depth 0.

``python -m benchmarks.accuracy.floors nearest TRAIN.npz TEST.npz OUT.npz skeleton=h36m17``, then
``uplift evaluate poses=OUT.npz data.test=TEST.npz skeleton=h36m17``. ``flat`` does not use TRAIN; ``nearest`` uses its
3D poses, so it is not a 2D-only method.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
import torch
from jaxtyping import Float, Int

from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.geometry.normalise import Normalised, normalise
from uplift.metrics.baselines import flat_depth
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["nearest", "nearest_rows"]

_TEST_ROWS, _TRAIN_ROWS = 1024, 32768


def main(words: list[str]) -> int:
    """Write the poses of one baseline; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.floors", description=__doc__)
    parser.add_argument("floor", choices=("nearest", "flat"))
    parser.add_argument("files", nargs=3, metavar="TRAIN.npz TEST.npz OUT.npz")
    parser.add_argument("skeleton", help="skeleton=NAME or skeleton=FILE.yaml")
    given = parser.parse_args(words)
    train_file, test_file, out = given.files
    try:
        skeleton = load_skeleton(given.skeleton.removeprefix("skeleton="))
        test, _ = clean(load_file(test_file, skeleton), skeleton, drop=False)
        if given.floor == "flat":
            pose, unit = flat_depth(test.keypoints, skeleton.root_index), "px"
        else:
            train, _ = clean(load_file(train_file, skeleton), skeleton)
            pose, unit = nearest(train, test, skeleton), train.unit
    except UserError as error:
        print(f"floors: {error}", file=sys.stderr)
        return 2
    arrays = {"pose": pose.astype(np.float32), "joint_names": np.array(skeleton.joints), "unit": np.array(unit)}
    np.savez(out, **(arrays | test.identity))  # pyright: ignore[reportArgumentType]
    print(f"wrote {out}: {len(pose):,} poses, unit {unit}")
    return 0


def nearest(train: PoseData, test: PoseData, skeleton: Skeleton) -> Float[np.ndarray, "frames joints 3"]:
    """Return for each test frame the true pose of the training frame with the nearest normalised 2D.

    Training frames with missing joints, in 2D or 3D, are not used. Raises UserError if there are no poses.
    """
    if train.pose is None:
        raise UserError(f"{train.source} has no 'pose', which the nearest neighbour needs.")
    complete = np.flatnonzero((train.confidence > 0).all(1) & np.isfinite(train.pose).all((1, 2)))
    if not len(complete):
        raise UserError(f"{train.source}: no frame has all joints.")
    known = _normalised(train.select(complete), skeleton).keypoints
    rows = nearest_rows(_normalised(test, skeleton).keypoints, torch.from_numpy(test.confidence > 0), known)
    return train.pose[complete[rows.numpy()]]


def _normalised(data: PoseData, skeleton: Skeleton) -> Normalised:
    keypoints, confidence = torch.from_numpy(data.keypoints), torch.from_numpy(data.confidence)
    return normalise(keypoints, (confidence > 0).float(), skeleton.root_index, count_root=False)


def nearest_rows(
    wanted: Float[torch.Tensor, "frames joints 2"],
    visible: torch.Tensor,
    known: Float[torch.Tensor, "others joints 2"],
) -> Int[torch.Tensor, " frames"]:
    """Return the index of the nearest of ``known`` for each frame, over the joints ``visible`` in it; exact."""
    weight = visible.to(wanted).repeat_interleave(2, 1)
    points, others = wanted.flatten(1) * weight, known.flatten(1)
    found = []
    for start in range(0, len(points), _TEST_ROWS):
        rows = slice(start, start + _TEST_ROWS)
        best = points.new_full((len(points[rows]),), torch.inf)
        row = torch.zeros(len(best), dtype=torch.long)
        for first in range(0, len(others), _TRAIN_ROWS):
            part = others[first : first + _TRAIN_ROWS]
            if bool(visible[rows].all()):
                distance = torch.cdist(points[rows], part).square()
            else:  # squared distances over each frame's visible joints, as products
                distance = weight[rows] @ part.square().mT - 2 * points[rows] @ part.mT
                distance = distance + points[rows].square().sum(1, keepdim=True)
            least, place = distance.min(1)
            row = torch.where(least < best, place + first, row)
            best = torch.minimum(least, best)
        found.append(row)
    return torch.cat(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
