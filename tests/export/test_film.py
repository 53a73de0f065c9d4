"""Films: as many frames and as long as the clip, the figure where the poses are, nothing blank, limits kept."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from writers_samples import chain, prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.clips import one_clip
from uplift.export.film import (
    CARD,
    HIGH,
    SIDES,
    WIDE,
    FilmDrawing,
    FilmScene,
    film_palette,
    film_scene,
    gif_durations_ms,
    thinned,
    turns_deg,
    write_film,
)
from uplift.export.scene import in_axes, rotations_to
from uplift.models.ground import Ground
from uplift.models.prediction import Prediction

_LEFT_HALF, _RIGHT_HALF = slice(24, 536), slice(560, 1256)


def scene_of(sample: Prediction, rate: float = 30.0) -> FilmScene:
    return film_scene(sample, one_clip(sample, "a.gif"), rate)


def drawn(sample: Prediction, moment: int) -> np.ndarray:
    """Return a moment's picture, one pixel a unit."""
    return np.asarray(FilmDrawing(scene_of(sample), 1.0, 30.0, True).picture(moment)).astype(int)


def near(picture: np.ndarray, colour: tuple[int, ...], reach: int = 60) -> np.ndarray:
    """Return where the cards have nearly a colour, their words and the map left out."""
    found = np.abs(picture - np.array(colour)).max(-1) < reach
    found[:100], found[530:] = False, False
    return found


