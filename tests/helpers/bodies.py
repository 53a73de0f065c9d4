"""Small bodies for the tests: random poses of a shipped skeleton's tree, seen by random cameras."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uplift.cli.main import main
from uplift.skeleton import load_skeleton

FOCAL_PX, CENTRE_PX, DISTANCE_MM = 1145.0, 500.0, 5000.0

# Small and fast, but every part of a fit with both stages runs.
QUICK = (
    "lifter.options.units=16", "lifter.options.blocks=1", "priors.critic.units=16", "priors.critic.blocks=1",
    "priors.flow.steps=3", "priors.flow.units=8",
    "teacher.batch_size=16", "student.batch_size=16", "student.rounds=1", "student.refine.iterations=2",
    "teacher.share=0.4", "student.share=0.6", "trainer.max_time=null",
    "trainer.max_steps=10", "trainer.log_every=2", "trainer.threads=1",
)  # fmt: skip


def body_arrays(frames: int = 60, seed: int = 0, skeleton: str = "h36m17", film: bool = True) -> dict[str, Any]:
    """Return the arrays of a data file: random poses of the skeleton's tree with exact projections.

    Ten frames make a clip; without ``film`` frames are independent.
    """
    return {name: value.copy() for name, value in _arrays(frames, seed, skeleton, film).items()}


@lru_cache
def _arrays(frames: int, seed: int, skeleton: str, film: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    tree = load_skeleton(skeleton)
    pose = np.zeros((frames, len(tree.joints), 3))
    for parent, child in _from_the_root(tree):
        length = 150 + 200 * ((tree.index(child) * 37) % 11) / 11
        if film:  # a limb swings about one direction
            swing = rng.normal(size=(-(-frames // 10), 3)).repeat(10, 0)[:frames] + rng.normal(0, 0.15, (frames, 3))
        else:
            swing = rng.normal(size=(frames, 3))
        step = swing + [0, 1.0, 0]
        pose[:, tree.index(child)] = pose[:, tree.index(parent)] + length * step / np.linalg.norm(
            step, axis=1, keepdims=True
        )
    root = np.stack([*rng.normal(0, 300, (2, frames)), np.full(frames, DISTANCE_MM)], 1)
    seen = pose + root[:, None]
    return {
        "keypoints": (seen[..., :2] / seen[..., 2:] * FOCAL_PX + CENTRE_PX).astype(np.float32),
        "joint_names": np.array(tree.joints),
        "pose": pose.astype(np.float32),
        "root": root.astype(np.float32),
        "tilt_deg": rng.normal(8, 2, frames).astype(np.float32),
        "subject": np.array([f"S{1 + row * 3 // frames}" for row in range(frames)]),
        "action": np.array(["walk" if row % 20 < 10 else "sit down" for row in range(frames)]),
        "sequence": np.array([f"clip{row // 10:02d}" for row in range(frames)]),
        "camera": np.zeros(frames, np.int8),
        "frame": np.arange(frames) % 10,
        "fps": np.float32(10),
        "image_size": np.array([1000, 1000]),
        "focal_px": np.float32(FOCAL_PX),
    }


def _from_the_root(tree: Any) -> list[tuple[str, str]]:
    """Return the bones ordered so that every parent is placed before its child."""
    placed, left, order = {tree.root}, list(tree.bones), []
    while left:
        ready = [(a, b) for a, b in left if (a in placed) != (b in placed)]
        order += [(a, b) if a in placed else (b, a) for a, b in ready[:1]]
        placed |= set(ready[0]) if ready else set()
        left = [bone for bone in left if not set(bone) <= placed]
    return order


def write_body(path: Path, frames: int = 60, seed: int = 0, skeleton: str = "h36m17", **changes: Any) -> Path:
    """Write `body_arrays` to ``path``; ``changes`` replace arrays, None leaves one out."""
    arrays = {**body_arrays(frames, seed, skeleton), **changes}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def own_data(path: Path, **rest: Any) -> list[str]:
    """Return the arguments of a quick fit on a small body written to ``path``."""
    return ["skeleton=h36m17", f"data.train={write_body(path, **rest)}", *QUICK]


def last_words(*words: str) -> list[str]:
    """Return the words without repeated keys: later ones replace those of defaults such as `QUICK`."""
    last = {word.partition("=")[0] if "=" in word else f"{place}": place for place, word in enumerate(words)}
    return [words[place] for place in sorted(last.values())]


def status_of(*words: str) -> int:
    """Run a command with `last_words` in this process and return its exit status."""
    try:
        return main(last_words(*words))
    except SystemExit as stop:
        return int(stop.code or 0)


def refusal(capsys: Any, *words: str) -> str:
    """Return the message of a command that must be rejected: status 2, one error, no traceback."""
    capsys.readouterr()
    status = status_of(*words)
    message = capsys.readouterr().err
    assert status == 2, message
    assert message.startswith("uplift: "), message
    assert message.count("uplift: ") == 1
    assert "Traceback" not in message
    return message
