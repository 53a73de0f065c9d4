"""Frames of videos and pictures: numbers, times, sizes, and what is wrong with hostile ones."""

import os
import struct
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from videos import numbered, shown, write_sound, write_video

from uplift.errors import UserError
from uplift.video.frames import is_frames, open_frames


@pytest.fixture(scope="module")
def av():
    return pytest.importorskip("av", reason="the extra `video` is not installed")


def _all(source, **options):
    with open_frames(source, **options) as frames:
        return frames, list(frames)


# Videos.


@pytest.mark.parametrize(
    ("name", "codec", "fps"),
    [
        ("a.mp4", "libx264", 30),
        ("a.mkv", "mpeg4", 30000 / 1001),  # its times are in whole milliseconds
        ("a.avi", "mpeg4", 12.5),
        ("a.webm", "libvpx-vp9", 60),
        ("a.mov", "mjpeg", 240),
        ("a.ts", "libx264", 25),
    ],
)
def test_every_frame_comes_once_in_order_with_its_time(av, tmp_path, name, codec, fps):
    kept = numbered(31)
    frames, found = _all(write_video(tmp_path / name, kept, fps=fps, codec=codec, sound=name == "a.mp4"))
    assert [shown(frame.image) for frame in found] == list(range(31))
    assert [frame.index for frame in found] == list(range(31))
    assert frames.fps == pytest.approx(fps, rel=1e-3)
    np.testing.assert_allclose([frame.time_s for frame in found], np.arange(31) / fps, atol=2e-3)
    assert (frames.width, frames.height, frames.is_video, frames.notes) == (64, 48, True, ())
    assert frames.count in (30, 31, 32)
    red = found[0].image[4:20, 4:28].reshape(-1, 3).mean(0)
    assert red[0] > 200 and red[1] < 60 and red[2] < 60


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_rotation_in_the_file_is_applied(av, tmp_path, quarter):
    image = numbered(1)[0]
    frames, found = _all(write_video(tmp_path / "a.mp4", [image] * 3, turn_deg=90 * quarter))
    expected = np.rot90(image, quarter)  # both counter-clockwise
    assert (frames.height, frames.width) == expected.shape[:2] == found[0].image.shape[:2]
    assert np.abs(found[0].image.astype(int) - expected).mean() < 12


def test_a_phone_held_upright(av, tmp_path):
    """The matrix that phones write for 'turn by 90 degrees clockwise' (QuickTime File Format, matrix structure)."""
    path = write_video(tmp_path / "a.mp4", numbered(3))
    data = path.read_bytes()
    plain = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    turned = struct.pack(">9i", 0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30)
    header = data.index(b"tkhd")
    path.write_bytes(data[:header] + data[header:].replace(plain, turned, 1))
    _, found = _all(path)
    assert found[0].image.shape == (64, 48, 3)
    assert found[0].image[8:24, 32:44, 0].mean() > 200  # what was at the upper left is at the upper right
    assert found[0].image[8:24, 4:16, 0].mean() < 60


def test_pixels_that_are_not_square_become_square(av, tmp_path):
    frames, found = _all(write_video(tmp_path / "a.mkv", numbered(3), aspect=Fraction(4, 3)))
    assert (frames.width, frames.height) == (85, 48) and found[0].image.shape == (48, 85, 3)
    assert "not square" in frames.notes[0]


def test_a_varying_rate_keeps_times(av, tmp_path):
    """A frame too late by 3 steps, one that is not there, and one too much: numbers are times."""
    numbers = [0, 1, 2, 3, 7, 8, 9, 9.1, 11, 12, 13, 14, 15]
    path = write_video(tmp_path / "a.mp4", numbered(13), times_s=np.array(numbers) / 30, codec="libx264")
    frames, found = _all(path)
    assert frames.fps == pytest.approx(30, rel=0.01)
    assert [frame.index for frame in found] == [0, 1, 2, 3, 7, 8, 9, 11, 12, 13, 14, 15]
    assert [shown(frame.image) for frame in found] == [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]
    assert "4 numbers have no frame, 1 frames came too early" in frames.notes[0]
    _, stored = _all(path, as_stored=True)
    assert [frame.index for frame in stored] == [shown(frame.image) for frame in stored] == list(range(13))


def test_small_jitter_is_no_varying_rate(av, tmp_path):
    rng = np.random.default_rng(0)
    times = np.arange(200) / 30 + rng.uniform(0, 0.6, 200) / 30
    frames, found = _all(write_video(tmp_path / "a.mp4", [numbered(1)[0]] * 200, times_s=times, codec="libx264"))
    assert [frame.index for frame in found] == list(range(200)) and frames.notes == ()


