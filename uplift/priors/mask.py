"""Missing joints fit the body's mask: bones lie inside it, and every part of it is near a bone."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample

from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.priors.base import Lift, Prior
from uplift.priors.imputation import impute_gaussian
from uplift.skeleton import Skeleton

__all__ = ["Mask", "into_crop", "sample_field", "segment_distances", "signed_distances", "soft_gap", "unit_of"]

# Signed distances of image points to a mask, with a gradient everywhere.

_MOST = 64
"""Pixels along a field; finer masks are averaged down."""
_FIELD_CHUNK = 1024
_EMPTY = 2.0


def signed_distances(masks: UInt8[Tensor, "frames side side"]) -> Float[Tensor, "frames side side"]:
    """Return each pixel's signed Euclidean distance to the edge of the mask, positive outside; half a crop is 1.

    Everything beyond the crop is outside. The result has half precision.
    """
    from scipy.ndimage import distance_transform_edt

    side = min(masks.shape[1], _MOST)
    found = torch.empty((len(masks), side, side), dtype=torch.float16)
    for start in range(0, len(masks), _FIELD_CHUNK):
        some = masks[start : start + _FIELD_CHUNK].float().cpu()
        if some.shape[1] > side:
            some = adaptive_avg_pool2d(some.unsqueeze(1), side).squeeze(1)
        for place, inside in enumerate(some.numpy() > 127):
            if not inside.any():
                found[start + place] = _EMPTY
                continue
            framed = np.pad(inside, 1)
            out = distance_transform_edt(~framed)[1:-1, 1:-1]  # type: ignore[index]
            within = distance_transform_edt(framed)[1:-1, 1:-1]  # type: ignore[index]
            # The edge is half a pixel from the centres on either side of it.
            signed = np.where(inside, 0.5 - within, out - 0.5) * (2 / side)
            found[start + place] = torch.from_numpy(signed.astype(np.float16))
    return found.to(masks.device)


def into_crop(
    points: Float[Tensor, "frames points 2"], mask_map: Float[Tensor, "frames 3 3"]
) -> Float[Tensor, "frames points 2"]:
    """Return where points are in their frame's crop, -1 to 1 over it (`uplift.data.poses.mask_maps`)."""
    mapped = torch.baddbmm(mask_map[:, None, :, 2], points, mask_map[..., :2].mT)
    return mapped[..., :2] / mapped[..., 2:].clamp_min(1e-6)


def sample_field(
    field: Float[Tensor, "frames side side"], points: Float[Tensor, "frames points 2"]
) -> Float[Tensor, "frames points"]:
    """Return the signed distance at points, interpolated between pixels and extended beyond the crop."""
    edge = 1 - 1 / field.shape[1]  # the outermost pixels' centres
    within = points.clamp(-edge, edge)
    beyond = ((points - within).square().sum(-1) + 1e-12).sqrt() - 1e-6
    value = grid_sample(field.unsqueeze(1).to(points.dtype), within.unsqueeze(2), align_corners=False)
    return value[:, 0, :, 0] + beyond


def unit_of(mask_map: Float[Tensor, "frames 3 3"]) -> Float[Tensor, " frames"]:
    """Return the length of half a crop in the units of the keypoints, at the root."""
    last = mask_map[:, 2, 2, None, None]
    jacobian = mask_map[:, :2, :2] / last - mask_map[:, :2, 2:] / last**2 * mask_map[:, 2:, :2]
    return torch.linalg.det(jacobian).abs().clamp_min(1e-12).rsqrt()


# Bones as capsules in the image: distances to them, and their thickness as measured on masks.

_EPS = 1e-6
_QUANTILE = 0.8
_FEWEST = 50
_SOFT = 0.05


def segment_distances(
    points: Float[Tensor, "frames points 2"], ends: Float[Tensor, "frames bones 2 2"]
) -> Float[Tensor, "frames points bones"]:
    """Return the distance of each point to each bone, a segment between two points."""
    start, along = ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]
    # Products of matrices: no tensor of all points, bones and axes.
    ahead = points @ along.mT - (start * along).sum(-1).unsqueeze(1)
    length = along.square().sum(-1).unsqueeze(1)
    away = points.square().sum(-1, keepdim=True) + start.square().sum(-1).unsqueeze(1) - 2 * points @ start.mT
    share = (ahead / (length + _EPS)).clamp(0, 1)
    return (away - share * (2 * ahead - share * length)).clamp_min(_EPS).sqrt()


def soft_gap(
    distances: Float[Tensor, "frames points bones"], thickness: Float[Tensor, " bones"]
) -> Float[Tensor, "frames points"]:
    """Return how far each point is from the soft union of the capsules; 0 inside it."""
    return (-_SOFT * torch.logsumexp((thickness - distances) / _SOFT, -1)).clamp_min(0)


