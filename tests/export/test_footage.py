"""Frames behind the 2D: the right image at each moment, of videos and of pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from videos import numbered, shown, write_video
from writers_samples import prediction

from uplift.errors import UserError
from uplift.export import write
from uplift.export.clips import arrange, one_clip
from uplift.export.film import HIGH, WIDE, write_film
from uplift.export.footage import Footage, every_frame

_SIZE = (64, 48)


def _sample(numbers, source="keypoints.csv", **more):
    identity = {"sequence": np.repeat("a", len(numbers)), "frame": np.array(numbers)}
    return prediction(len(numbers), identity=identity, source=source, **{"image_size": _SIZE, **more})


def _numbers(footage, clip, moments):
    return {moment: shown(image) for moment, image in footage.images(clip, moments, alone=True)}


@pytest.fixture
def video(tmp_path):
    pytest.importorskip("av")
    return write_video(tmp_path / "a.mp4", numbered(30), codec="libx264")


def test_each_moment_has_the_frame_of_its_number(video):
    sample = _sample([2, 5, 8, 20])
    clip = one_clip(sample, "x.mp4")
    assert _numbers(Footage(video, sample), clip, [0, 1, 3]) == {0: 2, 1: 5, 3: 20}
    whole = every_frame(clip)
    assert whole.frames == (2, 5, 8, 11, 14, 17, 20) and whole.moment.tolist() == [0, 1, 2, 6]
    assert _numbers(Footage(video, sample), whole, range(7)) == dict(enumerate(whole.frames))
    late = _sample([28, 29, 30, 31])
    assert _numbers(Footage(video, late), one_clip(late, "x.mp4"), range(4)) == {0: 28, 1: 29}


def test_numbers_of_a_varying_rate_are_times_for_our_own_keypoints_alone(tmp_path):
    pytest.importorskip("av")
    at = [0, 1, 2, 3, 8, 9, 10, 11]
    video = write_video(tmp_path / "a.mp4", numbered(8), times_s=np.array(at) / 30, codec="libx264")
    own, tracked = _sample(at, source=str(video)), _sample(range(8))
    assert list(_numbers(Footage(video, own), one_clip(own, "x"), range(8)).values()) == list(range(8))
    assert list(_numbers(Footage(video, tracked), one_clip(tracked, "x"), range(8)).values()) == list(range(8))


def test_videos_go_with_clips_by_name(video, tmp_path):
    write_video(tmp_path / "b.mp4", numbered(30)[10:])
    identity = {"sequence": np.repeat(["b", "a", "c"], 4), "frame": np.tile(np.arange(4), 3)}
    sample = prediction(12, identity=identity, image_size=_SIZE)
    clips = arrange(sample.identity, 12)
    footage = Footage(f"{video},{tmp_path / 'b.mp4'}", sample)
    assert footage.of(clips, 3) == [True, True, False]
    assert [shown(next(footage.images(clip, [1], alone=False))[1]) for clip in clips[:2]] == [11, 1]
    with pytest.raises(UserError, match="3 clips, and none has its name"):
        Footage(video.rename(tmp_path / "x.mp4"), sample).of(clips, 3)


def test_pictures_go_by_name_or_by_number(tmp_path):
    for number, image in enumerate(numbered(12)):
        Image.fromarray(image).save(tmp_path / f"shot{number}.png")
    names = np.array(["shot7.png", "shot10.png"])
    named = replace(_sample([0, 1]), identity={"image": names})
    footage, clips = Footage(tmp_path, named), arrange(named.identity, 2)
    assert [shown(next(footage.images(clip, [0], alone=False))[1]) for clip in clips] == [7, 10]
    counted = _sample([3, 11])
    assert _numbers(Footage(tmp_path, counted), one_clip(counted, "x"), [0, 1]) == {0: 3, 1: 11}


def test_a_video_of_something_else_is_refused(video):
    with pytest.raises(UserError, match="64 x 48 px, the keypoints are in images of 640 x 300"):
        Footage(video, _sample([0, 1], image_size=(640, 300)))
    sample = _sample([50, 51])
    with pytest.raises(UserError, match="none of the frames of the keypoints, which are 50 to 51"):
        list(Footage(video, sample).images(one_clip(sample, "x"), [0, 1], alone=True))
    assert Footage(video, _sample([0, 1], image_size=(640, 480))).image_size == (640, 480)  # found in a larger copy


def test_an_overlay_shows_the_video_under_its_keypoints(tmp_path):
    av = pytest.importorskip("av")
    video = write_video(tmp_path / "a.mp4", numbered(9, (128, 96)), codec="libx264", sound=True)
    sample = _sample([0, 1, 2, 6, 7, 8], image_size=(640, 480))
    write_film(sample, tmp_path / "overlay.mp4", video=video)
    with av.open(str(tmp_path / "overlay.mp4")) as film:
        stream = film.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24", dst_colorspace="ITU709") for frame in film.decode(stream)]
        assert not film.streams.audio and stream.average_rate == 30
    assert len(frames) == 9  # those without anybody too
    wide = round(528 * 4 / 3)
    card = np.stack([frame[64:592, 24 : 24 + wide].astype(int) for frame in frames])
    assert np.abs(card[:, 8:200, 12:300] - (255, 0, 0)).mean() < 12  # the upper left quarter is red
    greys = card[:, 480:520, wide - 60 : wide - 20].mean((1, 2, 3))
    np.testing.assert_allclose(greys, 8 * np.arange(9), atol=3)
    hip = (sample.keypoints[0, 0] / 640 * wide).round().astype(int)
    assert np.abs(card[0, hip[1], hip[0]] - card[0, 300, wide - 20]).max() > 40  # a joint is drawn where it is
    two = replace(sample, identity={**sample.identity, "sequence": np.repeat(["a", "other"], 3)})
    write(two, tmp_path / "two.gif", video=video)
    sizes = [Image.open(tmp_path / f"two_{name}.gif").size for name in ("a", "other")]
    assert sizes[1] == (WIDE * 5 // 8, HIGH * 5 // 8) != sizes[0]  # a video goes with the clip of its name alone
    write_film(sample, Path(tmp_path / "overlay.gif"), video=video)
    with Image.open(tmp_path / "overlay.gif") as film:
        assert film.n_frames == 9
