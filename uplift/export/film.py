"""A clip as a film, ``.gif`` or ``.mp4``: keypoints, over the video where it is given, beside the 3D pose that slowly turns."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from uplift.config.files import replacing
from uplift.config.progress import progress
from uplift.data.poses import USUAL_FPS
from uplift.errors import UserError
from uplift.export.clips import Clip, frame_rate, one_clip
from uplift.export.footage import Footage, every_frame
from uplift.export.gallery import filled_points
from uplift.export.scene import SIDE_COLOURS, Body, body_of, from_y_down, in_axes, known_points, row_places
from uplift.models.prediction import Prediction
from uplift.video.base import need_av

__all__ = [
    "CARD", "HIGH", "SIDES", "WIDE", "FilmDrawing", "FilmScene", "film_palette", "film_scene", "gif_durations_ms",
    "thinned", "turns_deg", "write_film",
]  # fmt: skip

Number = int | float
Colour = tuple[int, ...]
Point = Sequence[Number] | np.ndarray

_GIF_FRAMES, _GIF_FPS, _GIF_SCALE = 600, 34.0, 0.625
_MP4_FPS, _MP4_SCALE, _MP4_CRF = 61.0, 1.0, 20


def write_film(
    prediction: Prediction,
    path: str | Path,
    fps: int | float | None = None,
    video: str | Path | None = None,
    alone: bool = True,
) -> None:
    """Write one clip with all its individuals, 1280 x 640 pixels as ``.mp4`` and 800 x 400 as ``.gif``.

    ``fps`` replaces the prediction's; where neither is known it is 30, and no seconds are shown. Every n-th frame
    is drawn, n as small as keeps a gif within 600 frames and 34 a second, an mp4 within 61 a second; the film lasts
    as long as the clip. Missing frame numbers are skipped. Axes are the camera's, or level ones. With ``video``, what
    `uplift.export.footage.Footage` takes, keypoints are drawn over its frames, those without anybody too; the film is
    then as wide as they ask for, and without sound. Unless the clip is ``alone``, a video must have its name to be shown.
    Raises UserError for several clips, another extension, or where the package for mp4 is not there.
    """
    extension = Path(path).suffix.lower()
    if extension not in (".gif", ".mp4"):
        raise UserError(f"cannot write {path}: a film is a .gif or an .mp4.")
    av = need_av(f"{path}: an .mp4") if extension == ".mp4" else None
    clip = one_clip(prediction, path)
    footage = None if video is None else Footage(video, prediction)
    footage = footage if footage is not None and footage.shows(clip, alone=alone) else None
    clip = clip if footage is None else every_frame(clip)
    known = frame_rate(prediction, fps)
    rate = known or USUAL_FPS
    scene = film_scene(prediction, clip, rate)
    scale, most, fastest = (_MP4_SCALE, len(clip.frames), _MP4_FPS) if av else (_GIF_SCALE, _GIF_FRAMES, _GIF_FPS)
    moments = thinned(len(clip.frames), rate, most, fastest)
    size = None if footage is None else (footage.image_size[0], footage.image_size[1])
    drawing = FilmDrawing(scene, scale, rate, timed=known is not None, video_size=size)
    pictures = _pictures(drawing, moments, footage, alone)
    with replacing(path) as handle:
        if av:
            _write_mp4(av, pictures, handle, drawing.size, rate * len(moments) / len(clip.frames))
        else:
            _write_gif(pictures, handle, gif_durations_ms(len(moments), len(clip.frames) / rate), footage is not None)


def _pictures(
    drawing: FilmDrawing, moments: Int[np.ndarray, " kept"], footage: Footage | None, alone: bool = True
) -> Iterator[Image.Image]:
    """Yield the pictures of the moments; of those that a video has, where there is one."""
    shown: Iterable[tuple[int, Any]] = ((moment, None) for moment in moments.tolist())
    if footage is not None:
        shown = footage.images(drawing.scene.clip, moments.tolist(), alone=alone)
    for moment, image in progress(shown, "drawing frames", len(moments)):
        yield drawing.picture(moment, image)


def _write_gif(pictures: Iterator[Image.Image], handle: BinaryIO, durations_ms: list[int], photos: bool) -> None:
    palette = None if photos else film_palette()
    small = (
        picture.quantize(128, Image.Quantize.FASTOCTREE)
        if palette is None
        else picture.quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    )
    options = {"save_all": True, "duration": durations_ms, "loop": 0, "optimize": False}
    next(small).save(handle, format="GIF", append_images=small, **options)


def thinned(moments: int, rate: float, most: int, fastest: float) -> Int[np.ndarray, " kept"]:
    """Return every n-th moment, n the least with no more than ``most`` of them and ``fastest`` a second."""
    return np.arange(0, moments, max(int(np.ceil(moments / most)), int(np.ceil(rate / fastest)), 1))


def gif_durations_ms(frames: int, seconds: float) -> list[int]:
    """Return the duration of each frame, in multiples of the gif's 10 ms, none less than two."""
    ends = np.round(np.linspace(0, max(seconds, 0.02 * frames), frames + 1) * 100).astype(int)
    return (np.diff(ends) * 10).tolist()


