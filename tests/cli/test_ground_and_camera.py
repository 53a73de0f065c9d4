"""ground= and camera.* of predict, end to end: what is said, and what the files hold."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bodies import refusal
from flat_runs import across_the_image, flat_run
from walks import FEET, GRAVITY

from uplift.cli.main import main
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.export.html import read_html
from uplift.models.known_camera import KnownCamera, about_cameras
from uplift.skeleton import load_skeleton

SIZE = ["bone=rhip,rknee,rankle", "bone_mm=860"]


@pytest.fixture
def words(here: Path) -> list[str]:
    """The words that lift the walk; it goes across the image, so that a flat lifter is not far off."""
    arrays = across_the_image()
    np.savez(here / "walk.npz", **arrays, focal_px=np.array(1145.0))
    np.savez(here / "unknown.npz", **arrays)
    np.savez(here / "nothing.npz", **{key: value for key, value in arrays.items() if key != "image_size"})
    return ["predict", f"run={flat_run(here)}", "input=walk.npz"]


def test_the_ground_is_said_written_and_drawn(words: list[str], here: Path, capsys: pytest.CaptureFixture):
    assert main([*words, "output=a.npz", "ground=true", "camera.tilt_deg=10", *SIZE]) == 0
    said = capsys.readouterr().out
    assert "camera: tilt 10.0 degrees, given; roll taken as 0; focal length given (1,145 px)" in said
    assert "ground: 1," in said and "mm below the camera, slope" in said and "feet in contact in" in said
    found = np.load(here / "a.npz")
    assert found["contact"].shape == (80, 17) and found["contact"][:, FEET].any(1).mean() > 0.5
    assert not np.delete(found["contact"], FEET, axis=1).any()
    way = np.linalg.norm(np.diff((found["pose"] + found["root"][:, None])[:, FEET], axis=0), axis=-1)
    stands = found["contact"][:, FEET]
    assert np.median(way[stands[1:] & stands[:-1]]) < 0.5
    assert abs(found["ground_point"][0] @ GRAVITY - 1500) < 200
    assert found["ground_normal"][0] @ -GRAVITY > np.cos(np.radians(4))
    assert main([*words, "output=a.json", "ground=true", "camera.tilt_deg=10", "axes=opensim", *SIZE]) == 0
    written = json.loads((here / "a.json").read_text())
    assert {"ground_point", "ground_normal", "contact"} <= set(written["fields"])
    np.testing.assert_allclose(written["frames"][3]["ground_normal"], [0, 1, 0], atol=0.07)  # y is up
    assert written["frames"][3]["contact"] == found["contact"][3].tolist()
    assert main([*words, "output=a.html", "ground=true", "camera.tilt_deg=10", *SIZE]) == 0
    floor = read_html(here / "a.html")["arrays"]["floor"]
    np.testing.assert_allclose(floor, found["ground_point"] @ GRAVITY, atol=1)


def test_what_the_ground_needs(words: list[str], here: Path, capsys: pytest.CaptureFixture):
    assert "ground=true needs millimetres: give height_mm=" in refusal(capsys, *words, "output=a.npz", "ground=true")
    others = [*words[:2], "output=b.npz", "ground=true", *SIZE]
    assert "or image_size= alone" in refusal(capsys, *others, "input=nothing.npz")
    assert not (here / "a.npz").exists() and not (here / "b.npz").exists()
    assert main([*others, "input=unknown.npz", "camera.tilt_deg=10"]) == 0
    said = capsys.readouterr().out
    assert "focal length not known" in said
    assert "the focal length is not known: 1000 px, the longest side of the image, is taken (focal_px=)" in said
    assert "ground: " in said and "sliding" in said
    any_camera = ["predict", f"run={flat_run(here, cameras='any')}", "input=unknown.npz", "output=d.npz"]
    assert main([*any_camera, "ground=true", "camera.tilt_deg=10", *SIZE]) == 0
    said = capsys.readouterr().out  # a lifter that corrects nothing leaves the longest side
    assert "focal length estimated (1,000 px)" in said and "not known" not in said and "sliding" in said
    hand = load_skeleton("hand21")
    np.savez(here / "hand.npz", keypoints=np.random.default_rng(0).uniform(0, 99, (9, 21, 2)), joint_names=hand.joints)
    assert main(["predict", f"run={flat_run(here, hand)}", "input=hand.npz", "output=c.npz", "ground=true"]) == 0
    assert "ground: poses are as they were lifted: the skeleton 'hand21' has no gravity" in capsys.readouterr().out


def test_a_known_tilt_and_roll_level_the_pose(words: list[str], here: Path, capsys: pytest.CaptureFixture):
    assert main([*words, "output=a.npz", "camera.tilt_deg=20", "camera.roll_deg=-30"]) == 0
    assert "camera: tilt 20.0 degrees, given; roll -30.0 degrees, given" in capsys.readouterr().out
    found = np.load(here / "a.npz")
    assert found["tilt_deg"][0] == pytest.approx(20, abs=1e-3)
    down = [0.5 * np.cos(np.radians(20)), np.cos(np.radians(30)) * np.cos(np.radians(20)), np.sin(np.radians(20))]
    np.testing.assert_allclose(found["gravity"], [down] * 80, atol=1e-5)
    np.testing.assert_allclose(found["level_pose"][..., 1], found["pose"] @ down, atol=1e-2)
    assert "from -90 to 90" in refusal(capsys, *words, "output=b.npz", "camera.tilt_deg=100")
    with pytest.raises(UserError, match=r"camera\.roll_deg=200.*-180 to 180"):
        KnownCamera(roll_deg=200.0)


def test_what_is_said_of_cameras():
    random = np.random.default_rng(0)
    tilt = np.radians(12 + random.normal(size=400) * 2)
    by_frame = np.stack([0 * tilt, np.cos(tilt), np.sin(tilt)], -1)
    used = np.tile([0, np.cos(np.radians(12)), np.sin(np.radians(12))], (400, 1))
    film = np.repeat([f"film {n}" for n in range(8)], 50)
    data = PoseData(np.ones((400, 3, 2)), np.ones((400, 3)), ("a", "b", "c"), focal_px=1145.0)
    (line,) = about_cameras(data, by_frame, used, KnownCamera())
    assert line.startswith("camera: tilt 12.0 +- 2.")
    assert line.endswith(" degrees, estimated from 400 frames; roll taken as 0; focal length given (1,145 px)")
    data.identity["sequence"] = film
    (line,) = about_cameras(data, by_frame, used, KnownCamera(roll_deg=3.0))
    assert line.startswith(
        "cameras of 8 clips: tilt 12.0 degrees (12.0 to 12.0), estimated from 400 frames; roll 3.0 degr"
    )
    few = data.select(np.arange(100))
    assert [line[:16] for line in about_cameras(few, by_frame[:100], used[:100], KnownCamera())] == [
        "camera of film 0", "camera of film 1",
    ]  # fmt: skip
