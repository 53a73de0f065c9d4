"""Images and categories as COCO's annotations hold them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uplift.errors import UserError
from uplift.readers.json_file import is_text, shown

__all__ = ["Category", "Image", "category_of", "common_size", "image_of", "lines_of", "plain", "text_of"]


@dataclass
class Image:
    name: str
    size: tuple[int, int] | None
    video: str | None
    frame: Any


@dataclass
class Category:
    name: str
    joints: tuple[str, ...] | None
    """None: the category has no keypoints."""
    edges: list[Any]


def image_of(record: dict[str, Any], where: str) -> tuple[Any, Image]:
    """Return the id and the rest of an image; raises UserError where it has none."""
    number, name = plain(record.get("id"), where, "id"), record.get("file_name", record.get("id"))
    video = record.get("video_id", record.get("vid_id"))
    width, height = record.get("width"), record.get("height")
    size = None
    if isinstance(width, int) and isinstance(height, int) and 0 < width < 10**6 and 0 < height < 10**6:
        size = (width, height)
    return number, Image(str(plain(name, where, "file_name")), size, text_of(video), record.get("frame_id"))


def category_of(record: dict[str, Any], where: str) -> tuple[Any, Category]:
    """Return the id and the rest of a category; raises UserError where its keypoints are no names."""
    joints, edges = record.get("keypoints"), record.get("skeleton")
    if joints is not None and not (isinstance(joints, list) and all(is_text(joint) for joint in joints)):
        raise UserError(f"{where} has keypoints {shown(joints)}, expected a list of names.")
    number = plain(record.get("id"), where, "id")
    edges = edges if isinstance(edges, list) else []
    return number, Category(str(record.get("name", number)), tuple(joints) if joints else None, edges)


def lines_of(category: Category, joints: tuple[str, ...], notes: list[str]) -> tuple[tuple[str, str], ...]:
    """Return the lines of a category by name; their places count from 1."""
    good = [
        edge
        for edge in category.edges
        if isinstance(edge, list)
        and len(edge) == 2
        and all(type(place) is int and 1 <= place <= len(joints) for place in edge)
    ]
    if len(good) < len(category.edges):
        notes.append(f"{len(category.edges) - len(good)} lines of the file's skeleton name no keypoint: left out")
    return tuple((joints[a - 1], joints[b - 1]) for a, b in good)


def common_size(images: list[Image]) -> tuple[int, int] | None:
    sizes = {image.size for image in images}
    return sizes.pop() if len(sizes) == 1 else None


def plain(value: Any, where: str, what: str) -> Any:
    """Return a number or name as it is; raises UserError for lists, nothing and the like."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise UserError(f"{where}: '{what}' is {shown(value)}, expected a number or a name.")
    return value


def text_of(value: Any) -> str | None:
    return str(value) if isinstance(value, int | str) and not isinstance(value, bool) and value != "" else None