def _bone_thickness(
    points: Float[Tensor, "frames points 2"], keypoints: Float[Tensor, "frames joints 2"], bones: Int[Tensor, "bones 2"]
) -> Float[Tensor, " bones"]:
    """Return the thickness of each bone: the distance of most of the mask's ``points`` that are nearest to it."""
    distance, nearest = segment_distances(points, keypoints[:, bones]).min(-1)
    found = torch.full((len(bones),), torch.nan, dtype=points.dtype, device=points.device)
    for bone in range(len(bones)):
        near = distance[nearest == bone]
        if len(near) >= _FEWEST:
            found[bone] = near.quantile(_QUANTILE)
    usual = found.nanmedian() if found.isfinite().any() else found.new_tensor(0.1)
    return torch.where(found.isfinite(), found, usual)


_ALONG = (1 / 3, 2 / 3, 1.0)
_SAMPLE = 1000
_PIXELS = 200
_USUAL = 0.8
_CHUNK = 256
_CANDIDATES = 16
_FEW_INSIDE = 0.5


class Mask(Prior):
    """Projected bones as capsules against the mask of the same frame.

    Points along the bones should not be outside the mask, beyond what is usual for bones with visible ends, and
    points of the mask should be near a capsule. Frames without a mask cost nothing.

    Both terms are about the image alone, as the camera saw it: they move joints that the lifter fills in (or
    corrects), and do not constrain the depth of visible joints.

    Args:
        skeleton: of the poses.
        inside: weight of how far points along the bones are outside the mask, summed over the bones.
        explained: weight of how far points of the mask, as many as there are bones, are from the nearest capsule.
        thickness: factor on the capsules' thickness, which is measured on the masks.
        pixels: points of each mask that count, taken where no visible bone explains it.
    """

    ranges: ClassVar = {"pixels": (1, 4096)}

    bones: Tensor
    partners: Tensor
    along: Tensor
    radii: Tensor
    """(bones,) thickness, in units."""
    usual: Tensor
    """(bones along), how far bones with visible ends are outside their masks, in units."""
    field: Tensor
    unexplained: Tensor
    share: Tensor

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        inside: float = 1.0,
        explained: float = 1.0,
        thickness: float = 1.0,
        pixels: int = 16,
    ):
        super().__init__(skeleton)
        for name, value in (("inside", inside), ("explained", explained), ("thickness", thickness)):
            if value < 0:
                raise UserError(f"priors.mask.{name}={value}: expected at least 0.")
        if pixels < 1:
            raise UserError(f"priors.mask.pixels={pixels}: expected at least 1.")
        self.inside, self.explained, self.thickness, self.pixels = inside, explained, thickness, pixels
        # `prepare` measures all of them anew, so no checkpoint contains them; the last three have a row per frame.
        buffers = {
            "bones": torch.tensor(skeleton.bone_indices),
            "partners": torch.tensor(skeleton.bone_mirror_permutation),
            "along": torch.tensor(_ALONG),
            **dict.fromkeys(("radii", "usual", "field", "unexplained", "share"), torch.zeros(0)),
        }
        for name, value in buffers.items():
            self.register_buffer(name, value, persistent=False)

    def prepare(self, data: TrainingSet) -> None:
        """Measure distances to every mask, the thickness of bones, and where visible bones do not explain a mask.

        Raises:
            UserError: no masks, or keypoints that mostly lie outside them.
        """
        if data.masks is None or data.mask_map is None or not bool(data.mask_map.isfinite().any()):
            raise UserError(
                "priors.mask: no training frame has a mask. Give the data `masks` (frames, side, side) and `mask_box` "
                "(frames, 3), or leave the prior out: priors.mask.weight=0."
            )
        self.field = signed_distances(data.masks)
        self._measure(data)
        frames = torch.arange(len(data), device=self.field.device)
        found = [self._unexplained(data, rows) for rows in frames.split(_CHUNK)]
        self.unexplained, self.share = (torch.cat(parts) for parts in zip(*found, strict=True))

    def _measure(self, data: TrainingSet) -> None:
        """Measure thickness and how far visible bones are outside their masks, on the frames with most joints."""
        assert data.mask_map is not None
        masked = data.mask_map[:, 2, 2].isfinite().nonzero()[:, 0]
        order = (data.confidence[masked] > 0).sum(1).argsort(descending=True, stable=True)
        rows = masked[order[:_SAMPLE]]
        maps, seen, keypoints = data.mask_map[rows], data.confidence[rows] > 0, data.keypoints[rows]
        at = sample_field(self.field[rows], into_crop(keypoints, maps))
        share = float(((at <= 2 / self.field.shape[1]) & seen).sum() / seen.sum().clamp_min(1))
        if share < _FEW_INSIDE:
            raise UserError(
                f"priors.mask: {share:.0%} of the keypoints lie in their frame's mask. `mask_box` is x0, y0, side of each "
                "crop in px of the image that the keypoints are in; row 0 of a mask is its top."
            )
        outside = sample_field(self.field[rows], into_crop(self._points(keypoints), maps))
        outside = outside.unflatten(1, (-1, len(_ALONG))).clamp_min(0) * unit_of(maps)[:, None, None]
        both = seen[:, self.bones].all(-1)
        usual = torch.where(both.unsqueeze(-1), outside, torch.nan).nanquantile(_USUAL, 0).nan_to_num()
        pixels = _picked(self.field[rows] < 0, _PIXELS)
        complete = impute_gaussian(keypoints, data.confidence[rows])
        thick = _bone_thickness(_out_of_crop(pixels, maps), complete, self.bones)
        if self.skeleton.has_mirror_image:
            usual, thick = (usual + usual[self.partners]) / 2, (thick + thick[self.partners]) / 2
        self.usual, self.radii = usual, thick * self.thickness

    def _unexplained(self, data: TrainingSet, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return points of the masks of ``rows`` that no visible bone explains, and their share of the mask."""
        assert data.mask_map is not None
        maps = _known(data.mask_map[rows])[0]
        points = _picked(self.field[rows] < 0, _CANDIDATES * self.pixels)
        keypoints, both = data.keypoints[rows], (data.confidence[rows] > 0)[:, self.bones].all(-1)
        away = segment_distances(_out_of_crop(points, maps), keypoints[:, self.bones])
        left = ~((away <= self.radii) & both.unsqueeze(1)).any(-1)
        chosen = torch.multinomial(_or_all(left), self.pixels, replacement=True)
        return points.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 2)).half(), left.to(maps.dtype).mean(1)

    def _points(self, keypoints: Tensor) -> Tensor:
        """Return (frames, bones x along, 2) points along the bones."""
        start, end = keypoints[:, self.bones].unbind(2)
        return torch.lerp(start.unsqueeze(2), end.unsqueeze(2), self.along[:, None]).flatten(1, 2)

    def loss(self, lift: Lift) -> Tensor:
        """Return for each frame how far bones are outside its mask, and the mask from bones, in units."""
        if lift.mask_map is None or lift.row is None:
            return 0 * lift.lifted_keypoints.sum((1, 2))
        maps, known = _known(lift.mask_map)
        keypoints, unit = lift.measured_keypoints, unit_of(maps)
        total = keypoints.new_zeros(len(keypoints))
        if self.inside:
            at = sample_field(self.field[lift.row], into_crop(self._points(keypoints), maps)) * unit[:, None]
            outside = (at - self.usual.flatten()).clamp_min(0)
            total = total + self.inside * outside.mean(1) * len(self.bones)
        if self.explained:
            points = _out_of_crop(self.unexplained[lift.row].to(maps.dtype), maps)
            gap = soft_gap(segment_distances(points, keypoints[:, self.bones]), self.radii)
            total = total + self.explained * gap.mean(1) * self.share[lift.row] * len(self.bones)
        return torch.where(known, total, 0 * total)

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return the share of filled-in joints that lie inside their mask."""
        if lift.mask_map is None or lift.row is None:
            return {}
        maps, known = _known(lift.mask_map)
        at = sample_field(self.field[lift.row], into_crop(lift.measured_keypoints.detach(), maps))
        filled = (1 - lift.visible * ~lift.hidden) * known.unsqueeze(1)
        return {"filled_inside": float(Lift.mean((at <= 0).to(filled.dtype), filled))}


def _known(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Return maps without NaN, and which frames have a mask."""
    known = maps[:, 2, 2].isfinite()
    return torch.where(known[:, None, None], maps, torch.eye(3, dtype=maps.dtype, device=maps.device)), known


def _out_of_crop(points: Tensor, maps: Tensor) -> Tensor:
    return into_crop(points, torch.linalg.inv_ex(maps).inverse)


def _picked(inside: Tensor, count: int) -> Tensor:
    """Return (frames, count, 2) random pixel centres of each mask, with replacement; of the crop where it is empty."""
    chosen = torch.multinomial(_or_all(inside.flatten(1)), count, replacement=True)
    side = inside.shape[1]
    at = (2 * torch.arange(side, device=inside.device) + 1) / side - 1
    return torch.stack(torch.meshgrid(at, at, indexing="xy"), -1).flatten(0, 1)[chosen]


def _or_all(wanted: Tensor) -> Tensor:
    """Return weights of 1 for the pixels wanted, or for all of a frame where none is."""
    return (wanted | ~wanted.any(1, keepdim=True)).float()