def test_cuts_keep_numbers_and_times(av, tmp_path):
    path = write_video(tmp_path / "a.mp4", numbered(30), codec="libx264", fps=10)
    frames, found = _all(path, start_s=0.7, end_s=1.5)
    assert [frame.index for frame in found] == [shown(frame.image) for frame in found] == list(range(7, 15))
    assert frames.count == 8 and found[0].time_s == pytest.approx(0.7)
    with pytest.raises(UserError, match=r"start_s=9 is after the end of .*lasts 3.0 s"):
        open_frames(path, start_s=9)
    with pytest.raises(UserError, match="not after"):
        open_frames(path, start_s=2, end_s=1)


def test_a_cut_off_video_gives_what_it_has(av, tmp_path):
    path = write_video(tmp_path / "a.mkv", [np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)] * 40)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    frames, found = _all(path)
    assert "may be cut off" in frames.notes[-1]
    assert 5 < len(found) < 35 and [frame.index for frame in found] == list(range(len(found)))
    moved = tmp_path / "b.mp4"  # an mp4 has its index at the end
    whole = write_video(moved, numbered(40)).read_bytes()
    moved.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="cut off or damaged"):
        open_frames(moved)


def test_damage_in_the_middle_is_noted(av, tmp_path):
    path = write_video(tmp_path / "a.mp4", numbered(60), codec="libx264")
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    data[start + 2000 : start + 2600] = b"\xff" * 600
    path.write_bytes(data)
    frames, found = _all(path)
    assert found and frames.notes


def test_what_is_no_video_is_said_in_one_line(av, tmp_path):
    sound = write_sound(tmp_path / "sound.mp4")
    (tmp_path / "text.mp4").write_text("#EXTM3U\n#EXTINF:1,\nfile:///etc/hostname\n")
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "noise.avi").write_bytes(os.urandom(5000))
    os.mkfifo(tmp_path / "pipe.mp4")
    for name, expected in {
        sound.name: "sound",
        "text.mp4": "not a video",
        "empty.mp4": "empty",
        "noise.avi": "not a video",
        "pipe.mp4": "pipe or a device",
        "absent.mp4": "No file",
    }.items():
        with pytest.raises(UserError, match=expected) as refused:
            open_frames(tmp_path / name)
        assert "\n" not in str(refused.value)


def test_a_frame_that_is_too_large_is_refused_before_it_is_decoded(av, tmp_path, monkeypatch):
    monkeypatch.setattr("uplift.video.video_file.MAX_PIXELS", 1000)
    with pytest.raises(UserError, match="64 x 48 px, the most is"):
        open_frames(write_video(tmp_path / "a.mp4", numbered(2)))


def test_a_long_video_opens_without_reading_it(av, tmp_path):
    """Ten hours at one frame in forty seconds, and what is read of the file to open it and to cut a piece out of it."""
    times = np.arange(900) * 40.0
    path = write_video(tmp_path / "a.mp4", [numbered(1)[0]] * 900, times_s=times, fps=1)
    frames, found = _all(path, start_s=30000, end_s=30200)
    assert frames.fps == pytest.approx(1 / 40) and [frame.index for frame in found] == [750, 751, 752, 753, 754]


def test_without_the_extra_one_line_names_it(monkeypatch, tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UserError, match=r'pip install "uplift3d\[video\]"'):
        open_frames(tmp_path / "a.mp4")


# Pictures.


def _photo(path: Path, size=(40, 30), exif=None) -> Path:
    image = Image.fromarray(numbered(1, size)[0])
    image.save(path, quality=95, **({"exif": exif} if exif else {}))
    return path


