"""A glTF file's animations: what moves, and its value at any moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.meshes.gltf_accessors import floats
from uplift.meshes.gltf_file import Document
from uplift.meshes.gltf_nodes import Nodes, unique_names

__all__ = ["Track", "at_moment", "read_animations"]

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}


@dataclass(frozen=True)
class Track:
    """One thing that moves: where a node is, how it is turned, its scale, or the weights of its morph targets."""

    node: int
    path: str
    how: str
    """STEP, LINEAR or CUBICSPLINE."""
    times_s: Float[np.ndarray, " keys"]
    values: Float[np.ndarray, "keys parts width"]
    """One part, or three of CUBICSPLINE: tangent before, value, tangent behind."""

    def at(self, time_s: float) -> Float[np.ndarray, " width"]:
        """Return the value at a moment; before the first and behind the last key it stands (specification, appendix C)."""
        after = int(np.searchsorted(self.times_s, time_s, side="right"))
        middle = self.values.shape[1] // 2
        if after == 0 or after == len(self.times_s):
            found = self.values[min(after, len(self.times_s) - 1), middle]
        elif self.how == "STEP":
            found = self.values[after - 1, 0]
        else:
            length = self.times_s[after] - self.times_s[after - 1]
            share = (time_s - self.times_s[after - 1]) / length
            start, end = self.values[after - 1], self.values[after]
            if self.how == "CUBICSPLINE":
                found = _spline(start, end, share, length)
            elif self.path == "rotation":
                found = _slerp(start[0], end[0], share)
            else:
                found = (1 - share) * start[0] + share * end[0]
        if self.path != "rotation":
            return found
        length = np.linalg.norm(found)
        return found / length if length > 1e-9 else np.array([0.0, 0.0, 0.0, 1.0])


def read_animations(document: Document, nodes: Nodes, targets: dict[int, int]) -> dict[str, list[Track]]:
    """Return the tracks of each animation; ``targets`` counts each node's morph targets. Raises UserError."""
    entries = document.listed("animations")
    names = unique_names([entry.get("name") for entry in entries], "animation")
    found = {}
    for name, entry in zip(names, entries, strict=True):
        samplers = document.objects(entry, "samplers", f"animation '{name}'")
        tracks = []
        for channel in document.objects(entry, "channels", f"animation '{name}'"):
            target = channel.get("target")
            if isinstance(target, dict) and "node" in target:  # one without is to be passed over
                tracks.append(
                    _track(document, samplers, channel.get("sampler"), target, f"animation '{name}'", targets)
                )
                if tracks[-1].node in nodes.fixed and tracks[-1].path != "weights":
                    raise document.wrong(f"animation '{name}' moves node {tracks[-1].node}, which has a matrix")
        found[name] = tracks
    return found


def at_moment(nodes: Nodes, tracks: Sequence[Track], time_s: float) -> tuple[Nodes, dict[int, np.ndarray]]:
    """Return the nodes as they are at a moment, and the weights of the morph targets that move."""
    state = {"translation": nodes.translation, "rotation": nodes.rotation, "scale": nodes.scale}
    state = {path: values.copy() for path, values in state.items()}
    weights = {}
    for track in tracks:
        if track.path == "weights":
            weights[track.node] = track.at(time_s)
        else:
            state[track.path][track.node] = track.at(time_s)
    return replace(nodes, **state), weights


def _track(
    document: Document, samplers: list[dict], index: Any, target: dict, whose: str, targets: dict[int, int]
) -> Track:
    if not isinstance(index, int) or not 0 <= index < len(samplers):
        raise document.wrong(f"{whose} refers to sampler {str(index)[:40]}, of {len(samplers)}")
    sampler, path = samplers[index], target.get("path")
    node = document.number_of("nodes", target["node"], whose)
    how = sampler.get("interpolation", "LINEAR")
    if how not in ("STEP", "LINEAR", "CUBICSPLINE") or path not in _KINDS:
        raise document.wrong(f"{whose} moves '{str(path)[:20]}' by '{str(how)[:20]}'")
    times = floats(document, sampler.get("input"), "SCALAR", f"the times of {whose}")[:, 0]
    values = floats(document, sampler.get("output"), _KINDS[path], f"the values of {whose}")
    if not len(times) or (np.diff(times) <= 0).any() or times[0] < 0:
        raise document.wrong(f"the times of {whose} do not grow")
    parts = 3 if how == "CUBICSPLINE" else 1
    width = targets.get(node, 0) if path == "weights" else values.shape[1]
    if values.size != len(times) * parts * width:
        raise document.wrong(f"{whose} has {values.size} values for {len(times)} moments of '{path}'")
    return Track(node, path, how, times, values.reshape(len(times), parts, width))


def _spline(start: np.ndarray, end: np.ndarray, share: float, length: float) -> np.ndarray:
    """Return the cubic Hermite spline between two keys (specification, appendix C.5)."""
    square, cube = share**2, share**3
    return (
        (2 * cube - 3 * square + 1) * start[1]
        + length * (cube - 2 * square + share) * start[2]
        + (3 * square - 2 * cube) * end[1]
        + length * (cube - square) * end[0]
    )


def _slerp(start: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """Return the quaternion on the shorter arc between two (Shoemake 1985)."""
    cosine = float(start @ end) / max(float(np.linalg.norm(start) * np.linalg.norm(end)), 1e-12)
    end = -end if cosine < 0 else end
    angle = np.arccos(min(abs(cosine), 1.0))
    if angle < 1e-4:
        return (1 - share) * start + share * end
    return (np.sin((1 - share) * angle) * start + np.sin(share * angle) * end) / np.sin(angle)
