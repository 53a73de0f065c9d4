"""What made-up furniture stands on: legs, turned legs, sledges, pedestals, stars of castors."""

from __future__ import annotations

import numpy as np

from uplift.meshes.procedural.parts import Builder, Part, ball, beam, block, lathe, rod

__all__ = ["add_feet", "draw_feet", "turned_leg"]

_FEET = ("square", "tapered", "splayed", "turned", "sledge", "pedestal", "star", "cantilever", "panels")
_WEIGHTS = (0.22, 0.15, 0.15, 0.1, 0.08, 0.06, 0.14, 0.05, 0.05)
_CORNERS = ((1, 1), (1, -1))


def draw_feet(rng: np.random.Generator) -> str:
    """Return what kind of feet a chair stands on."""
    return str(rng.choice(_FEET, p=_WEIGHTS))


def add_feet(built: Builder, rng: np.random.Generator, kind: str, size: tuple[float, float, float], top: float) -> None:
    """Add feet below a seat or a table's top: ``size`` is its width in front, at the back, and its depth."""
    makers = {"sledge": _sledge, "pedestal": _pedestal, "star": _star, "cantilever": _cantilever, "panels": _panels}
    if kind in makers:
        makers[kind](built, rng, size, top)
    else:
        _legs(built, rng, kind, size, top)


def _legs(built: Builder, rng: np.random.Generator, kind: str, size: tuple[float, float, float], top: float) -> None:
    thick = rng.uniform(0.03, 0.065)
    inset = rng.uniform(0.45, 1.2) * thick
    splay = rng.uniform(0.05, 0.22) * top if kind == "splayed" else rng.uniform(0, 0.05) * top
    backwards = rng.uniform(0.0, 0.15) * top
    feet = {}
    for side, end in _CORNERS:
        x = (size[0] if end > 0 else size[1]) / 2 - inset
        z = end * (size[2] / 2 - inset)
        out = splay if end > 0 else splay + backwards
        head, foot = (x, top, z), (x + side * splay * 0.7, 0.0, z + end * out)
        feet[end] = head, foot
        if kind == "turned":
            built.pair(turned_leg(rng.integers(1 << 30), foot, head, thick))
        elif kind == "splayed":
            built.pair(rod(foot, head, thick * 0.35, thick * 0.55))
        else:
            small = 1.0 if kind == "square" else 0.5
            built.pair(beam(foot, head, (thick * small, thick * small), (thick, thick)))
    if rng.random() < 0.35:
        _stretchers(built, rng, feet, thick)


def _stretchers(built: Builder, rng: np.random.Generator, feet: dict, thick: float) -> None:
    """Add rungs between the legs, low or high."""
    share = rng.uniform(0.2, 0.6)
    points = {end: np.add(foot, share * np.subtract(head, foot)) for end, (head, foot) in feet.items()}
    radius = thick * rng.uniform(0.2, 0.35)
    built.pair(rod(points[1], points[-1], radius, sides=6))
    kind = rng.choice(["H", "box", "none"])
    if kind == "H":
        middle = (points[1] + points[-1]) / 2
        built.add(rod(middle, middle * (-1, 1, 1), radius, sides=6))
    elif kind == "box":
        for point in points.values():
            built.add(rod(point, point * (-1, 1, 1), radius, sides=6))


def turned_leg(seed: int, foot: tuple, head: tuple, thick: float) -> Part:
    """Return a leg turned on a lathe: the same for the same seed."""
    rng = np.random.default_rng(seed)
    shares = np.array([0, 0.04, 0.1, 0.2, 0.45, 0.6, 0.66, 0.7, 0.78, 1.0])
    radii = np.array([0.35, 0.45, 0.28, 0.4, 0.55, 0.35, 0.6, 0.4, 0.6, 0.55]) * thick
    part = lathe(radii * rng.uniform(0.75, 1.25, len(radii)), shares, sides=8)
    vertices = part.vertices.copy()
    rise = vertices[:, 1:2].copy()
    vertices[:, 1] = 0
    return Part(vertices + np.add(foot, rise * np.subtract(head, foot)), part.faces)


