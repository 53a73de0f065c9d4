"""The page of lifted shapes: what it embeds and escapes, and in headless Chromium that it draws, turns and sorts."""

from __future__ import annotations

import base64
import io
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_browser import Browser, Page
from PIL import Image
from shape_samples import AZIMUTH, TILT, marked, shapes, view

from uplift.data.masks import Placed
from uplift.errors import UserError
from uplift.export import write
from uplift.export.html import read_html
from uplift.export.shape_page import shape_page_text, write_shape_page
from uplift.geometry.mesh import Mesh
from uplift.geometry.surface import surface_of
from uplift.models.prediction import ShapePrediction

_NASTY = '</script><script>alert(1)</script><b>"it\'s" & {{data}} <!--'
Open = Callable[..., Page]


def _truth(sample: ShapePrediction, mirrored: bool = False) -> Placed:
    """Return the very shape as its own truth, or its mirror image."""
    mesh = surface_of(marked()).mesh
    assert mesh is not None
    mesh = replace(mesh, vertices=mesh.vertices * [-1.0 if mirrored else 1.0, 1, 1])
    rows = np.zeros(len(sample), int)
    return Placed([mesh], rows, sample.view, sample.scale, sample.offset, sample.distance)


def test_page_embeds_the_shapes_and_where_they_stand(tmp_path: Path) -> None:
    sample = shapes(3)
    write_shape_page(sample, tmp_path / "a.html", truth=_truth(sample), smooth=0)
    data = read_html(tmp_path / "a.html")
    assert [one["name"] for one in data["items"]] == sample.names and data["side"] == 64
    # Three lifted shapes, one true one that all show.
    assert len(data["meshes"]) == 4 and {one["truth"]["mesh"] for one in data["items"]} == {3}
    mesh = surface_of(marked()).mesh
    assert mesh is not None
    vertices, faces = data["meshes"][0]
    corners, triangles = data["arrays"]["vertices"][:vertices], data["arrays"]["faces"][:faces].astype(int)
    np.testing.assert_allclose(corners.min(0), mesh.vertices.min(0), atol=0.01)
    np.testing.assert_allclose(corners.max(0), mesh.vertices.max(0), atol=0.01)
    assert triangles.max() == vertices - 1
    volume = (
        np.einsum("fi,fi->", corners[triangles[:, 0]], np.cross(corners[triangles[:, 1]], corners[triangles[:, 2]])) / 6
    )
    own = np.einsum(
        "fi,fi->",
        mesh.vertices[mesh.faces[:, 0]],
        np.cross(mesh.vertices[mesh.faces[:, 1]], mesh.vertices[mesh.faces[:, 2]]),
    )
    assert volume == pytest.approx(own / 6, rel=0.02)
    np.testing.assert_allclose(np.reshape(data["items"][0]["view"], (3, 3)), sample.view[0], atol=1e-4)
    np.testing.assert_allclose(data["arrays"]["masks"][:64] * 255, sample.masks[0], atol=255 / 30 + 0.1)


def test_text_is_escaped_and_the_network_is_shut_out() -> None:
    sample = shapes(2, [_NASTY, "b"])
    sample.title = _NASTY
    text = shape_page_text(sample, notes=[_NASTY], sections=[(_NASTY, [(_NASTY, 1.0)])])
    assert text.count("alert(1)") == 6 and "<script>alert" not in text
    assert "default-src 'none'" in text and "http" not in text.split("<main>")[1].split('id="data"')[0]


def test_a_shape_and_its_truth_take_fifty_kilobytes() -> None:
    few, more = shapes(2), shapes(8)
    sizes = [
        len(shape_page_text(one, truth=replace(_truth(one), meshes=_turned(len(one)), shape=np.arange(len(one)))))
        for one in (few, more)
    ]
    assert (sizes[1] - sizes[0]) / 6 < 50_000  # a hundred stay below five megabytes


def _turned(count: int) -> list[Mesh]:
    mesh = surface_of(marked()).mesh
    assert mesh is not None
    return [replace(mesh, vertices=mesh.vertices @ view(0.1, number).T) for number in range(count)]


def test_more_items_than_asked_for_are_spread_evenly(tmp_path: Path) -> None:
    sample = shapes(9)
    write_shape_page(sample, tmp_path / "a.html", items=3, scores={"volume IoU": np.arange(9) / 10})
    data = read_html(tmp_path / "a.html")
    assert [one["name"] for one in data["items"]] == ["item 0", "item 3", "item 6"]
    assert [one["scores"] for one in data["items"]] == [[0.0], [0.3], [0.6]]
    assert "3 of 9 shapes are shown" in (tmp_path / "a.html").read_text()


