"""Every metric of one lifted shape against its truth."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Bool

from uplift.evaluation.shape_silhouette import SIDE, Silhouette, drawn, overlap, seen_iou, silhouette, turns
from uplift.evaluation.shape_standing import Standing, true
from uplift.evaluation.shape_surface import Surface, compare_surfaces, grid_surface, mesh_surface
from uplift.evaluation.shape_volume import handedness, volume_iou
from uplift.masks.container import Placed
from uplift.meshes.mesh import Mesh

__all__ = ["TrueItem", "score_item"]


class TrueItem:
    """One true shape where it stands, and what every prediction of it is compared with, made once."""

    def __init__(self, truth: Placed, row: int, filled: Bool[np.ndarray, "depth height width"]) -> None:
        self.mesh: Mesh = truth.meshes[int(truth.shape[row])]
        self.standing: Standing = true(truth, row, filled)
        self.turns = turns(np.asarray(truth.view[row], np.float64))
        self.longest = float(np.ptp(self.mesh.vertices, axis=0).max()) * float(truth.scale[row])

    @cached_property
    def surface(self) -> Surface:
        """Of the mesh."""
        return mesh_surface(self.mesh, self.standing)

    @cached_property
    def pixel(self) -> float:
        """Side of a pixel of the new views: `SIDE` of them span the bounding sphere about the shape's origin."""
        corners = self.mesh.vertices[np.unique(self.mesh.faces)] @ self.standing.matrix.T
        return 2 * float(np.linalg.norm(corners, axis=1).max(initial=1e-9)) / SIDE

    @cached_property
    def silhouettes(self) -> list[Silhouette]:
        """Of the mesh in the new views."""
        points = self.mesh.vertices @ self.standing.matrix.T
        return [drawn(points @ turn.T, self.mesh.faces, self.standing.distance, self.pixel) for turn in self.turns]

    def turned(self, shape: Standing, turn: np.ndarray) -> Standing:
        """Return a shape turned about the truth's origin."""
        return shape.turned(turn, self.standing.origin)


def score_item(found: Standing, truth: TrueItem, mask: np.ndarray) -> dict[str, float]:
    """Return the metrics of one shape; the depths of the centroids are brought together for all but the seen view."""
    seen = seen_iou(found, mask)
    found = found.moved(truth.standing.depth - found.depth)
    volume = volume_iou(found, truth.standing)
    new = [
        overlap(silhouette(truth.turned(found, turn), truth.pixel), true_one)
        for turn, true_one in zip(truth.turns, truth.silhouettes, strict=True)
    ]
    return {
        "volume_iou": volume,
        "silhouette_iou_seen": seen,
        "silhouette_iou_unseen": float(np.mean(new)),
        **compare_surfaces(grid_surface(found), truth.surface, truth.longest),
        "handedness": handedness(found, truth.standing, volume),
    }
