"""The verb simulate: keypoints and exact poses of a made-up body, to rehearse a skeleton with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["simulate"]


def simulate(
    skeleton: str | Path | Skeleton,
    output: str | Path | None = None,
    *,
    frames: int = 20000,
    seed: int = 0,
    **options: Any,
) -> PoseData:
    """Simulate ``frames`` frames of ``skeleton`` and write them to ``output`` (.npz), if given.

    ``options`` are those of `uplift.simulator.simulate`.

    Raises:
        UserError: a skeleton without proportions, an output that exists or is no .npz.
    """
    from uplift.simulator import simulate as run
    from uplift.writers.keypoints import write_keypoints

    if output is not None:
        output = Path(output)
        if output.suffix.lower() != ".npz":
            raise UserError(f"output={output}: simulated data is written as .npz.")
        if output.exists():
            raise UserError(f"{output} exists already and is not overwritten: remove it or choose another name.")
        if not output.absolute().parent.is_dir():
            raise UserError(f"output={output}: no folder {output.absolute().parent}. Create it first.")
    if seed < 0:
        raise UserError(f"seed={seed}: expected a whole number of at least 0.")
    if frames < 1:
        raise UserError(f"frames={frames}: expected at least 1.")
    chosen = skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
    data = run(chosen, frames, seed=seed, **options)
    if output is not None:
        write_keypoints(data, output)
    return data