def _write_mp4(av: Any, pictures: Iterator[Image.Image], handle: BinaryIO, size: tuple[int, int], rate: float) -> None:
    """Encode the pictures into a temporary file: an mp4's index is written last, to its beginning."""
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        with av.open(str(film), "w", options={"movflags": "+faststart"}) as container:
            stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1_000_000))
            stream.width, stream.height = size
            stream.pix_fmt, stream.options = "yuv420p", {"preset": "veryfast", "crf": str(_MP4_CRF)}
            # Without these, players guess the colours' matrix by the size of the picture.
            context, colours = stream.codec_context, av.video.reformatter
            context.color_range, context.colorspace = colours.ColorRange.MPEG, colours.Colorspace.ITU709
            context.color_primaries, context.color_trc = colours.ColorPrimaries.BT709, colours.ColorTrc.BT709
            scaler = colours.VideoReformatter()
            for picture in pictures:
                frame = scaler.reformat(
                    av.VideoFrame.from_image(picture),
                    format="yuv420p",
                    dst_colorspace=colours.Colorspace.ITU709,
                    dst_color_range=colours.ColorRange.MPEG,
                    threads=1,
                )
                frame.pts = None  # numbered by the stream
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        with open(film, "rb") as made:
            shutil.copyfileobj(made, handle)


# The scene: keypoints, poses on the floor, and the camera that turns about them, moment by moment.

_FOLLOW_S = 1.0
_CONFIDENT = 0.3
_TURN_S = 18.0
_SHORT_S = 12.0
_SWING_DEG_PER_S, _SWING_DEG = 7.0, 60.0
_MOST = 98.0  # percentile for sizes, which a few outliers must not set


@dataclass(frozen=True)
class FilmScene:
    """A clip as it is drawn; world axes are x right, y down with the floor at 0, z away, level."""

    title: str
    clip: Clip
    body: Body
    points: Float[np.ndarray, "moments individuals joints 3"]
    keypoints: Float[np.ndarray, "moments individuals joints 2"]
    unsure: Bool[np.ndarray, "moments individuals joints"]
    centre: Float[np.ndarray, "moments 3"]
    turn_deg: Float[np.ndarray, " moments"]
    radius: float
    wide: float
    tall: float
    """How far the poses reach from the centre along the floor, and up and down."""
    floor: bool
    square: float
    """The side of the floor's squares."""
    flat_centre: Float[np.ndarray, "moments 2"]
    """The point of the image that is in the middle, px."""
    flat_reach: tuple[float, float]
    """How far keypoints are from it, px."""
    image_size: Sequence[int] | None


