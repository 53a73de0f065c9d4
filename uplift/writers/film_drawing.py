"""The pictures of a film: keypoints on the left, the turning pose on the right."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from PIL import Image

from uplift.writers.film_canvas import CARD, FAINT, FLOOR, INK, PAPER, SHADOW, SIDES, SOFT, Canvas, Colour, mixed
from uplift.writers.film_scene import FilmScene

__all__ = ["HIGH", "WIDE", "FilmDrawing"]

WIDE, HIGH = 1280, 640
"""The picture's size in drawing units; a film's pixels are these times its scale."""
_FLAT, _DEEP = (24, 64, 536, 592), (560, 64, 1256, 592)
"""Left, top, right, bottom of the two cards."""
_NEAREST, _EYE = 0.15, 4.5
_PITCH_DEG = 11.0
_PALE = 0.62
_MAP = 84.0


class FilmDrawing:
    """Draws the moments of a scene at a scale; ``timed``: seconds are shown with the frame."""

    def __init__(self, scene: FilmScene, scale: float, rate: float, timed: bool):
        self.scene, self.scale, self.rate, self.timed = scene, scale, rate, timed
        self.size = (round(WIDE * scale), round(HIGH * scale))
        self._still = self._shared()
        self._round = {card: self._mask(card) for card in (_FLAT, _DEEP)}

    def picture(self, moment: int) -> Image.Image:
        """Return the picture of a moment in RGB."""
        image = self._still.copy()
        for card, drawn in ((_FLAT, self._flat(moment)), (_DEEP, self._deep(moment))):
            image.paste(drawn.finished(), self._corner(card), self._round[card])
        for top, height, drawn in ((20, 28, self._words(moment)), (606, 18, self._bar(moment))):
            image.paste(drawn.finished(), self._corner((_DEEP[0], top, 0, height)))
        return image

    def _shared(self) -> Image.Image:
        scene, canvas = self.scene, Canvas(WIDE, HIGH, self.scale, PAPER)
        canvas.text((24, 34), scene.title[:60], 22, INK, "lm")
        at = 24.0
        colours = {"left": SIDES[1], "right": SIDES[2], "unsure": mixed(SIDES[0], PAPER, _PALE)}
        shown = {"left": any(scene.joint_sides), "right": any(scene.joint_sides), "unsure": bool(scene.unsure.any())}
        for name in (name for name in colours if shown[name]):
            canvas.dot((at + 5, 615), 5, colours[name])
            canvas.text((at + 16, 615), name, 15, SOFT, "lm")
            at += 30 + 9 * len(name)
        return canvas.finished()

    def _mask(self, card: tuple[int, int, int, int]) -> Image.Image:
        canvas = self._canvas(card, (0, 0, 0))
        canvas.box((0, 0, canvas.wide, canvas.high), 10, (255, 255, 255))
        return canvas.finished().convert("L")

    def _canvas(self, card: tuple[int, int, int, int], back: Colour) -> Canvas:
        return Canvas(card[2] - card[0], card[3] - card[1], self.scale, back)

    def _corner(self, card: tuple[int, int, int, int]) -> tuple[int, int]:
        return round(card[0] * self.scale), round(card[1] * self.scale)

    def _words(self, moment: int) -> Canvas:
        canvas = Canvas(_DEEP[2] - _DEEP[0], 28, self.scale, PAPER)
        words = f"frame {self.scene.frames[moment]}"
        words += f"   {moment / self.rate:.1f} s" if self.timed else ""
        canvas.text((canvas.wide, 14), words, 18, SOFT, "rm")
        return canvas

    def _bar(self, moment: int) -> Canvas:
        canvas = Canvas(_DEEP[2] - _DEEP[0], 18, self.scale, PAPER)
        done = moment / max(len(self.scene.frames) - 1, 1)
        canvas.line((0, 9), (canvas.wide, 9), 3, FAINT)
        canvas.line((0, 9), (canvas.wide * done, 9), 3, SOFT)
        return canvas

    def _flat(self, moment: int) -> Canvas:
        """Draw the keypoints, and where they are in the image."""
        scene, canvas = self.scene, self._canvas(_FLAT, CARD)
        scale = min(0.46 * canvas.wide / scene.flat_reach[0], 0.42 * canvas.high / scene.flat_reach[1])
        shift = np.array([canvas.wide / 2, canvas.high / 2 + 8]) - scene.flat_centre[moment] * scale
        if scene.image_size is not None:
            corners = np.array([[0.0, 0.0], list(scene.image_size)]) * scale + shift
            canvas.box(corners.ravel().tolist(), 0, None, FAINT)
        for who, points in enumerate(scene.keypoints[moment] * scale + shift):
            unsure = scene.unsure[moment, who]
            for (start, end), side in zip(scene.bones, scene.bone_sides, strict=True):
                if np.isfinite(points[[start, end]]).all():
                    pale = bool(unsure[start] or unsure[end])
                    canvas.line(points[start], points[end], 3 if pale else 4.5, _tone(side, -1.0, pale))
            for joint in np.flatnonzero(np.isfinite(points[:, 0])).tolist():
                canvas.dot(points[joint], 5.5, _tone(scene.joint_sides[joint], -1.0, bool(unsure[joint])), rim=CARD)
            self._name(canvas, who, points)
        self._map(canvas, moment)
        canvas.text((16, 20), "keypoints", 15, SOFT, "lm")
        return canvas

    def _map(self, canvas: Canvas, moment: int) -> None:
        """Draw the whole image in a corner, a dot for each individual."""
        size = self.scene.image_size
        if size is None:
            return
        scale = _MAP / max(size)
        left, top = canvas.wide - 14 - size[0] * scale, canvas.high - 14 - size[1] * scale
        canvas.box((left, top, canvas.wide - 14, canvas.high - 14), 0, CARD, FAINT)
        for points in self.scene.keypoints[moment]:
            known = points[np.isfinite(points).all(-1)]
            if len(known):
                x, y = np.clip(known.mean(0), 0, size) * scale
                canvas.dot((left + x, top + y), 3.5, SOFT)

    def _deep(self, moment: int) -> Canvas:
        """Draw floor, shadows, then bones and joints from far to near."""
        scene, canvas = self.scene, self._canvas(_DEEP, CARD)
        if scene.floor:
            self._floor(canvas, moment)
            for points in scene.points[moment]:
                _shadow(canvas, self._seen(canvas, points * [1.0, 0.0, 1.0], moment), scene.bones)
        parts, figures = [], [self._seen(canvas, points, moment) for points in scene.points[moment]]
        for points, unsure in zip(figures, scene.unsure[moment], strict=True):
            front = points[:, 2] - 0.15
            for (start, end), side in zip(scene.bones, scene.bone_sides, strict=True):
                if np.isfinite(points[[start, end], 0]).all():
                    depth = (points[start, 2] + points[end, 2]) / 2
                    front[[start, end]] = np.minimum(front[[start, end]], depth - 1e-3)
                    parts.append((depth, points[start], points[end], side, bool(unsure[start] or unsure[end])))
            for joint in np.flatnonzero(np.isfinite(points[:, 0])).tolist():
                parts.append((front[joint], points[joint], None, scene.joint_sides[joint], bool(unsure[joint])))
        for part in sorted(parts, key=lambda part: -part[0]):
            _stroke(canvas, *part[1:])
        for who, points in enumerate(figures):
            self._name(canvas, who, points)
        canvas.text((16, 20), "3D pose", 15, SOFT, "lm")
        return canvas

    def _floor(self, canvas: Canvas, moment: int) -> None:
        """Draw squares that stand still in the world and fade away from where the camera looks."""
        scene = self.scene
        step = scene.square
        reach = int(np.ceil(1.6 * max(scene.wide, scene.tall) / step))
        middle = np.round(scene.centre[moment] / step)
        n, k = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach), indexing="ij")
        shift = middle - scene.centre[moment] / step
        for along, across in ((0, 2), (2, 0)):
            point = np.zeros((2, *n.shape, 3))
            point[..., across] = (middle[across] + n) * step
            point[..., along] = (middle[along] + k + np.array([0, 1])[:, None, None]) * step
            starts, ends = self._seen(canvas, point.reshape(-1, 3), moment).reshape(2, -1, 4)
            fade = 1 - np.hypot(n + shift[across], k + 0.5 + shift[along]).ravel() / reach
            for start, end, strength in zip(starts, ends, fade, strict=True):
                if strength > 0.02:
                    canvas.line(start, end, 1.2, mixed(FLOOR, CARD, 1 - min(1.0, 1.3 * float(strength))))

    def _seen(
        self, canvas: Canvas, points: Float[np.ndarray, "points 3"], moment: int
    ) -> Float[np.ndarray, "points 4"]:
        """Return x and y on the card, the depth from -1 (near) to 1, and the magnification."""
        scene = self.scene
        yaw, pitch = np.radians(scene.turn_deg[moment]), np.radians(_PITCH_DEG if scene.floor else 0.0)
        x, y, z = (points - scene.centre[moment]).T
        aside, away = np.cos(yaw) * x + np.sin(yaw) * z, np.cos(yaw) * z - np.sin(yaw) * x
        down, depth = np.cos(pitch) * y - np.sin(pitch) * away, np.cos(pitch) * away + np.sin(pitch) * y
        eye = _EYE * scene.radius
        near = eye / np.maximum(eye + depth, _NEAREST * eye)
        scale = min(0.44 * canvas.wide / scene.wide, 0.41 * canvas.high / scene.tall)
        across, along = canvas.wide / 2 + aside * near * scale, canvas.high / 2 + 10 + down * near * scale
        return np.stack([across, along, np.clip(depth / scene.radius, -1.0, 1), near], 1)

    def _name(self, canvas: Canvas, who: int, points: np.ndarray) -> None:
        known = points[np.isfinite(points[:, 0])]
        if len(self.scene.names) > 1 and len(known):
            canvas.text((known[:, 0].mean(), known[:, 1].min() - 14), self.scene.names[who], 14, SOFT, "ms")


def _stroke(canvas: Canvas, start: np.ndarray, end: np.ndarray | None, side: int, pale: bool) -> None:
    depth = float(start[2] if end is None else (start[2] + end[2]) / 2)
    tone, thick = _tone(side, depth, pale), 6.5 * (1 - 0.3 * depth) * float(start[3])
    if end is None:
        canvas.dot(start, 0.85 * thick, tone, rim=CARD)
        return
    if not pale:
        canvas.line(start, end, thick + 3.5, CARD)
    canvas.line(start, end, 0.7 * thick if pale else thick, tone)


def _shadow(canvas: Canvas, points: np.ndarray, bones: list[tuple[int, int]]) -> None:
    for bone in bones:
        if np.isfinite(points[list(bone), 0]).all():
            canvas.line(points[bone[0]], points[bone[1]], 6, SHADOW)
            for joint in bone:
                canvas.dot(points[joint], 2.9, SHADOW)


def _tone(side: int, depth: float, pale: bool) -> Colour:
    return mixed(SIDES[side], CARD, _PALE if pale else 0.6 * ((depth + 1) / 2) ** 1.4)
