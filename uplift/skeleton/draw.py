"""Draw a skeleton: where each joint goes in the plane, and the labelled picture."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from jaxtyping import Float, Real
from PIL import Image, ImageDraw, ImageFont

from uplift.config.files import replacing
from uplift.skeleton.core import CENTRE, LEFT, RIGHT, Skeleton, joint_sides

__all__ = ["draw_skeleton", "rest_pose", "skeleton_layout"]

_AZIMUTHS_DEG = (0.0, 30.0, 55.0, 75.0)
_LOW_WORDS = ("foot", "toe", "ankle", "heel", "paw", "hoof", "tars", "claw", "leg", "tail")
_ROUNDS = 300


def rest_pose(skeleton: Skeleton) -> Float[np.ndarray, "joints 3"] | None:
    """Return the rest pose (x the body's left, y down, z behind it); None where a joint has no direction.

    A bone without a proportion has the mean of the others' lengths.
    """
    rest, lengths = skeleton.body.get("rest", {}), skeleton.body.get("proportions", {})
    if any(joint not in rest for joint in skeleton.joints if joint != skeleton.root):
        return None
    usual = float(np.mean(list(lengths.values()))) if lengths else 1.0
    pose = np.zeros((len(skeleton.joints), 3))
    for joint, parent in skeleton.parents.items():
        if parent is not None:
            direction = np.asarray(rest[joint], dtype=float)
            step = direction / np.linalg.norm(direction) * lengths.get(joint, usual)
            pose[skeleton.index(joint)] = pose[skeleton.index(parent)] + step
    return pose


def skeleton_layout(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Return where to draw each joint, x right and y down, in units of about one bone.

    The rest pose where there is one, turned to where its joints are clearest of each other; else
    a plane figure with bones as straight as they go (stress majorisation: Gansner, Koren and North,
    Graph Drawing by Stress Majorization, 2004), the body's left on the image's right as when it
    faces the camera.
    """
    pose = rest_pose(skeleton)
    if pose is not None:
        return _clearest_view(pose)
    return _upright(_plane_figure(skeleton), skeleton)


def _clearest_view(pose: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "joints 2"]:
    """Return the pose seen level from the front or turned, where few joints hide each other."""

    def seen(azimuth_deg: float) -> np.ndarray:
        angle = np.radians(azimuth_deg)
        x = pose[:, 0] * np.cos(angle) + pose[:, 2] * np.sin(angle)
        depth = pose[:, 2] * np.cos(angle) - pose[:, 0] * np.sin(angle)
        return np.stack([x, pose[:, 1] - (0.25 * depth if azimuth_deg else 0)], axis=1)

    def room(view: np.ndarray) -> float:
        apart = np.linalg.norm(view[:, None] - view[None], axis=2) + np.eye(len(view)) * 1e9
        return float(np.minimum(apart.min(1), 0.1 * np.ptp(view, axis=0).max()).mean() / np.ptp(pose))

    rooms = [room(seen(azimuth)) for azimuth in _AZIMUTHS_DEG]
    best = _AZIMUTHS_DEG[int(np.argmax(rooms))] if rooms[0] < 0.7 * max(rooms) else 0.0
    return seen(best)


def _plane_figure(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Lay the bones out flat by majorising stress, mirror partners level with each other."""
    wanted = _distances(skeleton)
    sides = np.array(joint_sides(skeleton, skeleton.joints))
    sign = np.where(sides == CENTRE, 0.0, np.where(sides == LEFT, 1.0, -1.0))
    across = skeleton.mirror_permutation
    if not skeleton.mirror:
        place = _fan(skeleton)
        if len(skeleton.bones) < len(skeleton.joints):
            return place
    else:
        space = _classical_scaling(wanted)
        apart = np.linalg.norm(space - space[across], axis=1) / 2
        centred = (space + space[across]) / 2
        centred = centred - centred.mean(0)
        even = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]  # along the main axis
        place = np.stack([sign * apart, even], axis=1)
    weight = 1 / (wanted + np.eye(len(wanted))) ** 2 * (1 - np.eye(len(wanted)))
    laplacian = np.linalg.pinv(np.diag(weight.sum(1)) - weight)
    for _ in range(_ROUNDS if len(wanted) <= 200 else 30):
        now = np.linalg.norm(place[:, None] - place[None], axis=2)
        pull = -weight * wanted / np.maximum(now, 1e-6)
        np.fill_diagonal(pull, 0)
        np.fill_diagonal(pull, -pull.sum(1))
        place = laplacian @ pull @ place
        if skeleton.mirror:
            place = (place + place[across] * np.array([-1.0, 1.0])) / 2
    return place


def _distances(skeleton: Skeleton) -> Float[np.ndarray, "joints joints"]:
    """Return the number of bones between any two joints."""
    from scipy.sparse import coo_matrix  # slow to import, and the writers need only the rest pose
    from scipy.sparse.csgraph import shortest_path

    count, ends = len(skeleton.joints), skeleton.bone_indices.T
    return shortest_path(coo_matrix((np.ones(ends.shape[1]), ends), (count, count)), directed=False, unweighted=True)


def _classical_scaling(distance: Float[np.ndarray, "joints joints"]) -> Float[np.ndarray, "joints axes"]:
    centre = np.eye(len(distance)) - 1 / len(distance)
    values, vectors = np.linalg.eigh(-0.5 * centre @ distance**2 @ centre)
    keep = np.argsort(values)[::-1][: min(8, len(values))]
    return vectors[:, keep] * np.sqrt(np.maximum(values[keep], 0))


def _fan(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Spread the ends of the tree over a half circle, in the order of the file, limbs straight."""
    parents, order = skeleton.parents, list(skeleton.parents)
    inner = set(parents.values())
    ends = [joint for joint in skeleton.joints if joint not in inner]
    angles = dict(zip(ends, np.linspace(0, np.pi, 2 * len(ends) + 1)[1::2], strict=True))
    below: dict[str, list[float]] = {joint: [angles[joint]] if joint in angles else [] for joint in order}
    for joint in reversed(order):
        if (parent := parents[joint]) is not None:
            below[parent] += below[joint]
    place = np.zeros((len(order), 2))
    for joint in order:
        if (parent := parents[joint]) is not None:
            angle = float(np.mean(below[joint]))
            step = np.array([np.cos(angle), -np.sin(angle)])
            place[skeleton.index(joint)] = place[skeleton.index(parent)] + step
    return place


def _upright(place: Float[np.ndarray, "joints 2"], skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Turn the figure so that up, or the front of a body seen from above, points up the image."""
    vectors = {name: skeleton.facing_matrix(name) @ place for name in skeleton.facing}
    up = vectors.get("up", np.zeros(2))
    low = np.array([any(word in joint.casefold() for word in _LOW_WORDS) for joint in skeleton.joints])
    if not np.linalg.norm(up) > 0.5 and "up" not in vectors and low.any() and not low.all():
        up = place[~low].mean(0) - place[low].mean(0)
    front = vectors.get("front", np.zeros(2))
    above = bool(skeleton.mirror) and np.linalg.norm(front) > 1.5 * np.linalg.norm(up)
    direction = front if above else up
    if np.linalg.norm(direction) < 1e-3:
        return place
    turn = -np.pi / 2 - np.arctan2(direction[1], direction[0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = place @ rotation.T
    left = vectors["left"] @ rotation.T if "left" in vectors else np.array([1.0, 0.0])
    flip = (left[0] < 0) != above
    return turned * np.array([-1.0 if flip else 1.0, 1.0])


# The picture: labelled joints, bones in the colours of the sides, facing arrows.

# Blue and vermilion: distinct to colour-blind readers (Okabe and Ito 2008).
_COLOURS = {LEFT: "#0072b2", RIGHT: "#d55e00", CENTRE: "#444444"}
_FACING_COLOURS = {"front": "#009e73", "left": "#0072b2", "up": "#9b4f96"}
_SIZE_PX = 1100
_MARGIN_PX = 120
_SHARPEN = 2
_MOST_LABELS = 300


def draw_skeleton(skeleton: Skeleton, path: str | Path) -> None:
    """Write a PNG of the skeleton; raises UserError where there is no folder for it."""
    place = _fit(skeleton_layout(skeleton))
    arrows = _arrows(skeleton, place)
    height = round(float(place[:, 1].max())) + _MARGIN_PX
    picture = _Picture(height, _text_lines(skeleton, set(arrows)))
    sides = joint_sides(skeleton, skeleton.joints)
    for one, other in skeleton.bone_indices:
        either = {sides[one], sides[other]} - {CENTRE}
        picture.bone(place[one], place[other], _COLOURS[either.pop() if len(either) == 1 else CENTRE])
    for direction, (start, stop) in arrows.items():
        picture.arrow(start, stop, _FACING_COLOURS[direction])
    for joint, side, at in zip(skeleton.joints, sides, place, strict=True):
        picture.joint(at, _COLOURS[side], joint == skeleton.root)
    picture.labels(skeleton, place, list(arrows.values()))
    picture.save(Path(path))


def _arrows(skeleton: Skeleton, place: Float[np.ndarray, "joints 2"]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return start and stop of the directions that lie in the picture.

    Two that fall on one line do not both: the shorter points into the page or out of it.
    """
    ends = {
        name: tuple(place[[skeleton.index(joint) for joint in end]].mean(0) for end in pair)
        for name, pair in skeleton.facing.items()
    }
    vectors = {name: stop - start for name, (start, stop) in ends.items()}
    drawn: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in sorted(vectors, key=lambda name: -np.linalg.norm(vectors[name])):
        length = np.linalg.norm(vectors[name])
        along = [abs(vectors[name] @ vectors[other]) / length / np.linalg.norm(vectors[other]) for other in drawn]
        if length > 8 and max(along, default=0) < 0.95:
            drawn[name] = (ends[name][0], ends[name][0] + vectors[name] / length * max(length, 60))
    return drawn


def _fit(place: Float[np.ndarray, "joints 2"]) -> Float[np.ndarray, "joints 2"]:
    low, high = place.min(0), place.max(0)
    scale = (_SIZE_PX - 2 * _MARGIN_PX) / max(float((high - low).max()), 1e-9)
    middle = np.array([_SIZE_PX / 2, _MARGIN_PX + scale * (high - low)[1] / 2])
    return (place - (low + high) / 2) * scale + middle


def _text_lines(skeleton: Skeleton, drawn: set[str]) -> list[tuple[str, str]]:
    title = f"{skeleton.name}: {len(skeleton.joints)} joints, {len(skeleton.bones)} bones, root {skeleton.root}"
    title += ("" if skeleton.gravity else ", no gravity") + (", rigid" if skeleton.rigid else "")
    lines = [(title, "#000000")]
    if skeleton.mirror:
        lines += [("its left", _COLOURS[LEFT]), ("its right", _COLOURS[RIGHT])]
    for direction, (start, stop) in skeleton.facing.items():
        words = f"{direction}: from {_several(start)} to {_several(stop)}"
        words += "" if direction in drawn else " (into the page or out of it)"
        lines += [(line, _FACING_COLOURS[direction]) for line in textwrap.wrap(words, 120)]
    if "up" not in skeleton.facing and skeleton.facing:
        lines.append(("up: against gravity", _FACING_COLOURS["up"]))
    return lines


def _several(joints: tuple[str, ...]) -> str:
    shown = ", ".join(joints[:6]) + (", ..." if len(joints) > 6 else "")
    return shown if len(joints) == 1 else f"the mean of {shown}"


class _Picture:
    """A canvas with text on top; positions in pixels of the picture under the text."""

    def __init__(self, height: int, lines: list[tuple[str, str]]) -> None:
        self.top = 26 * len(lines)
        self.size = np.array([_SIZE_PX, height])
        self.image = Image.new("RGB", (_SIZE_PX * _SHARPEN, (height + self.top) * _SHARPEN), "white")
        self.draw = ImageDraw.Draw(self.image)
        for row, (line, colour) in enumerate(lines):
            self.draw.text((30 * _SHARPEN, (20 + 26 * row) * _SHARPEN), line, fill=colour, font=_font(18))

    def at(self, place: np.ndarray) -> tuple[float, float]:
        return float(place[0]) * _SHARPEN, (float(place[1]) + self.top) * _SHARPEN

    def bone(self, start: np.ndarray, stop: np.ndarray, colour: str) -> None:
        self.draw.line([self.at(start), self.at(stop)], fill=colour, width=4 * _SHARPEN)

    def joint(self, place: np.ndarray, colour: str, root: bool) -> None:
        x, y = self.at(place)
        for radius, fill in ((11, "#000000"), (8, "white"), (6, colour)) if root else ((7, "white"), (5, colour)):
            r = radius * _SHARPEN
            self.draw.ellipse([x - r, y - r, x + r, y + r], fill=fill)

    def arrow(self, start: np.ndarray, stop: np.ndarray, colour: str) -> None:
        direction = (stop - start) / np.linalg.norm(stop - start)
        side = np.array([-direction[1], direction[0]])
        self.draw.line([self.at(start), self.at(stop - 14 * direction)], fill=colour, width=3 * _SHARPEN)
        head = [stop, stop - 20 * direction + 9 * side, stop - 20 * direction - 9 * side]
        self.draw.polygon([self.at(corner) for corner in head], fill=colour)

    def labels(self, skeleton: Skeleton, place: Float[np.ndarray, "joints 2"], arrows: list) -> None:
        """Write each joint's name where it covers least, one by one; none where there are too many."""
        if len(place) > _MOST_LABELS:
            return
        font = _font(16 if len(place) <= 40 else 13 if len(place) <= 120 else 9)
        bones = np.concatenate([place[skeleton.bone_indices], *(np.array([arrow]) for arrow in arrows)])
        along = np.linspace(0, 1, 13)[:, None, None]
        taken = (bones[:, 0] * (1 - along) + bones[:, 1] * along).reshape(-1, 2)
        boxes = np.empty((0, 4))
        for joint, at in zip(skeleton.joints, place, strict=True):
            size = np.array(self.draw.textbbox((0, 0), joint, font=font)[2:]) / _SHARPEN
            box = _freest(at, size, np.concatenate([taken, place]), boxes, self.size)
            boxes = np.concatenate([boxes, box[None]])
            self.draw.text(self.at(box[:2]), joint, fill="#222222", font=font)

    def save(self, path: Path) -> None:
        shrunk = self.image.resize(
            (self.image.width // _SHARPEN, self.image.height // _SHARPEN), Image.Resampling.LANCZOS
        )
        with replacing(path) as file:
            shrunk.save(file, format="PNG")


def _freest(
    at: Float[np.ndarray, " 2"],
    size: Float[np.ndarray, " 2"],
    points: Float[np.ndarray, "points 2"],
    boxes: Float[np.ndarray, "boxes 4"],
    picture: Real[np.ndarray, " 2"],
) -> Float[np.ndarray, " 4"]:
    """Return the box (x0 y0 x1 y1) beside ``at`` that covers the fewest points and boxes."""
    best, best_cost = None, np.inf
    for reach in (14, 28):
        for angle in np.radians([0, 180, 35, 145, -35, -145, 90, -90]):
            direction = np.array([np.cos(angle), np.sin(angle)])
            low = at + direction * reach + size * (np.sign(np.round(direction, 2)) - 1) / 2
            box = np.concatenate([low, low + size])
            inside = ((points > box[:2] - 3) & (points < box[2:] + 3)).all(1).sum()
            over = ((boxes[:, :2] < box[2:]) & (boxes[:, 2:] > box[:2])).all(1).sum()
            outside = (box[:2] < 4).any() or (box[2:] > picture - 4).any()
            cost = inside + 6 * over + 20 * outside + reach / 50
            if cost < best_cost:
                best, best_cost = box, cost
    assert best is not None
    return best


def _font(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size_px * _SHARPEN)
