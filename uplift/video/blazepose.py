"""BlazePose and BlazeHand: bodies and hands in a frame, by MediaPipe's networks and none of its code.

Bazarevsky et al. 2020 (arXiv:2006.10204), Zhang et al. 2020 (arXiv:2006.10214). A network finds bodies (or palms) in the
whole frame, another the landmarks of each in an upright square around it. In the next frame the square comes from the
landmarks of this one, and the first network is only asked where someone was lost, or may have come.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from PIL import Image

from uplift.data.formats.layouts import HAND21, POSE33
from uplift.errors import UserError
from uplift.video.detector import Detector
from uplift.video.weights import find_network

__all__ = ["BlazeHand", "BlazePose"]


class _Region(NamedTuple):
    """A square in the frame: its middle and side, px, and the angle that turns its content upright, radians."""

    x: float
    y: float
    side: float
    angle: float

    def to_frame(self, points: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Return points given in shares of the square as pixels of the frame."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        across, down = (np.moveaxis(points, -1, 0) - 0.5) * self.side
        return np.stack([self.x + cos * across - sin * down, self.y + sin * across + cos * down], -1)

    def shows(self, image: UInt8[np.ndarray, "height width 3"]) -> bool:
        """Return whether any of the frame is in the square."""
        height, width = image.shape[:2]
        gap = max(-self.x, self.x - width, -self.y, self.y - height)
        return bool(gap < self.side / 2 and self.side >= 1)  # and no number is NaN

    def covers(self, other: _Region) -> bool:
        """Return whether another square shows the same: their middles are near, for their size."""
        gap = np.hypot(self.x - other.x, self.y - other.y)
        return bool(gap < _SAME * max(self.side, other.side))


_SAME = 0.25
"""Squares whose middles are nearer than this share of the larger side are of one body."""


def _crop(image: UInt8[np.ndarray, "height width 3"], region: _Region, side: int, *, black: bool = False) -> np.ndarray:
    """Return (side side 3) float32 0..1: what a square that shows some of the frame shows; beyond the frame its edge goes on, or it is ``black``.

    A large square is averaged down first: taking every sixth pixel would alias.
    """
    reach = region.side * (abs(np.cos(region.angle)) + abs(np.sin(region.angle))) / 2 + 2
    middle, size = np.array([region.x, region.y]), np.array(image.shape[1::-1])
    low, high = np.floor(middle - reach).astype(int), np.ceil(middle + reach).astype(int)
    first = np.clip(low, 0, size - 1)
    last = np.clip(high, first + 1, size)
    factor = max(int(region.side / side), 1)
    part = Image.fromarray(image[first[1] : last[1], first[0] : last[0]]).reduce(factor)
    if not black and ((low < first).any() or (high > last).any()):
        before, after = -((low - first) // factor), -((last - high) // factor)
        edges = np.pad(np.asarray(part), ((before[1], after[1]), (before[0], after[0]), (0, 0)), "edge")
        part, first = Image.fromarray(edges), first - before * factor
    x, y = (middle - first) / factor
    step = region.side / side / factor
    cos, sin = step * np.cos(region.angle), step * np.sin(region.angle)
    turn = (cos, -sin, x - (cos - sin) * side / 2, sin, cos, y - (sin + cos) * side / 2)
    found = part.transform((side, side), Image.Transform.AFFINE, turn, Image.Resampling.BILINEAR)
    return np.asarray(found, np.float32) / 255


class _Network:
    """A .tflite network with one picture as its input."""

    def __init__(self, name: str, weights: str, threads: int, outputs: Sequence[int]):
        """``outputs`` are the sizes that the first of them must have."""
        make, content = _interpreter(), find_network(name, weights)
        try:
            with _hushed():
                self._runtime = make(model_content=content, num_threads=threads or min(os.cpu_count() or 1, 4))
                self._runtime.allocate_tensors()
            (self._input,), self._outputs = self._runtime.get_input_details(), self._runtime.get_output_details()
        except (ValueError, RuntimeError) as error:
            reason = str(error).splitlines()[0][:100]
            raise UserError(f"{name}: the file is damaged, or not a network that LiteRT runs ({reason}).") from None
        self.side = int(self._input["shape"][-2])
        found = [int(np.prod(one["shape"])) for one in self._outputs][: len(outputs)]
        if found != list(outputs) or list(self._input["shape"]) != [1, self.side, self.side, 3]:
            raise UserError(
                f"{name}: another network than MediaPipe's: outputs of {found} numbers, expected {outputs}."
            )

    def run(self, picture: Float32[np.ndarray, "side side 3"]) -> list[np.ndarray]:
        """Return the outputs in the network's order, without their axis of one picture."""
        self._runtime.set_tensor(self._input["index"], picture[None])
        self._runtime.invoke()
        return [self._runtime.get_tensor(one["index"])[0] for one in self._outputs]