def test_a_gif_has_the_frames_and_lasts_as_long(tmp_path: Path) -> None:
    sample = prediction(frames=25, tilt=True)
    write_film(sample, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.size == (WIDE * 5 // 8, HIGH * 5 // 8) and film.n_frames == 25 and film.info["loop"] == 0
        shown, long = [], 0
        for frame in range(film.n_frames):
            film.seek(frame)
            long += film.info["duration"]
            shown.append(np.asarray(film.convert("RGB")).astype(int))
    assert long == pytest.approx(25 / 30 * 1000, abs=10)
    for one, other in pairwise(shown):
        assert 0.001 < (np.abs(one - other).max(-1) > 20).mean() < 0.3  # it moves, and most stands still
    assert all((np.abs(one - np.array(CARD)).max(-1) > 60).mean() > 0.01 for one in shown)


def test_an_mp4_has_the_frames_and_lasts_as_long(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    sample = prediction(frames=20, tilt=True, fps=12.5)
    write_film(sample, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height, stream.codec_context.pix_fmt) == (WIDE, HIGH, "yuv420p")
        assert stream.average_rate == 12.5 and film.duration / 1e6 == pytest.approx(1.6, abs=0.05)
        assert stream.codec_context.name == "h264"
        frames = [frame.to_ndarray(format="rgb24", dst_colorspace="ITU709") for frame in film.decode(stream)]
    assert len(frames) == 20
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # it plays before all of it has come
    want = np.asarray(FilmDrawing(scene_of(sample, 12.5), 1.0, 12.5, True).picture(9)).astype(int)
    assert np.abs(frames[9] - want).mean() < 3
    assert np.abs(frames[9][120, 60].astype(int) - CARD).max() <= 4  # the colours' matrix is told


def test_left_and_right_are_drawn_where_they_are() -> None:
    sample = prediction(frames=3)
    picture = drawn(sample, 0)
    for half in (_LEFT_HALF, _RIGHT_HALF):
        columns = np.arange(WIDE)[half]
        left, right = (near(picture, colour)[:, half].any(0) for colour in SIDES[1:])
        assert columns[left].mean() > columns[right].mean() + 20  # it faces the camera
        rows = [np.flatnonzero(near(picture, colour)[:490, half].any(1)) for colour in SIDES]
        assert rows[0].min() < rows[1].min() and rows[0].max() < rows[1].max()  # head above hands, hip above feet


def test_the_first_view_is_the_cameras_and_the_turn_shows_depth() -> None:
    sample = prediction(frames=40, tilt=True)
    scene = scene_of(sample)
    flat = FilmDrawing(replace(scene, floor=False), 1.0, 30.0, True)
    first = flat._seen(flat._canvas((0, 0, 500, 500), CARD), scene.points[0, 0], 0)
    level = sample.level_pose[0]
    assert np.corrcoef(first[:, 0], level[:, 0])[0, 1] > 0.99
    assert np.corrcoef(first[:, 1], level[:, 1])[0, 1] > 0.99
    quarter = replace(scene, turn_deg=np.full(40, 90.0), floor=False)
    side = FilmDrawing(quarter, 1.0, 30.0, True)
    turned = side._seen(side._canvas((0, 0, 500, 500), CARD), scene.points[0, 0], 0)
    assert np.corrcoef((turned[:, 0] - 250) / turned[:, 3], scene.points[0, 0, :, 2])[0, 1] > 0.99


@pytest.mark.parametrize("axes", ["level", "opensim", "blender", "opencv"])
def test_other_axes_are_the_same_film(axes: str) -> None:
    root = np.array([0, 500.0, 5000]) + np.cumsum(np.full((12, 3), 20.0), 0)
    sample = replace(prediction(frames=12, tilt=True), root=root)
    want, found = scene_of(sample), scene_of(in_axes(sample, axes))
    assert np.allclose(found.points, want.points, atol=1e-6) and np.allclose(found.centre, want.centre, atol=1e-6)


def test_the_floor_is_under_the_feet_and_the_camera_follows() -> None:
    sample = prediction(frames=60)
    feet = scene_of(sample).points[..., 1].max((1, 2))
    assert np.abs(feet).max() < 1e-9
    walking = replace(sample, root=np.linspace([0, 0, 4000], [9000, 0, 4000], 60))
    scene = scene_of(walking)
    assert np.percentile(scene.points[..., 1].max((1, 2)), 98) == pytest.approx(0, abs=1)
    assert scene.wide < 3000 and np.ptp(scene.centre[:, 0]) > 6000 and np.ptp(scene.centre[:, 1]) == 0
    assert not scene_of(prediction(frames=3, joints=5)).floor


def test_unsure_joints_are_pale() -> None:
    sample = prediction(frames=3)
    hand = sample.joint_names.index("lhand")
    assert not scene_of(sample).unsure.any()
    filled = replace(sample, filled=np.zeros((3, 7), bool))
    assert filled.filled is not None
    filled.filled[:, hand] = True
    weak = replace(sample, confidence=np.where(np.arange(7) == hand, 0.1, 1.0) * np.ones((3, 1)))
    missing = replace(weak, confidence=np.where(weak.confidence < 1, 0.0, 1.0))
    missing.keypoints = np.where(weak.confidence[..., None] < 1, np.nan, sample.keypoints)
    for changed in (filled, weak, missing):
        scene = scene_of(changed)
        assert scene.unsure[:, 0].nonzero()[1].tolist() == [hand] * 3
        assert np.isfinite(scene.keypoints).all()
        assert np.abs(scene.keypoints - scene_of(sample).keypoints).max() < 1
        fewer = near(drawn(changed, 1), SIDES[1]).sum()
        assert fewer < 0.75 * near(drawn(sample, 1), SIDES[1]).sum()


def test_what_is_not_there_is_not_drawn(tmp_path: Path) -> None:
    sample = prediction(frames=6, individuals=2)
    sample = sample.select(np.array([0, 1, 2, 3, 4, 5, 8, 9]))
    sample.pose[2] = np.nan
    sample.level_pose[2] = np.nan
    scene = scene_of(sample)
    there = np.isfinite(scene.points).all((2, 3))
    assert there.tolist() == [[True, False], [True, False], [False, True], [True, True], [True, False], [True, False]]
    middles = np.nanmean(scene.points[3, :, :, 0], axis=1)
    assert middles[1] - middles[0] == pytest.approx(1000, abs=100)  # 200 px at 0.2 px a mm
    write_film(sample, tmp_path / "a.gif")
    empty = replace(sample, pose=np.full_like(sample.pose, np.nan), confidence=np.zeros_like(sample.confidence))
    write_film(empty, tmp_path / "b.gif")


@given(st.integers(1, 5000), st.floats(1, 240))
def test_films_are_thinned_evenly_and_keep_their_duration(moments: int, rate: float) -> None:
    kept = thinned(moments, rate, 600, 34.0)
    step = set(np.diff(kept).tolist())
    assert kept[0] == 0 and len(kept) <= 600 and len(step) <= 1
    assert rate / (step or {1}).pop() <= 34.0 or len(kept) == 1
    durations = gif_durations_ms(len(kept), moments / rate)
    assert len(durations) == len(kept) and min(durations) >= 10 and all(ms % 10 == 0 for ms in durations)
    assert sum(durations) == pytest.approx(max(moments / rate, 0.02 * len(kept)) * 1000, abs=6)


@given(st.integers(1, 4000), st.floats(5, 60))
def test_the_camera_turns_slowly_and_comes_back(moments: int, rate: float) -> None:
    turn = turns_deg(moments, rate)
    assert turn[0] == 0 and len(turn) == moments
    change = np.abs(np.diff(np.append(turn, 0.0)))
    change = np.minimum(change, 360 * np.round(turn[-1] / 360) - turn[-1] if turn[-1] > 180 else change)
    assert np.abs(np.diff(turn)).max(initial=0) * rate < 60
    assert change[-1] * rate < 75 or moments < 3


def test_long_clips_are_short_gifs(tmp_path: Path) -> None:
    sample = prediction(frames=400, joints=3, fps=100.0)
    write_film(sample, tmp_path / "a.gif", fps=200)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 67  # every sixth, 34 a second at most
        long = 0
        for frame in range(film.n_frames):
            film.seek(frame)
            long += film.info["duration"]
    assert long == pytest.approx(2000, abs=10)


def test_seconds_are_told_where_a_rate_is_known() -> None:
    sample = prediction(frames=3)
    scene = scene_of(sample)
    told, not_told = (np.asarray(FilmDrawing(scene, 1.0, 30.0, timed).picture(2)) for timed in (True, False))
    differs = np.argwhere((told != not_told).any(-1))
    assert len(differs) and differs[:, 0].max() < 60 and differs[:, 1].min() > 1000


def test_the_palette_holds_the_drawing() -> None:
    picture = FilmDrawing(scene_of(prediction(frames=3, tilt=True)), 1.0, 30.0, True).picture(1)
    small = picture.quantize(palette=film_palette(), dither=Image.Dither.NONE).convert("RGB")
    gap = np.abs(np.asarray(picture).astype(int) - np.asarray(small)).max(-1)
    assert gap.mean() < 0.5 and np.percentile(gap, 99.5) < 25


def test_without_the_package_an_mp4_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(
        UserError, match=r"writing .mp4 needs av: pip install \"uplift3d\[video\]\". A .gif needs nothing more"
    ):
        write(prediction(frames=2), tmp_path / "a.mp4")
    write_film(prediction(frames=2), tmp_path / "a.gif")
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]


def test_a_film_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("av")
    folder, picture = tmp_path / "out", FilmDrawing.picture
    folder.mkdir()

    def full(self: FilmDrawing, moment: int, photo: None = None) -> Image.Image:
        if moment == 5:
            raise OSError("no space left")
        return picture(self, moment, photo)

    monkeypatch.setattr(FilmDrawing, "picture", full)
    with pytest.raises(OSError, match="no space left"):
        write_film(prediction(frames=8), folder / "a.mp4")
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("change", "name", "message"),
    [
        ({}, "a.avi", "a film is a .gif or an .mp4"),
        ({"identity": {"camera": np.repeat([0, 1], 4)}}, "a.gif", "one clip, found 2"),
    ],
)
def test_what_a_film_cannot_be_is_one_message(tmp_path: Path, change: dict, name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        write_film(prediction(frames=8, **change), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_other_skeletons_and_one_frame(tmp_path: Path) -> None:
    write_film(prediction(frames=1, fps=None), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 1
    assert chain(4).gravity is False
    write_film(prediction(frames=2, joints=4), tmp_path / "b.gif")


def test_importing_the_writers_loads_no_heavy_package() -> None:
    code = "import sys, uplift.export.film, uplift.export.glb, uplift.export.bvh;"
    code += "print([name for name in ('torch', 'trimesh', 'av', 'scipy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_floor_is_the_ground_that_was_found():
    sample = prediction(20, rooted=True)  # its feet are 600 below the camera
    assert sample.root is not None
    level = in_axes(sample, "level")
    low = level.points[..., 1].max(1)
    up, down = (np.tile(tilt, (20, 1)) for tilt in ([0.0, -1.0, 0.0], [0.0, 650.0, 4000.0]))
    rotation = rotations_to(sample, "level")[0]
    ground = Ground(down @ rotation, up @ rotation, np.zeros(sample.confidence.shape, bool))
    for name in ("camera", "blender"):
        scene = scene_of(in_axes(replace(sample, ground=ground), name))
        np.testing.assert_allclose(scene.points[:, 0, :, 1].max(1), low - 650, atol=1e-3)