def test_pictures_of_a_folder_come_in_natural_order(tmp_path):
    for number in (10, 2, 1):
        _photo(tmp_path / f"shot{number}.png")
    _photo(tmp_path / "shot3.png", size=(50, 30))
    (tmp_path / "shot4.jpg").write_bytes(b"no picture")
    for source in (tmp_path, tmp_path / "*.*g"):
        frames, found = _all(source)
        assert [frame.name for frame in found] == ["shot1.png", "shot2.png", "shot3.png", "shot10.png"]
        assert [frame.index for frame in found] == [0, 1, 2, 4]
        assert (frames.width, frames.height, frames.fps, frames.count, frames.is_video) == (40, 30, None, 5, False)
        assert "1 pictures cannot be read: shot4.jpg" in frames.notes[0] and "shot3.png (50 x 30)" in frames.notes[1]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_of_a_photo_is_applied(tmp_path, orientation):
    """EXIF 2.32, tag 0x0112: where row 0 and column 0 of the stored picture are on what was seen."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    _, (found,) = _all(_photo(tmp_path / "a.jpg", exif=exif))
    stored = numbered(1, (40, 30))[0]
    top, left = {1: "tl", 2: "tr", 3: "br", 4: "bl", 5: "lt", 6: "rt", 7: "rb", 8: "lb"}[orientation]
    shape = (30, 40) if orientation < 5 else (40, 30)
    assert found.image.shape[:2] == shape
    red = found.image[..., 0].astype(int) - found.image[..., 1] > 100
    rows, columns = red[:, [0, -1]].any(1), red[[0, -1]].any(0)
    corner = ("t" if rows[0] else "b") + ("l" if columns[0] else "r")
    assert sorted(corner) == sorted(top + left) and stored[0, 0, 0] == 255


def test_focal_length_by_exif(tmp_path):
    def focal(size=(400, 300), **tags):
        exif = Image.Exif()
        names = {"mm": 0x920A, "film": 0xA405, "plane": 0xA20E, "unit": 0xA210, "wide": 0xA002, "high": 0xA003}
        exif[0x8769] = {names[name]: value for name, value in tags.items()}
        with open_frames(_photo(tmp_path / "a.jpg", size, exif)) as frames:
            return frames.focal_px

    assert focal() is None
    # 50 mm on 36 x 24 mm film is a diagonal field of view of 46.8 degrees.
    assert focal(film=50) == pytest.approx(250 / np.tan(np.radians(46.793 / 2)), rel=1e-4)
    assert focal(mm=4.0, plane=2000.0, unit=3) == pytest.approx(800)  # 4 mm at 200 px a mm
    assert focal(mm=4.0, plane=2540.0, unit=2, wide=800, high=600) == pytest.approx(200)  # stored at half the size
    assert focal(film=50, wide=400, high=200) is None  # cut since
    assert focal(film=0) is None and focal(film=60000) is None


def test_pictures_that_are_none(tmp_path, monkeypatch):
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    whole = _photo(tmp_path / "b.jpg", (400, 300)).read_bytes()
    (tmp_path / "c.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "e").mkdir()
    for name, expected in {
        "a.jpg": "cannot be read",
        "c.jpg": "damaged",
        "e": "no picture",
        "d.png": "No file",
    }.items():
        with pytest.raises(UserError, match=expected) as refused:
            open_frames(tmp_path / name)
        assert "\n" not in str(refused.value)
    with pytest.raises(UserError, match="expected one video, or pictures alone"):
        open_frames(f"{tmp_path / 'b.jpg'},{_photo(tmp_path / 'f.png').rename(tmp_path / 'f.mp4')}")
    monkeypatch.setattr("uplift.video.pictures.MAX_PIXELS", 1000)
    with pytest.raises(UserError, match="larger than"):
        open_frames(tmp_path / "b.jpg")


def test_deep_grey_levels_are_stretched(tmp_path):
    values = np.linspace(1000, 5000, 1200).reshape(30, 40).astype(np.uint16)
    Image.fromarray(values).save(tmp_path / "a.tif")
    _, (found,) = _all(tmp_path / "a.tif")
    assert found.image.min() == 0 and found.image.max() == 255 and found.image.shape == (30, 40, 3)


def test_what_is_taken_for_frames(tmp_path):
    pictures, tracked = tmp_path / "pictures", tmp_path / "tracked"
    for folder in (pictures, tracked):
        folder.mkdir()
        _photo(folder / "a.png")
    (tracked / "CollectedData.csv").write_text("scorer\n")
    yes = ["a.mp4", "A.MOV", "x/b.jpg", "camera:0", "*.png", "a.jpg,b.jpg", str(pictures)]
    no = ["a.csv", "a.npz", "a.json", str(tracked), str(tmp_path), "cmu:test", "a.mp4,b.csv", "", "my.py:Set:test"]
    assert [is_frames(name) for name in yes] == [True] * len(yes)
    assert [name for name in no if is_frames(name)] == []


# Cameras.


def test_a_camera_that_is_not_there(av):
    with pytest.raises(UserError, match=r"^camera:77: no /dev/video77 on this machine"):
        open_frames("camera:77")
    with pytest.raises(UserError, match="no camera"):
        open_frames("camera:/dev/null")
    with pytest.raises(UserError, match="goes with a video"):
        open_frames("camera:0", start_s=1)