def _interpreter() -> Callable:
    """Return LiteRT's interpreter; raises UserError where it is not installed."""
    try:
        from ai_edge_litert.interpreter import Interpreter  # pyright: ignore[reportMissingImports]
    except ImportError:
        python = ".".join(map(str, sys.version_info[:2]))
        if sys.version_info >= _TOO_NEW:
            raise UserError(
                f"detector=mediapipe runs on ai-edge-litert, which has no wheel for Python {python}: use Python 3.11 to "
                "3.13, or a detector of your own, detector=my.py:MyDetector (docs/video.md)."
            ) from None
        raise UserError('detector=mediapipe runs on ai-edge-litert: pip install "uplift3d[video]".') from None
    return Interpreter


_TOO_NEW = (3, 14)


@contextmanager
def _hushed() -> Iterator[None]:
    """Keep what LiteRT says of its own from standard error, which its library writes to past Python."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(values, -80, 80)))


# Find: a single-shot detector (Liu et al. 2016), boxes and points relative to anchors.


class _Finder:
    """The network that finds bodies or palms in a whole frame."""

    def __init__(self, network: _Network, strides: Sequence[int], low: float):
        self._network, self._low = network, low
        self._anchors = _anchors(network.side, strides)

    def find(self, image: UInt8[np.ndarray, "height width 3"]) -> Float[np.ndarray, "found points 2"]:
        """Return, surest first, two corners of the box of each that is found, then its points, px."""
        height, width = image.shape[:2]
        whole = _Region(width / 2, height / 2, max(width, height), 0.0)
        side = self._network.side
        picture = _crop(image, whole, side, black=True)
        raw, logits = self._network.run(picture * (1 - self._low) + self._low)
        score = _sigmoid(logits[:, 0])
        sure = score > _SURE
        places = raw[sure].reshape(-1, raw.shape[1] // 2, 2) / side
        middle = self._anchors[sure]
        size, points = places[:, 1] / 2, places[:, 2:] + middle[:, None]
        corners = np.stack([middle + places[:, 0] - size, middle + places[:, 0] + size], 1)
        return whole.to_frame(_merged(np.concatenate([corners, points], 1), score[sure]))


def _anchors(side: int, strides: Sequence[int]) -> Float[np.ndarray, "anchors 2"]:
    """Return the middles of the anchors, shares of the picture: two in each cell for each layer of that stride."""
    parts = []
    for stride in dict.fromkeys(strides):
        cells = side // stride
        middle = (np.arange(cells) + 0.5) / cells
        grid = np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2)
        parts.append(np.repeat(grid, 2 * list(strides).count(stride), axis=0))
    return np.concatenate(parts)


_SURE = 0.5
_OVERLAP = 0.3


def _merged(boxes: Float[np.ndarray, "boxes points 2"], score: Float[np.ndarray, " boxes"]) -> np.ndarray:
    """Return the boxes that remain where those that overlap become their mean by score (Bazarevsky et al. 2019, blazeface)."""
    order, found = np.argsort(-score, kind="stable"), []
    while len(order):
        near = _overlaps(boxes[order[0]], boxes[order]) > _OVERLAP
        near[0] = True
        found.append(np.average(boxes[order[near]], axis=0, weights=score[order[near]]))
        order = order[~near]
    return np.array(found).reshape(-1, *boxes.shape[1:])


def _overlaps(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return intersection over union of a box with each of several."""
    shared = np.minimum(box[1], boxes[:, 1]) - np.maximum(box[0], boxes[:, 0])
    both = np.clip(shared, 0, None).prod(-1)
    area = np.clip(box[1] - box[0], 0, None).prod() + np.clip(boxes[:, 1] - boxes[:, 0], 0, None).prod(-1)
    return both / np.maximum(area - both, 1e-12)