def test_items_have_names_for_people_and_keep_their_own(tmp_path: Path) -> None:
    names = ["chairs-2147483648-0:0", "photos/a.jpg:7", "photos/a.jpg:9", "b.png"]
    sample = shapes(4)
    sample.names = names
    write_shape_page(sample, tmp_path / "a.html")
    data = read_html(tmp_path / "a.html")
    assert [one["name"] for one in data["items"]] == ["chairs 1", "a.jpg · 1", "a.jpg · 2", "b.png"]
    assert [one["id"] for one in data["items"]] == names


def test_photos_are_cut_to_the_crop(tmp_path: Path) -> None:
    sample = shapes(3)
    pixels = np.zeros((440, 640, 3), np.uint8)
    pixels[320:, :320] = (255, 0, 0)  # left of and below the crop's centre
    (tmp_path / "photos").mkdir()
    Image.fromarray(pixels).save(tmp_path / "photos" / "a.png")
    (tmp_path / "photos" / "broken.png").write_text("no photo")
    (tmp_path / "secret.png").write_bytes((tmp_path / "photos" / "a.png").read_bytes())
    sample.images = np.array(["somewhere/a.png", "broken.png", "../secret.png"])
    write_shape_page(sample, tmp_path / "a.html", images=tmp_path / "photos")
    items = read_html(tmp_path / "a.html")["items"]
    assert [bool(one.get("photo")) for one in items] == [True, False, False]
    photo = np.asarray(Image.open(io.BytesIO(base64.b64decode(items[0]["photo"].partition(",")[2]))).convert("RGB"))
    side = len(photo)
    assert photo[int(0.7 * side), side // 4, 0] > 200 and photo[int(0.7 * side), 3 * side // 4].max() < 60
    assert photo[side // 4, side // 4].max() < 60 and abs(int(photo[-2, side // 4, 0]) - 128) < 12  # below the photo
    assert "1 photos could not be read" in (tmp_path / "a.html").read_text()
    with pytest.raises(UserError, match="no such folder"):
        shape_page_text(sample, images=tmp_path / "none")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"items": 0}, "at least one"),
        ({"scores": {"volume IoU": [1.0]}}, "volume IoU has 1 rows, expected 2"),
        ({"truth": _truth(shapes(1))}, "truth has 1 rows"),
    ],
)
def test_mistakes_are_told(options: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        shape_page_text(shapes(2), **options)


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Open:
    """Return a function that writes a prediction's page and opens it."""

    def opened(sample: ShapePrediction, page: str | None = None, **more: Any) -> Page:
        write(sample, tmp_path / "page.html", page=page, **more)
        return Page(browser, tmp_path / "page.html", 760, 700)

    return opened


@pytest.mark.parametrize("distance", [np.inf, 2.5])
def test_the_silhouette_lies_on_the_mask(show: Open, distance: float) -> None:
    page = show(shapes(1, distance=distance))
    assert page.state()["agree"] > 0.96
    assert page.ink("deep")[0] > 5000 and not page.troubles()


def test_silhouettes_of_the_true_shape_are_compared_from_all_sides(
    show: Open, browser: Browser, tmp_path: Path
) -> None:
    sample = shapes(1)
    page = show(sample, truth=_truth(sample))
    assert min(page.state()["turns"]) > 0.97
    write_shape_page(sample, tmp_path / "mirrored.html", truth=_truth(sample, mirrored=True))
    page = Page(browser, tmp_path / "mirrored.html", 760, 700)
    assert min(page.state()["turns"]) < 0.85


def test_a_phone_hits_every_button_and_swipes_past_the_shape(browser: Browser, tmp_path: Path) -> None:
    sample = shapes(2)
    write_shape_page(sample, tmp_path / "a.html", truth=_truth(sample))
    page = Page(browser, tmp_path / "a.html", 390, 700)
    assert page.small_targets() == [] and page.run("document.documentElement.scrollWidth") <= 390
    before = page.state()
    page.run("scrollTo(0, 0)")
    page.swipe("deep", down=-250)
    page.until("scrollY > 100")
    assert page.state()["turn"] == before["turn"]
    page.swipe("deep", across=-120)
    assert page.state()["turn"] > 0.5


def test_it_turns_by_keys_pointer_and_buttons(show: Open) -> None:
    page = show(shapes(3))
    before = page.ink("deep")
    turned = page.key("a")
    assert turned["turn"] > 0 and page.ink("deep") != before
    assert page.key("s")["lift"] > 0 and page.key("0")["turn"] == 0
    x, y = page.middle("deep")
    page.mouse("mousePressed", x, y, button="left", clickCount=1)
    page.mouse("mouseMoved", x + 60, y + 20, button="left", buttons=1)
    page.mouse("mouseReleased", x + 60, y + 20, button="left", clickCount=1)
    state = page.state()
    assert state["turn"] < 0 < state["lift"]  # what is in front follows the pointer
    front = page.key("2")
    assert front["turn"] == pytest.approx(-AZIMUTH, abs=1e-4) and front["lift"] == pytest.approx(-TILT, abs=1e-4)
    assert page.key("5")["lift"] == pytest.approx(np.pi / 2 - TILT, abs=1e-4)
    page.run("document.querySelectorAll('#turns button')[2].click()")
    assert page.state()["turn"] == pytest.approx(np.pi / 2)
    assert page.key("ArrowRight")["item"] == 1 and page.key("ArrowLeft")["item"] == 0
    assert page.key("r")["spin"] and page.key("r")["spin"] is False
    time.sleep(0.3)
    assert page.state()["painted"] == page.state()["painted"]  # at rest nothing is drawn


def test_the_photo_and_the_uncertainty_are_painted_on_the_shape(show: Open, tmp_path: Path) -> None:
    sample = shapes(1)
    sample.images = np.array(["a.png"])
    Image.new("RGB", (640, 640), (30, 60, 200)).save(tmp_path / "a.png")
    sample.uncertainty = np.zeros_like(sample.occupancy)
    sample.uncertainty[:, :, :16] = 0.5  # the upper half
    page = show(sample, images=tmp_path)

    def mean() -> list[float]:
        return page.run(
            "(() => { const c = document.getElementById('deep'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, s = [0, 0, 0];"
            "let n = 0; for (let k = 0; k < d.length; k += 4) if (d[k + 3] === 255) { n++; for (const a of [0, 1, 2]) s[a] += d[k + a]; }"
            "return s.map((v) => v / n); })()"
        )

    red, green, blue = mean()
    assert blue > 2 * red and blue > 1.5 * green
    page.key("u")
    doubtful = mean()
    assert doubtful[0] > red + 30  # the upper half is orange, the lower one blue
    page.key("u")
    page.key("p")
    clay = mean()
    assert clay[0] > clay[2] and page.run("document.querySelector('[data-toggle=doubt]').checkVisibility()")
    (tmp_path / "page.html").unlink()
    plain = show(shapes(1))
    assert not plain.run("document.querySelector('[data-toggle=doubt]').checkVisibility()") and not plain.troubles()


def test_the_gallery_opens_at_all_items_sorts_and_opens_one(show: Open) -> None:
    sample = shapes(7)
    sample.occupancy[3] = 0
    page = show(sample, "gallery", scores={"volume IoU": [0.5, 0.4, 0.3, float("nan"), 0.1, 0.6, 0.7]})
    assert page.state()["sheet"]
    page.until("uplift.state().tiles === 7")
    assert "no surface" in page.run("document.body.textContent") or "empty" in page.run("document.body.textContent")
    page.run(
        "(() => { const by = document.getElementById('by'); by.value = 'volume IoU'; by.dispatchEvent(new Event('change')); })()"
    )
    order = page.run("[...document.querySelectorAll('.tile')].map((tile) => Number(tile.dataset.item))")
    assert order == [3, 4, 2, 1, 0, 5, 6]
    page.run("document.querySelector('.tile').focus()")
    page.key("ArrowRight")
    assert page.run("document.activeElement.dataset.item") == "4"
    page.run("document.activeElement.click()")
    assert (page.state()["sheet"], page.state()["item"]) == (False, 4)
    assert page.key("ArrowRight")["item"] == 2 and page.key("g")["sheet"]
    assert not page.troubles()


def test_shapes_without_any_surface_are_a_page_too(show: Open) -> None:
    sample = shapes(1)
    sample.occupancy[:] = 0
    page = show(sample)
    assert page.state()["agree"] == 0 and not page.troubles()
    assert "1 of 1 shapes have no surface" in page.run("document.body.textContent")