def _sledge(built: Builder, rng: np.random.Generator, size: tuple[float, float, float], top: float) -> None:
    """Add two frames at the sides that stand on their runners."""
    thick, front, back = rng.uniform(0.02, 0.05), rng.uniform(0.75, 1.05), rng.uniform(0.75, 1.15)
    x, low = size[1] / 2 - thick / 2, thick / 2
    ends = [(x, low, front * size[2] / 2), (x, low, -back * size[2] / 2)]
    built.pair(beam(ends[0], ends[1], (thick, thick), across="xy"))
    for end, share in zip(ends, (0.85, -0.85), strict=True):
        built.pair(beam((end[0], 0, end[2]), (x, top, share * size[2] / 2), (thick, thick)))


def _pedestal(built: Builder, rng: np.random.Generator, size: tuple[float, float, float], top: float) -> None:
    """Add one column on a round plate."""
    plate = rng.uniform(0.32, 0.5) * min(size[0], size[2])
    column = rng.uniform(0.025, 0.06)
    rise = rng.uniform(0.015, 0.05)
    built.add(
        lathe(
            (plate, plate, column * 1.3, column, column, column * 1.8),
            (0, rise, rise * 1.8, 0.3 * top, 0.85 * top, top),
            sides=16,
        )
    )


def _star(built: Builder, rng: np.random.Generator, size: tuple[float, float, float], top: float) -> None:
    """Add a swivel chair's foot: a column on four or five arms, most with castors."""
    arms, column = rng.integers(4, 6), rng.uniform(0.02, 0.04)
    reach = rng.uniform(0.42, 0.62) * (size[0] + size[2]) / 2
    castor = rng.choice([0.0, rng.uniform(0.022, 0.035)], p=[0.25, 0.75])
    hub = 2 * castor + rng.uniform(0.03, 0.1)
    turned = rng.choice([np.pi / 2, rng.uniform(0, 2 * np.pi)])
    built.add(
        lathe(
            (column * 1.7, column * 1.7, column, column, column * 3),
            (hub - 0.03, hub + 0.06, hub + 0.08, top - 0.04, top),
            sides=10,
        )
    )
    for angle in turned + 2 * np.pi * np.arange(arms) / arms:
        x, z = reach * np.cos(angle), reach * np.sin(angle)
        built.add(rod((0, hub, 0), (x, 2 * castor + 0.015, z), column, column * 0.6, sides=6))
        if castor > 0:
            built.add(ball((x, castor, z), (castor * 0.9, castor, castor * 0.9)))


def _cantilever(built: Builder, rng: np.random.Generator, size: tuple[float, float, float], top: float) -> None:
    """Add runners that rise at the front only."""
    thick = rng.uniform(0.02, 0.035)
    x, front, back = size[1] / 2 - thick, size[2] / 2 - thick, -size[2] / 2
    built.pair(rod((x, thick / 2, front), (x, thick / 2, back), thick / 2))
    built.pair(rod((x, 0, front), (x, top, front), thick / 2))
    built.pair(rod((x, top - thick / 2, front), (x, top - thick / 2, back), thick / 2))
    built.add(rod((-x, thick / 2, back), (x, thick / 2, back), thick / 2))


def _panels(built: Builder, rng: np.random.Generator, size: tuple[float, float, float], top: float) -> None:
    """Add a full board at either side, and sometimes one behind."""
    thick = rng.uniform(0.02, 0.05)
    built.pair(block((size[1] / 2 - thick, 0, -size[2] / 2), (size[1] / 2, top, size[2] / 2)))
    if rng.random() < 0.5:
        low = rng.uniform(0, 0.6) * top
        built.add(block((-size[1] / 2, low, -size[2] / 2), (size[1] / 2, top, -size[2] / 2 + thick)))
