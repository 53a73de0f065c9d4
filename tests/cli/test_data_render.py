"""The verb data render: masks of meshes and of made-up shapes, in a file or a folder."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from uplift.cli.data_render import render_masks_command
from uplift.cli.main import main
from uplift.data.formats.masks_npz import read_masks_npz
from uplift.errors import UserError


def render(words: str, *more: str) -> list[str]:
    return render_masks_command([*shlex.split(words), *more])


@pytest.fixture
def wedges(tmp_path: Path) -> Path:
    """Return a folder of a long box and a high one, in the axes that glTF has."""
    (tmp_path / "wedges").mkdir()
    for name, size in (("long", (1, 1, 4)), ("high", (1, 4, 1))):
        trimesh.creation.box(size).export(tmp_path / f"wedges/{name}.obj")
    return tmp_path / "wedges"


def elevations(view: np.ndarray) -> np.ndarray:
    """Return how far down each camera looks, in degrees: gravity is its y turned towards z."""
    return np.degrees(np.arctan2(view[:, 2, 1], view[:, 1, 1]))


def test_made_up_shapes_need_no_files(tmp_path: Path) -> None:
    said = render(f"furniture items=12 side=32 seed=3 output={tmp_path / 'a.npz'}")
    data = read_masks_npz(tmp_path / "a.npz")
    assert data.masks.shape == (12, 32, 32)
    assert data.truth is not None
    assert len(data.truth.meshes) == 12
    assert said[-1] == f"next: uplift fit task=masks data.train={tmp_path / 'a.npz'}"
    render(f"furniture items=12 side=32 seed=3 output={tmp_path / 'b.npz'}")
    np.testing.assert_array_equal(read_masks_npz(tmp_path / "b.npz").masks, data.masks)
    render(f"furniture items=12 side=32 seed=4 output={tmp_path / 'c.npz'}")
    assert (read_masks_npz(tmp_path / "c.npz").masks != data.masks).any()


def test_files_are_seen_from_where_it_is_said(wedges: Path, tmp_path: Path) -> None:
    words = "items=40 azimuth_deg=0,0 elevation_deg=0,0 distance=inf,inf"
    render(f"'{wedges}' {words} output={tmp_path / 'a.npz'}")
    data = read_masks_npz(tmp_path / "a.npz")
    assert data.truth is not None
    assert data.category is not None
    assert set(data.category.tolist()) == {"long", "high"}
    assert np.bincount(data.truth.shape).tolist() == [20, 20]
    np.testing.assert_allclose(data.truth.view, np.tile(np.eye(3), (40, 1, 1)), atol=1e-6)
    # From in front, without perspective, the long box is a square and the high one a strip.
    shares = (data.masks / 255.0).mean((1, 2))
    np.testing.assert_allclose(shares[data.category == "long"], 0.85**2, rtol=0.02)
    np.testing.assert_allclose(shares[data.category == "high"], 0.85**2 / 4, rtol=0.1)


def test_views_have_the_angles_that_were_asked_for(wedges: Path, tmp_path: Path) -> None:
    render(f"'{wedges}' items=300 side=8 elevation_deg=-30,5 views=3 output={tmp_path / 'a.npz'}")
    truth = read_masks_npz(tmp_path / "a.npz").truth
    assert truth is not None
    found = elevations(truth.view)
    np.testing.assert_allclose([found.mean(), found.std()], [-30, 5], atol=1.5)
    assert (truth.shape.reshape(-1, 3) == truth.shape[::3, None]).all()
    render(f"'{wedges}' items=300 side=8 upright=false output={tmp_path / 'b.npz'}")
    anyhow = read_masks_npz(tmp_path / "b.npz").truth
    assert anyhow is not None
    np.testing.assert_allclose(anyhow.view.mean(0), np.zeros((3, 3)), atol=0.15)


def test_axes_of_files_are_told(wedges: Path, tmp_path: Path) -> None:
    words = "azimuth_deg=0,0 elevation_deg=0,0 items=2 side=16 category=box"
    render(f"'{wedges}/long.obj' up=z front=y {words} output={tmp_path / 'a.npz'}")
    data = read_masks_npz(tmp_path / "a.npz")
    assert data.truth is not None
    assert data.category is not None
    assert data.category.tolist() == ["box"] * 2
    np.testing.assert_allclose(np.ptp(data.truth.meshes[0].vertices, axis=0), [0.45, 1.8, 0.45], rtol=1e-4)


def test_a_folder_has_a_picture_for_each_mask(wedges: Path, tmp_path: Path) -> None:
    render(f"'{wedges}' items=12 side=24 output={tmp_path / 'out'}")
    data = read_masks_npz(tmp_path / "out/truth.npz")
    files = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.png"))
    assert files == sorted(data.names)
    assert {name.split("/")[0] for name in files} == {"long", "high"}
    for name, mask in zip(data.names, data.masks, strict=True):
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "out" / name)), mask)
    with pytest.raises(UserError, match="exists already and is not empty"):
        render(f"'{wedges}' items=12 output={tmp_path / 'out'}")


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("mine")
    with pytest.raises(UserError, match="is not overwritten"):
        render(f"furniture output={tmp_path / 'a.npz'}")
    assert (tmp_path / "a.npz").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("output=a.npz", "takes files of meshes, folders of them, or simulated shapes"),
        ("furniture", "needs output="),
        ("furnitur output=a.npz", "no file, folder or family of shapes 'furnitur'. Did you mean 'furniture'"),
        ("none.obj output=a.npz", "no such file"),
        ("furniture chairs output=a.npz", "goes alone"),
        ("furniture up=z output=a.npz", "up= goes with files"),
        ("furniture output=a.png", "ends in .npz, or a folder"),
        ("furniture output=no/a.npz", "Create it first"),
        ("furniture item=4 output=a.npz", "Did you mean 'items'"),
        ("furniture items=0 output=a.npz", "items=0, expected a whole number from 1"),
        ("furniture items=many output=a.npz", "expected a whole number"),
        ("furniture side=5000 output=a.npz", "from 8 to 1,024"),
        ("furniture side=1024 items=1000000 output=a.npz", "take 1,049 GB"),
        ("furniture seed=-1 output=a.npz", "seed=-1"),
        ("furniture elevation_deg=15 output=a.npz", "expected mean,spread"),
        ("furniture elevation_deg=15,-1 output=a.npz", "expected mean,spread"),
        ("furniture azimuth_deg=90,-90 output=a.npz", "the lower number first"),
        ("furniture azimuth_deg=nan,0 output=a.npz", "expected from,to, numbers"),
        ("furniture distance=0,1 output=a.npz", "distance=0,1"),
        ("furniture upright=maybe output=a.npz", "expected true or false"),
        ("furniture upright=false azimuth_deg=0,1 output=a.npz", "has no effect"),
    ],
)
def test_mistakes_are_told(words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=message):
        render(words)
    assert list(tmp_path.iterdir()) == []


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "render", "chairs", "items=3", f"output={tmp_path / 'a.npz'}"]) == 0
    assert f"wrote {tmp_path / 'a.npz'}: 3 masks of 64 x 64 px" in capsys.readouterr().out
    assert main(["data", "render", str(tmp_path), f"output={tmp_path / 'b.npz'}"]) == 2
    assert "no mesh files" in capsys.readouterr().err


def test_animals_are_rendered_in_their_own_poses(benchmark_data: Callable[[str], Path], tmp_path: Path) -> None:
    files = [str(benchmark_data(f"animal_meshes/{name}.glb")) for name in ("Husky", "Stag")]
    assert render(f"poses=5 items=10 output={tmp_path / 'a.npz'}", *files)[0] == "10 meshes of 2 files"
    data = read_masks_npz(tmp_path / "a.npz")
    assert data.category is not None
    assert data.truth is not None
    assert sorted(data.category.tolist()) == ["Husky"] * 5 + ["Stag"] * 5
    # Outward faces: the volume of every pose is positive, and the front legs are in front.
    for mesh in data.truth.meshes:
        assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume > 0.01