def film_scene(prediction: Prediction, clip: Clip, rate: float) -> FilmScene:
    """Return what a clip shows at so many frames a second.

    Joints that were filled, not seen or seen with little confidence are unsure; where they have no keypoint it is that
    of the pose. Under gravity the floor is the ground where that was found, else at the lowest feet: of the clip where
    the root's place is known, else of each pose.
    """
    level = _levelled(prediction)
    pose = known_points(level.pose)
    points = pose + row_places(level, clip)[:, None]
    floor = prediction.skeleton.gravity
    if floor:
        points[..., 1] -= _floor(level, points, clip.rows)
    keypoints, unsure = _keypoints(prediction, pose)
    points, keypoints = clip.by_moment(points), clip.by_moment(keypoints)
    centre, flat_centre = _followed(points, rate), _followed(keypoints, rate)
    centre[:, 1] = np.median(centre[:, 1])
    away, flat_away = points - centre[:, None, None], keypoints - flat_centre[:, None, None]
    radius = _most(np.linalg.norm(away, axis=-1))
    return FilmScene(
        title=prediction.title or clip.name or prediction.skeleton.name,
        clip=clip,
        body=body_of(prediction),
        points=points,
        keypoints=keypoints,
        unsure=clip.by_moment(unsure.astype(float)) > 0,
        centre=centre,
        turn_deg=turns_deg(len(clip.frames), rate),
        radius=radius,
        wide=_most(np.linalg.norm(away[..., ::2], axis=-1)),
        tall=_most(np.abs(away[..., 1])),
        floor=floor,
        square=_round_length(radius / 3),
        flat_centre=flat_centre,
        flat_reach=(_most(np.abs(flat_away[..., 0])), _most(np.abs(flat_away[..., 1]))),
        image_size=prediction.image_size,
    )


def turns_deg(moments: int, rate: float) -> Float[np.ndarray, " moments"]:
    """Return the camera's turn at each moment: full turns, or a swing in a short film; it ends where it began."""
    share = np.arange(moments) / max(moments, 1)
    seconds = moments / rate
    if seconds < _SHORT_S:
        return min(_SWING_DEG, _SWING_DEG_PER_S * seconds) * np.sin(2 * np.pi * share)
    return 360.0 * max(1, round(seconds / _TURN_S)) * share


def _levelled(prediction: Prediction) -> Prediction:
    if prediction.axes in ("camera", "opencv"):
        return in_axes(prediction, "level")
    turn = from_y_down(prediction.axes)
    root = None if prediction.root is None else prediction.root @ turn
    ground = prediction.ground
    if ground is not None:
        ground = replace(ground, point=ground.point @ turn, normal=ground.normal @ turn)
    return replace(prediction, pose=prediction.pose @ turn, root=root, ground=ground, axes="level")