# Follow: squares from the landmarks of the frame before, and new ones where someone came.


@dataclass(frozen=True)
class _Seen:
    """Someone in a frame."""

    points: np.ndarray
    """(joints 2) px."""
    confidence: np.ndarray
    """(joints,) 0..1."""
    presence: float
    """0..1, whether anyone is in the square."""
    next: _Region
    """Where to look in the next frame."""


class _Blaze(Detector):
    """What the detectors of bodies and of hands share."""

    names: ClassVar[tuple[str, ...]] = ()
    ranges: ClassVar[dict[str, tuple[int, int]]] = {"people": (1, 100), "every": (1, 100_000), "threads": (0, 256)}

    def __init__(self, people: int, every: int):
        self._most, self._every = people, every
        self._regions: list[_Region] = []
        self._since = 0
        """Frames since the whole was looked at."""

    def detect(self, image: UInt8[np.ndarray, "height width 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Return the keypoints and confidences of those who are seen, in no particular order."""
        seen = self._look(image, self._regions)
        self._since += 1
        lost = len(seen) < len(self._regions)
        if not seen or lost or (len(seen) < self._most and self._since >= self._every):
            self._since = 0
            known = [one.next for one in seen]
            new = [one for one in self._find(image) if not any(one.covers(other) for other in known)]
            seen = _distinct([*seen, *self._look(image, new[: self._most - len(seen)])])
        self._regions = [one.next for one in seen]
        points = np.array([one.points for one in seen], np.float32).reshape(-1, len(self.names), 2)
        return points, np.array([one.confidence for one in seen], np.float32).reshape(-1, len(self.names))

    def forget(self) -> None:
        """Look for everyone anew."""
        self._regions = []

    def _look(self, image: np.ndarray, regions: Sequence[_Region]) -> list[_Seen]:
        found = [self._landmarks(image, region) for region in regions if region.shows(image)]
        return _distinct([one for one in found if one.presence > _SURE])

    def _find(self, image: np.ndarray) -> list[_Region]:
        raise NotImplementedError

    def _landmarks(self, image: np.ndarray, region: _Region) -> _Seen:
        raise NotImplementedError


def _distinct(seen: Sequence[_Seen]) -> list[_Seen]:
    """Return those who are not someone surer again."""
    kept: list[_Seen] = []
    for one in sorted(seen, key=lambda one: -one.presence):
        if not any(
            np.linalg.norm(one.points - other.points, axis=-1).mean() < _TWICE * other.next.side for other in kept
        ):
            kept.append(one)
    return kept


_TWICE = 0.08
"""Mean distance of landmarks, in sides of the square, below which two are one body."""


class BlazePose(_Blaze):
    """``detector=mediapipe``: 33 landmarks of bodies.

    Options: ``people``, at most how many are looked for; ``every``, after how many frames the whole frame is looked at again
    for others; ``model``, lite, full or heavy; ``weights``, a folder or .task file with the networks; ``threads``.
    """

    names: ClassVar[tuple[str, ...]] = POSE33
    networks: ClassVar[tuple[str, ...]] = ("pose_detection", "pose_landmark_full")

    def __init__(self, people: int = 5, every: int = 10, model: str = "full", weights: str = "", threads: int = 0):
        super().__init__(people, every)
        self._finder = _Finder(
            _Network("pose_detection", weights, threads, (2254 * 12, 2254)), (8, 16, 32, 32, 32), -1.0
        )
        self._network = _Network(f"pose_landmark_{model}", weights, threads, (39 * 5, 1, 256 * 256, 64 * 64 * 39))

    def _find(self, image: np.ndarray) -> list[_Region]:
        return [_along(found[2], found[3]) for found in self._finder.find(image)]

    def _landmarks(self, image: np.ndarray, region: _Region) -> _Seen:
        side = self._network.side
        flat, presence, _, heat, _ = self._network.run(_crop(image, region, side))
        marks = flat.reshape(-1, 5)
        places = _refined(marks[:, :2] / side, heat)
        points = region.to_frame(places)
        confidence = _sigmoid(marks[:, 3:]).prod(-1)
        count = len(self.names)
        return _Seen(points[:count], confidence[:count], float(presence[0]), _along(points[count], points[count + 1]))


def _along(middle: np.ndarray, end: np.ndarray) -> _Region:
    """Return the square around a body from the middle of its hips and the end of a circle around it, above its head."""
    way = end - middle
    return _Region(float(middle[0]), float(middle[1]), float(2.5 * np.hypot(*way)), float(np.arctan2(way[0], -way[1])))


def _refined(places: Float[np.ndarray, "marks 2"], heat: Float32[np.ndarray, "rows columns marks"]) -> np.ndarray:
    """Return landmarks moved to the mean of the heat within three cells, where it is sure of anything there."""
    heat, size = _sigmoid(heat), heat.shape[0]
    found = places.copy()
    for mark, (x, y) in enumerate((places * size).astype(int)):
        if not (0 <= x < size and 0 <= y < size):
            continue
        left, top = max(x - 3, 0), max(y - 3, 0)
        part = heat[top : y + 4, left : x + 4, mark]
        if part.max() >= _SURE:
            rows, columns = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
            found[mark] = np.array([(columns * part).sum(), (rows * part).sum()]) / part.sum() / size
    return found


class BlazeHand(_Blaze):
    """``detector=mediapipe_hand``: 21 landmarks of hands."""

    names: ClassVar[tuple[str, ...]] = HAND21
    networks: ClassVar[tuple[str, ...]] = ("palm_detection_full", "hand_landmark_full")

    def __init__(self, people: int = 2, every: int = 10, model: str = "full", weights: str = "", threads: int = 0):
        super().__init__(people, every)
        self._finder = _Finder(
            _Network(f"palm_detection_{model}", weights, threads, (2016 * 18, 2016)), (8, 16, 16, 16), 0.0
        )
        self._network = _Network(f"hand_landmark_{model}", weights, threads, (21 * 3, 1, 1))

    def _find(self, image: np.ndarray) -> list[_Region]:
        return [_palm(found) for found in self._finder.find(image)]

    def _landmarks(self, image: np.ndarray, region: _Region) -> _Seen:
        side = self._network.side
        flat, presence, *_ = self._network.run(_crop(image, region, side))
        points = region.to_frame(flat.reshape(-1, 3)[:, :2] / side)
        return _Seen(points, np.full(len(points), presence[0]), float(presence[0]), _hand(points))


def _up(low: np.ndarray, high: np.ndarray) -> float:
    """Return the angle that turns the way from one point to another upright."""
    return float(np.arctan2(high[0] - low[0], low[1] - high[1]))


def _palm(found: Float[np.ndarray, "points 2"]) -> _Region:
    """Return the square around the hand of a palm: from its box, and its points at the wrist and the middle knuckle."""
    return _around(found[:2].mean(0), found[1] - found[0], _up(found[2], found[4]), 2.6, 0.5)


def _hand(points: Float[np.ndarray, "joints 2"]) -> _Region:
    """Return the square around a hand from its landmarks: the wrist and the inner joints of the fingers."""
    angle = _up(points[0], (points[9] + (points[5] + points[13]) / 2) / 2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    inner = points[_INNER] @ turn.T
    low, high = inner.min(0), inner.max(0)
    return _around((low + high) / 2 @ turn, high - low, angle, 2.0, 0.1)


_INNER = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]


def _around(middle: np.ndarray, size: np.ndarray, angle: float, scale: float, shift: float) -> _Region:
    """Return the square so many times as large as a box that is at an angle, moved up by a share of its height."""
    x, y = middle + shift * size[1] * np.array([np.sin(angle), -np.cos(angle)])
    return _Region(float(x), float(y), float(scale * size.max()), angle)
