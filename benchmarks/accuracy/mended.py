"""What lifting the frames of a clip together changes: flips made and mended, depth signs spoilt and mended, clips better and worse.

``python -m benchmarks.accuracy.mended RUN TEST.npz --json FILE``
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks.common import write_json
from uplift.data.clean import clean
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.metrics.scores import Scores, match_poses, score

__all__ = ["mended"]


def mended(run: str | Path, test: str | Path) -> dict[str, float]:
    """Return how the predictions of a run on ``test`` differ between frames lifted together and one by one.

    ``flips_made`` are frames that single-frame lifting had right side round (`facing`) and the clip's solution has
    not, ``flips_mended`` the reverse; ``signs_made`` and ``signs_mended`` the same of single bones that leave the
    image plane; ``clips_better`` and ``clips_worse`` go by the clip's mean `p_mpjpe`. Raises UserError without truth.
    """
    from uplift.models.model import load_poses

    model = load_poses(run)
    truth, _ = clean(load_file(test, model.skeleton), model.skeleton)
    found: dict[bool, Scores] = {}
    kept = np.ones(len(truth), bool)
    for refine in (False, True):
        matched, kept, _ = match_poses(model.predict(truth, refine=refine), truth, model.skeleton)
        found[refine] = score(matched)
    return differences(found[False], found[True], np.unique(truth.clips()[kept], return_inverse=True)[1])


def differences(single: Scores, together: Scores, clip: np.ndarray) -> dict[str, float]:
    """Return the figures of `mended` out of the scores of the same frames; ``clip`` numbers their clips from 0."""
    before, after = single.frames["facing"], together.frames["facing"]
    spoilt, better = ((together.wrong > single.wrong).sum(), (together.wrong < single.wrong).sum())
    size = np.bincount(clip)
    errors = [np.bincount(clip, of.frames["p_mpjpe"]) / size for of in (single, together)]
    several = size > 1
    return {
        "frames": len(clip),
        "flips_made": int((before > after).sum()),
        "flips_mended": int((before < after).sum()),
        "signs": int(np.isfinite(together.wrong).sum()),
        "signs_made": int(spoilt),
        "signs_mended": int(better),
        "clips": int(several.sum()),
        "clips_worse": int((several & (errors[1] > errors[0])).sum()),
        "clips_better": int((several & (errors[1] < errors[0])).sum()),
    }


def main() -> int:
    """Print the figures of a run on a test file; with ``--json`` also write them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.mended", description=__doc__)
    parser.add_argument("run", metavar="RUN")
    parser.add_argument("test", metavar="TEST.npz")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the results to this file")
    given = parser.parse_args()
    try:
        found = mended(given.run, given.test)
    except UserError as error:
        print(f"mended: {error}", file=sys.stderr)
        return 2
    if given.json:
        write_json(given.json, found)
    print("\n".join(f"{name:14}{value:>10,}" for name, value in found.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