def _floor(level: Prediction, points: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the floor's y: one where the ground or the root has a place, else below each pose."""
    if level.ground is not None and np.isfinite(level.ground.point[rows]).any():
        return np.asarray(np.nanmedian(level.ground.point[rows, 1]))
    lowest = np.where(np.isfinite(points[..., 1]), points[..., 1], -np.inf).max(1, keepdims=True)
    if level.root is not None:
        lowest = lowest[rows]
        lowest = lowest[np.isfinite(lowest)]
        return np.asarray(np.percentile(lowest, _MOST) if len(lowest) else 0.0)
    return np.where(np.isfinite(lowest), lowest, 0.0)


def _keypoints(prediction: Prediction, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints with missing ones filled in, and which joints are unsure."""
    points = np.asarray(prediction.keypoints, float)
    confidence = np.nan_to_num(np.asarray(prediction.confidence, float))
    seen = (confidence > 0) & np.isfinite(np.sum(points, axis=-1))
    unsure = ~seen | (confidence < _CONFIDENT)
    if prediction.filled is not None:
        unsure |= prediction.filled
    camera_pose = pose if prediction.axes not in ("camera", "opencv") else known_points(prediction.pose)
    points = np.where(seen[..., None], points, np.nan)
    for row in np.flatnonzero(~seen.all(1)):
        points[row] = filled_points(points[row], seen[row], camera_pose[row])
    return points, unsure


def _followed(points: np.ndarray, rate: float) -> Float[np.ndarray, "moments axes"]:
    """Return the point to look at: the middle of all that is there, smoothly."""
    flat = points.reshape(len(points), -1, points.shape[-1])
    known = np.isfinite(flat)
    low, high = np.where(known, flat, np.inf).min(1), np.where(known, flat, -np.inf).max(1)
    there = np.isfinite(low).all(1)
    if not there.any():
        return np.zeros((len(points), points.shape[-1]))
    when = np.arange(len(points))
    middle = np.stack([np.interp(when, when[there], axis) for axis in ((low[there] + high[there]) / 2).T], 1)
    reach = max(1, round(rate * _FOLLOW_S))
    kernel = np.hanning(2 * reach + 3)[1:-1]
    padded = np.pad(middle, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(axis, kernel / kernel.sum(), mode="valid") for axis in padded.T], 1)


def _most(distances: np.ndarray) -> float:
    known = distances[np.isfinite(distances)]
    return max(float(np.percentile(known, _MOST)) * 1.1, 1e-6) if len(known) else 1.0


def _round_length(about: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that squares can be counted."""
    power = 10.0 ** np.floor(np.log10(about))
    return float(power * next(k for k in (1, 2, 5, 10) if k * power >= about * 0.99))


# The pictures of a film: keypoints on the left, the turning pose on the right.

WIDE, HIGH = 1280, 640
"""The picture's size in drawing units; a film's pixels are these times its scale."""
_FLAT, _DEEP = (24, 64, 536, 592), (560, 64, 1256, 592)
"""Left, top, right, bottom of the two cards."""
_VIDEO_WIDE = (240, 1056)
"""Narrowest and widest the left card is for a video."""
_NEAREST, _EYE = 0.15, 4.5
_PITCH_DEG = 11.0
_PALE = 0.62
_MAP = 84.0


class FilmDrawing:
    """Draws the moments of a scene at a scale; ``timed``: seconds are shown with the frame.

    ``video_size`` is the width and height, in px of the keypoints, of images that they are drawn over: the card on the
    left has their shape then.
    """

    def __init__(
        self, scene: FilmScene, scale: float, rate: float, timed: bool, video_size: tuple[int, int] | None = None
    ):
        self.scene, self.scale, self.rate, self.timed, self._video_size = scene, scale, rate, timed, video_size
        left, top, right, bottom = _FLAT
        if video_size is not None:
            right = left + round(np.clip((bottom - top) * video_size[0] / video_size[1], *_VIDEO_WIDE))
        self._flat_card = left, top, right, bottom
        self._deep_card = right + _DEEP[0] - _FLAT[2], top, right + _DEEP[2] - _FLAT[2], bottom
        self._wide = self._deep_card[2] + WIDE - _DEEP[2]
        self.size = (2 * round(self._wide * scale / 2), round(HIGH * scale))
        self._still = self._shared()
        self._round = {}
        for card in (self._flat_card, self._deep_card):
            mask = self._canvas(card, (0, 0, 0))
            mask.box((0, 0, mask.wide, mask.high), 10, (255, 255, 255))
            self._round[card] = mask.finished().convert("L")

    def picture(self, moment: int, photo: UInt8[np.ndarray, "height width 3"] | None = None) -> Image.Image:
        """Return the picture of a moment in RGB, with keypoints over the photo if one is given."""
        image = self._still.copy()
        flat = self._flat(moment) if photo is None else self._over(moment, photo)
        deep = self._deep_card
        for card, drawn in ((self._flat_card, flat), (deep, self._deep(moment))):
            image.paste(drawn.finished(), self._corner(card), self._round[card])
        words, bar = (self._canvas((0, 0, deep[2] - deep[0], height), PAPER) for height in (28, 18))
        seconds = f"   {moment / self.rate:.1f} s" if self.timed else ""
        words.text((words.wide, 14), f"frame {self.scene.clip.frames[moment]}{seconds}", 18, SOFT, "rm")
        bar.line((0, 9), (bar.wide, 9), 3, FAINT)
        done = moment / max(len(self.scene.clip.frames) - 1, 1)
        bar.line((0, 9), (bar.wide * done, 9), 3, SOFT)
        for top, drawn in ((20, words), (606, bar)):
            image.paste(drawn.finished(), self._corner((deep[0], top)))
        return image

    def _shared(self) -> Image.Image:
        scene, canvas = self.scene, _Canvas(self.size[0] / self.scale, HIGH, self.scale, PAPER)
        canvas.text((24, 34), scene.title[:60], 22, INK, "lm")
        at = 24.0
        legend = {"left": SIDES[1], "right": SIDES[2]} if any(scene.body.joint_sides) else {}
        legend |= {"unsure": _mixed(SIDES[0], PAPER, _PALE)} if scene.unsure.any() else {}
        for name, colour in legend.items():
            canvas.dot((at + 5, 615), 5, colour)
            canvas.text((at + 16, 615), name, 15, SOFT, "lm")
            at += 30 + 9 * len(name)
        return canvas.finished()

    def _canvas(self, card: tuple[int, int, int, int], back: Colour) -> _Canvas:
        return _Canvas(card[2] - card[0], card[3] - card[1], self.scale, back)

    def _corner(self, card: Sequence[int]) -> tuple[int, int]:
        return round(card[0] * self.scale), round(card[1] * self.scale)

    def _flat(self, moment: int) -> _Canvas:
        scene, canvas = self.scene, self._canvas(self._flat_card, CARD)
        scale = min(0.46 * canvas.wide / scene.flat_reach[0], 0.42 * canvas.high / scene.flat_reach[1])
        shift = np.array([canvas.wide / 2, canvas.high / 2 + 8]) - scene.flat_centre[moment] * scale
        if scene.image_size is not None:
            corners = np.array([[0.0, 0.0], list(scene.image_size)]) * scale + shift
            canvas.box(corners.ravel().tolist(), 0, None, FAINT)
        for who, points in enumerate(scene.keypoints[moment] * scale + shift):
            unsure = scene.unsure[moment, who]
            for (start, end), side in zip(scene.body.bones, scene.body.bone_sides, strict=True):
                if np.isfinite(points[[start, end]]).all():
                    pale = bool(unsure[start] or unsure[end])
                    canvas.line(points[start], points[end], 3 if pale else 4.5, _tone(side, -1.0, pale))
            for joint in np.flatnonzero(np.isfinite(points[:, 0])).tolist():
                canvas.dot(
                    points[joint], 5.5, _tone(scene.body.joint_sides[joint], -1.0, bool(unsure[joint])), rim=CARD
                )
            self._name(canvas, who, points)
        self._map(canvas, moment)
        canvas.text((16, 20), "keypoints", 15, SOFT, "lm")
        return canvas

    def _over(self, moment: int, photo: UInt8[np.ndarray, "height width 3"]) -> _Canvas:
        """Draw keypoints over the whole photo, in lines as thick as their body is large."""
        scene, canvas = self.scene, self._canvas(self._flat_card, CARD)
        assert self._video_size is not None
        wide, high = self._video_size
        scale = min(canvas.wide / wide, canvas.high / high)
        corner = np.array([(canvas.wide - wide * scale) / 2, (canvas.high - high * scale) / 2])
        canvas.photo(Image.fromarray(photo), (*corner, *(corner + [wide * scale, high * scale])))
        for who, points in enumerate(scene.keypoints[moment] * scale + corner):
            known = points[np.isfinite(points[:, 0])]
            if not len(known):
                continue
            thick = float(np.clip(np.ptp(known, axis=0).max() / 220, 0.3, 1.0))
            unsure, lines = scene.unsure[moment, who], []
            for (start, end), side in zip(scene.body.bones, scene.body.bone_sides, strict=True):
                if np.isfinite(points[[start, end]]).all():
                    lines.append((start, end, _tone(side, -1.0, bool(unsure[start] or unsure[end]))))
            for start, end, _ in lines:
                canvas.line(points[start], points[end], 7 * thick, CARD)
            for start, end, tone in lines:
                canvas.line(points[start], points[end], 4.5 * thick, tone)
            for joint in np.flatnonzero(np.isfinite(points[:, 0])).tolist():
                tone = _tone(scene.body.joint_sides[joint], -1.0, bool(unsure[joint]))
                canvas.dot(points[joint], 4.5 * thick, tone, rim=CARD)
            self._name(canvas, who, points)
        return canvas

    def _map(self, canvas: _Canvas, moment: int) -> None:
        """Draw the full image in a corner, a dot for each individual."""
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

    def _deep(self, moment: int) -> _Canvas:
        """Draw floor, shadows, then bones and joints from far to near."""
        scene, canvas = self.scene, self._canvas(self._deep_card, CARD)
        if scene.floor:
            self._floor(canvas, moment)
            for points in scene.points[moment]:
                _shadow(canvas, self._seen(canvas, points * [1.0, 0.0, 1.0], moment), scene.body.bones)
        parts, figures = [], [self._seen(canvas, points, moment) for points in scene.points[moment]]
        for points, unsure in zip(figures, scene.unsure[moment], strict=True):
            front = points[:, 2] - 0.15
            for (start, end), side in zip(scene.body.bones, scene.body.bone_sides, strict=True):
                if np.isfinite(points[[start, end], 0]).all():
                    depth = (points[start, 2] + points[end, 2]) / 2
                    front[[start, end]] = np.minimum(front[[start, end]], depth - 1e-3)
                    parts.append((depth, points[start], points[end], side, bool(unsure[start] or unsure[end])))
            for joint in np.flatnonzero(np.isfinite(points[:, 0])).tolist():
                parts.append((front[joint], points[joint], None, scene.body.joint_sides[joint], bool(unsure[joint])))
        for part in sorted(parts, key=lambda part: -part[0]):
            _stroke(canvas, *part[1:])
        for who, points in enumerate(figures):
            self._name(canvas, who, points)
        canvas.text((16, 20), "3D pose", 15, SOFT, "lm")
        return canvas

    def _floor(self, canvas: _Canvas, moment: int) -> None:
        """Draw squares that are fixed in the world and fade away from where the camera looks."""
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
                    canvas.line(start, end, 1.2, _mixed(FLOOR, CARD, 1 - min(1.0, 1.3 * float(strength))))

    def _seen(
        self, canvas: _Canvas, points: Float[np.ndarray, "points 3"], moment: int
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

    def _name(self, canvas: _Canvas, who: int, points: np.ndarray) -> None:
        known = points[np.isfinite(points[:, 0])]
        if len(self.scene.clip.individual_names) > 1 and len(known):
            canvas.text(
                (known[:, 0].mean(), known[:, 1].min() - 14), self.scene.clip.individual_names[who], 14, SOFT, "ms"
            )


def _stroke(canvas: _Canvas, start: np.ndarray, end: np.ndarray | None, side: int, pale: bool) -> None:
    depth = float(start[2] if end is None else (start[2] + end[2]) / 2)
    tone, thick = _tone(side, depth, pale), 6.5 * (1 - 0.3 * depth) * float(start[3])
    if end is None:
        canvas.dot(start, 0.85 * thick, tone, rim=CARD)
        return
    if not pale:
        canvas.line(start, end, thick + 3.5, CARD)
    canvas.line(start, end, 0.7 * thick if pale else thick, tone)


def _shadow(canvas: _Canvas, points: np.ndarray, bones: Int[np.ndarray, "bones 2"]) -> None:
    for bone in bones:
        if np.isfinite(points[bone, 0]).all():
            canvas.line(points[bone[0]], points[bone[1]], 6, SHADOW)
            for joint in bone:
                canvas.dot(points[joint], 2.9, SHADOW)


def _tone(side: int, depth: float, pale: bool) -> Colour:
    return _mixed(SIDES[side], CARD, _PALE if pale else 0.6 * ((depth + 1) / 2) ** 1.4)


# A canvas for the pictures of a film: smooth lines, dots and text in a few colours.

PAPER, CARD, INK, SOFT, FAINT = (246, 245, 241), (255, 254, 251), (34, 38, 43), (107, 113, 120), (220, 218, 210)
FLOOR, SHADOW = (207, 204, 194), (228, 226, 221)
SIDES = tuple(SIDE_COLOURS.values())
"""Colours of the centre, the left and the right."""
_SHARPEN = 2


def _mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Return ``colour`` with so much of ``other`` in it."""
    return tuple(round(a + (b - a) * share) for a, b in zip(colour, other, strict=True))


def film_palette() -> Image.Image:
    """Return an image with a palette of what the drawings blend."""
    ramps = [[_mixed(side, CARD, step / 24) for step in range(24)] for side in SIDES]
    ramps += [[_mixed(grey, CARD, step / 8) for step in range(8)] for grey in (SOFT, INK, FLOOR, SHADOW, FAINT)]
    ramps += [[_mixed(grey, PAPER, step / 10) for step in range(10)] for grey in (INK, SOFT, FAINT, *SIDES)]
    ramps += [[_mixed(side, SHADOW, 0.5) for side in SIDES], [CARD, PAPER]]
    colours = dict.fromkeys(colour for ramp in ramps for colour in ramp)
    # Pillow finds a near colour, not always the nearest: nothing else may be near the two large areas.
    areas = np.array([CARD, PAPER])
    colours = [one for one in colours if one in (CARD, PAPER) or np.abs(areas - one).max(1).min() > 8]
    image = Image.new("P", (1, 1))
    image.putpalette([part for colour in colours for part in colour])
    return image


class _Canvas:
    """A picture so many units wide and high, ``scale`` pixels to a unit, drawn larger and then reduced to smooth edges."""

    def __init__(self, wide: Number, high: Number, scale: Number, back: Colour):
        self.wide, self.high = wide, high
        self._unit = scale * _SHARPEN
        self._image = Image.new("RGB", (round(wide * scale) * _SHARPEN, round(high * scale) * _SHARPEN), back)
        self._draw = ImageDraw.Draw(self._image)

    def line(self, start: Point, end: Point, width: Number, colour: Colour) -> None:
        ends = [(float(point[0]) * self._unit, float(point[1]) * self._unit) for point in (start, end)]
        self._draw.line(ends, fill=colour, width=max(1, round(width * self._unit)))

    def dot(self, at: Point, radius: Number, colour: Colour, rim: Colour | None = None) -> None:
        x, y = float(at[0]) * self._unit, float(at[1]) * self._unit
        for size, fill in ((radius + 1.2, rim), (radius, colour)):
            if fill is not None:
                r = size * self._unit
                self._draw.ellipse([x - r, y - r, x + r, y + r], fill=fill)

    def photo(self, image: Image.Image, corners: Sequence[Number]) -> None:
        """Draw a photo between two corners."""
        left, top, right, bottom = (round(float(part) * self._unit) for part in corners)
        small = image.resize((max(1, right - left), max(1, bottom - top)), Image.Resampling.BILINEAR, reducing_gap=2)
        self._image.paste(small, (left, top))

    def box(self, corners: Sequence[Number], round_by: Number, fill: Colour | None, edge: Colour | None = None) -> None:
        places = [part * self._unit for part in corners]
        width = max(1, round(1.2 * self._unit))
        self._draw.rounded_rectangle(places, round_by * self._unit, fill=fill, outline=edge, width=width)

    def text(self, at: Point, words: str, size: Number, colour: Colour, anchor: str) -> None:
        font = ImageFont.load_default(size=round(size * self._unit))
        place = float(at[0]) * self._unit, float(at[1]) * self._unit
        self._draw.text(place, words, fill=colour, font=font, anchor=anchor)

    def finished(self) -> Image.Image:
        return self._image.reduce(_SHARPEN)
