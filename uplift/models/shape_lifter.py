"""`lift_masks`: code and view of each mask, refined until its silhouette is the mask; and what voxels are then inside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy

from uplift.data.samples import Samples
from uplift.models.front import turned_grids
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import ObjectPose
from uplift.models.view_hypotheses import ViewHypotheses

__all__ = [
    "LiftedShapes", "State", "choose_iso_threshold", "chosen_views", "encoded", "expected_shapes", "fill_rays", "first_states",
    "lift_masks", "of_groups", "pick_views", "refined", "target_of",
]  # fmt: skip


@dataclass(frozen=True)
class LiftedShapes(Samples):
    """Occupancy in the shape frame at each mask's most likely view, and its pose in the camera frame (see `Placed`)."""

    occupancy: Float[Tensor, "items depth height width"]
    """Its expectation over what the mask leaves open."""
    uncertainty: Float[Tensor, "items depth height width"]
    """The standard deviation of that."""
    view: Float[Tensor, "items 3 3"]
    scale: Float[Tensor, " items"]
    offset: Float[Tensor, "items 2"]
    distance: Float[Tensor, " items"]
    probability: Float[Tensor, " items"]
    """Of the view."""
    second_view: Float[Tensor, "items 3 3"]
    """The likeliest of the views that are apart from it; NaN where there is none."""
    second_probability: Float[Tensor, " items"]


class Chosen(NamedTuple):
    """The likeliest of the views that a mask may be from, and the next that is apart from it."""

    probability: Float[Tensor, " items"]
    second_view: Float[Tensor, "items 3 3"]
    second_probability: Float[Tensor, " items"]


# Inference: from the likeliest views as the encoder sees them, down the gradient of the posterior.

_STARTS = 3
_APART = 0.45
"""Radians between two views that are tried."""
_NEVER = 1e6
FIRST_STEPS = 12
_TEMPERATURE = 0.0015
_SURE = 0.005
_SPREAD = 0.7
"""Of the code's standard deviation as the encoder says, in samples of it."""
_SAMPLES = 12
_RATES = {"code": 0.06, "azimuth": 0.015, "roll": 0.015, "elevation": 0.006, "scale": 0.006, "offset": 0.006}


class State(NamedTuple):
    """What is refined of masks."""

    code: Float[Tensor, "items code"]
    deviation: Float[Tensor, "items code"]
    pose: ObjectPose

    def pick(self, rows: Tensor) -> State:
        """Return some of the items."""
        return State(self.code[rows], self.deviation[rows], self.pose.pick(rows))


def lift_masks(
    space: ShapeSpace, masks: Float[Tensor, "items side side"], *, resolution: int, steps: int
) -> LiftedShapes:
    """Return the expected occupancy of each mask's shape, carved by the mask, in its pose.

    Args:
        space: the trained shapes; its parameters take no gradient.
        masks: 0..1.
        resolution: voxels along each axis of the result.
        steps: of the refinement; 0: as the encoder and the view head say.
    """
    with torch.no_grad():
        starts, likely = first_states(space, space.features(masks))
    target, cost = target_of(masks, space.settings.pixels), -nearest_view(space, starts.pose, likely)
    if steps:
        starts, cost = refined(space, starts, target, min(steps, FIRST_STEPS))
    best, chosen = chosen_views(starts.pose, cost, len(masks))
    state = starts.pick(best)
    if steps:
        state, _ = refined(space, state, target, steps)
    return expected_shapes(space, state, masks, resolution, chosen)


_SURENESS = 0.1
"""Power of the probabilities of views: pixels of a silhouette are far from independent."""


def chosen_views(
    pose: ObjectPose, cost: Float[Tensor, " candidates"], items: int
) -> tuple[Int[Tensor, " items"], Chosen]:
    """Return which of the candidates of all items, one after the other, is the cheapest of each, and what is chosen with it.

    ``cost`` is minus the log posterior of each candidate.
    """
    view, cost = pose.view.view(-1, items, 3, 3), cost.view(-1, items)
    rows, best = torch.arange(items, device=cost.device), cost.argmin(0)
    likely = (-_SURENESS * cost).softmax(0)
    apart = ((view * view[best, rows]).sum((-1, -2)) - 1) / 2 < math.cos(_APART)
    second = cost.masked_fill(~apart, math.inf).argmin(0)
    there = apart.any(0)
    return best * items + rows, Chosen(
        likely.masked_fill(apart, 0).sum(0),
        view[second, rows].where(there[:, None, None], math.nan),
        likely[second, rows].where(there, 0.0),
    )


def target_of(masks: Tensor, side: int) -> Tensor:
    return nn.functional.interpolate(masks[:, None], (side, side), mode="area")[:, 0]


def first_states(space: ShapeSpace, features: Tensor) -> tuple[State, Float[Tensor, "items views"]]:
    """Return the likeliest views that are apart, of all masks one after the other, and the log probability of all views."""
    likely = space.view_logits(features).log_softmax(1)
    views = space.view_matrices.flatten(1)
    apart = ((views @ views.T - 1) / 2) < math.cos(_APART)
    states, left = [], likely
    for _ in range(_STARTS):
        best = left.argmax(1)
        states.append(encoded(space, features, space.placed(features, *space.views[best].unbind(1))))
        left = left.masked_fill(~apart[best], -1e9)
    return _joined(states), likely


def encoded(space: ShapeSpace, features: Tensor, pose: ObjectPose) -> State:
    mean, log_variance = space.encode(features, pose)
    return State(mean, (log_variance / 2).exp(), pose)


def _joined(states: list[State]) -> State:
    poses = ObjectPose(*(torch.cat(part) for part in zip(*(state.pose for state in states), strict=True)))
    return State(torch.cat([state.code for state in states]), torch.cat([state.deviation for state in states]), poses)


_FEW_STEPS, _PICK_STEPS = 3, 4
"""Of all candidates, and then of the best of them."""
_PICK_TEMPERATURE = 0.004


def pick_views(
    space: ShapeSpace, masks: UInt8[Tensor, "items side side"], before: ViewHypotheses | None, most: int
) -> ViewHypotheses:
    """Return the views of masks that the space explains best, of those ``before`` and of its own, all of them refined.

    The probability of a view is that of the mask given the view, times what the view head says of it, which has seen
    what all other masks are like.
    """
    masks = masks.float() / 255
    side = min(space.settings.pixels, space.detail)
    with torch.no_grad():
        features = space.features(masks)
        own, likely = first_states(space, features)
        states = [own]
        for number in range(0 if before is None else before.weight.shape[1]):
            pose = ObjectPose(*(part[:, number] for part in before.poses))  # type: ignore[union-attr]
            states.append(encoded(space, features, pose))
    target, count = target_of(masks, side), len(masks)
    state, cost = refined(space, _joined(states), target, _FEW_STEPS, _PICK_TEMPERATURE)
    kept = cost.view(-1, count).topk(most, 0, largest=False).indices * count + torch.arange(count, device=cost.device)
    state, cost = refined(space, state.pick(kept.flatten()), target, _PICK_STEPS, _PICK_TEMPERATURE)
    cost = cost - nearest_view(space, state.pose, likely)
    return _best_apart(state.pose, cost.view(-1, count), most)


def nearest_view(
    space: ShapeSpace, pose: ObjectPose, likely: Float[Tensor, "items views"]
) -> Float[Tensor, " candidates"]:
    """Return what ``likely`` says of the view nearest to each candidate of all items, one after the other."""
    nearest = (pose.view.flatten(1) @ space.view_matrices.flatten(1).T).argmax(1).view(-1, len(likely))
    return likely.gather(1, nearest.T).T.flatten()


def _best_apart(pose: ObjectPose, cost: Float[Tensor, "candidates items"], most: int) -> ViewHypotheses:
    """Return the cheapest poses of each item that are apart; their weights are relative to the first."""
    count = cost.shape[1]
    view = pose.view.view(-1, count, 9)
    rows, left, chosen, costs = torch.arange(count, device=cost.device), cost, [], []
    for _ in range(most):
        best = left.argmin(0)
        chosen.append(best * count + rows)
        costs.append(left.gather(0, best[None])[0])
        cosine = ((view * view[best, rows]).sum(-1) - 1) / 2
        left = left.masked_fill(cosine > math.cos(_APART), _NEVER)
    index = torch.stack(chosen, 1)
    weight = (costs[0][:, None] - torch.stack(costs, 1)).exp()
    return ViewHypotheses(**{name: part[index] for name, part in pose._asdict().items()}, weight=weight)


def refined(
    space: ShapeSpace,
    state: State,
    target: Tensor,
    steps: int,
    temperature: float = _TEMPERATURE,
    *,
    group: Int[Tensor, " items"] | None = None,
    still: bool = False,
) -> tuple[State, Float[Tensor, " items"]]:
    """Return code and pose after ``steps`` of Adam on the posterior, and its negative logarithm.

    There may be several states of each target, one after the other. With ``group`` the state has one code for each
    group, and ``group`` says which each pose goes with; ``still`` codes stay as they are.
    """
    target = target.repeat(len(state.pose.scale) // len(target), 1, 1)
    code = state.code.clone().requires_grad_(not still)
    pose = ObjectPose(*(part.clone().requires_grad_() for part in state.pose))
    groups = [] if still else [{"params": [code], "lr": _RATES["code"]}]
    groups += [
        {"params": [part], "lr": _RATES[name]} for name, part in pose._asdict().items() if name != "roll" or space.rolls
    ]
    optimizer = torch.optim.Adam(groups)
    stream = torch.Generator(code.device).manual_seed(0)
    for _ in range(steps):
        noise = torch.randn(
            code.shape[1], generator=stream, device=code.device
        )  # of all items: each is lifted for itself
        with torch.enable_grad():
            at = code + noise * state.deviation * _SPREAD
            cost = _cost(space, at, code, pose, target, temperature, group).sum()
        optimizer.zero_grad()
        cost.backward()
        optimizer.step()
    with torch.no_grad():
        cost = _cost(space, code, code, pose, target, temperature, group)
    return State(code.detach(), state.deviation, pose.detached()), cost


def _cost(
    space: ShapeSpace,
    at: Tensor,
    code: Tensor,
    pose: ObjectPose,
    target: Tensor,
    temperature: float,
    group: Tensor | None,
) -> Float[Tensor, " items"]:
    logits, unlikely = space.logits(at), 0.5 * code.square().sum(1)
    if group is not None:
        logits, unlikely = logits[group], (unlikely / group.bincount(minlength=len(code)))[group]
    seen = space.seen(logits, pose, target.shape[-1]).clamp(_SURE, 1 - _SURE)
    error = binary_cross_entropy(seen, target, reduction="none").mean((1, 2))
    return error / temperature + unlikely + space.elevation_cost(pose.elevation)


@torch.no_grad()
def expected_shapes(
    space: ShapeSpace,
    state: State,
    masks: Tensor,
    resolution: int,
    chosen: Chosen,
    group: Int[Tensor, " items"] | None = None,
) -> LiftedShapes:
    """Return mean and standard deviation of occupancy over samples of the code, carved by the masks, in the named frame.

    With ``group`` (as `refined` has it) the masks of a group carve its shape together.
    """
    stream = torch.Generator(masks.device).manual_seed(1)
    total = squares = torch.zeros(())
    for _ in range(_SAMPLES):
        noise = torch.randn(state.code.shape[1], generator=stream, device=masks.device)
        logits = space.logits(state.code + noise * state.deviation * _SPREAD)
        if resolution != space.detail:
            logits = nn.functional.interpolate(logits[:, None], (resolution,) * 3, mode="trilinear")[:, 0]
        sample = torch.sigmoid(turned_grids(logits, space.front))
        total, squares = total + sample / _SAMPLES, squares + sample.square() / _SAMPLES
    deviation = (squares - total.square()).clamp_min(0).sqrt()
    if group is not None:
        total, deviation = total[group], deviation[group]
    pose, distance, back = state.pose, space.settings.distance * state.pose.scale, space.front.mT
    chosen = chosen._replace(second_view=chosen.second_view @ back)
    found = LiftedShapes(total, deviation, pose.view @ back, pose.scale, pose.offset, distance, *chosen)
    kept = _carved(found, masks, symmetric=space.settings.symmetric)
    if group is not None:
        kept = of_groups(kept, group, "amin")
    return LiftedShapes(**{**vars(found), "occupancy": found.occupancy * kept, "uncertainty": found.uncertainty * kept})


def of_groups(
    grids: Float[Tensor, "items depth height width"], group: Int[Tensor, " items"], how: str
) -> Float[Tensor, "items depth height width"]:
    """Return for each item the ``amin`` or ``amax`` of the grids of its group."""
    flat = grids.flatten(1)
    found = flat.new_zeros(int(group.max()) + 1, flat.shape[1])
    found = found.scatter_reduce(0, group[:, None].expand_as(flat), flat, how, include_self=False)
    return found[group].view_as(grids)


# Carving by the mask, and the iso threshold.

_COVERED = 0.3
"""Share of a mask's pixel that must be covered for voxels that project to it to be kept."""
_UNCERTAIN = 0.25
"""Factor on a voxel outside the mirror image of the mask, as the view may be slightly off."""


def _carved(lifted: LiftedShapes, masks: Tensor, *, symmetric: bool) -> Float[Tensor, "items depth height width"]:
    """Return factors: 0 where voxels do not project into the mask, small where their mirror images do not."""
    image = _projected_grid(lifted)
    kept = (_sample(masks, image) > _COVERED).to(masks)
    if symmetric:
        dilated = nn.functional.max_pool2d(masks[:, None], 3, 1, 1)[:, 0]
        mirrored = _projected_grid(lifted, mirrored=True)
        kept = kept * _sample(dilated, mirrored).clamp(_UNCERTAIN, 1)
    return kept.view_as(lifted.occupancy)


def _projected_grid(lifted: LiftedShapes, *, mirrored: bool = False) -> Float[Tensor, "items points 2"]:
    """Return where voxels, or their mirror images, project to, in half sides of the crop."""
    resolution, scale = lifted.occupancy.shape[-1], lifted.scale
    at = (2 * torch.arange(resolution, device=scale.device, dtype=scale.dtype) + 1) / resolution - 1
    z, y, x = torch.meshgrid(at, at, -at if mirrored else at, indexing="ij")
    placed = (torch.stack([x, y, z], -1).reshape(1, -1, 3) @ lifted.view.mT) * scale[:, None, None]
    flat = placed[..., :2] + lifted.offset[:, None]
    return flat / (1 + placed[..., 2:] / lifted.distance[:, None, None]).clamp_min(0.1)


def _sample(image: Tensor, points: Tensor) -> Tensor:
    return nn.functional.grid_sample(image[:, None], points[:, :, None], align_corners=False)[:, 0, :, 0]


_THRESHOLDS = (
    0.04,
    0.06,
    0.08,
    0.1,
    0.12,
    0.15,
    0.18,
    0.2,
    0.22,
    0.24,
    0.26,
    0.28,
    0.3,
    0.32,
    0.34,
    0.36,
    0.38,
    0.4,
    0.45,
    0.5,
)


def choose_iso_threshold(occupancy: Float[Tensor, "items depth height width"]) -> float:
    """Return the threshold with the best expected IoU if occupancies are probabilities, chosen without any true shape."""
    flat, expected = occupancy.flatten(1), []
    for threshold in _THRESHOLDS:
        inside = flat > threshold
        shared = (flat * inside).sum(1)
        either = inside.sum(1) + (flat * ~inside).sum(1)
        expected.append(float((shared / either.clamp_min(1e-6)).mean()))
    return _THRESHOLDS[max(range(len(expected)), key=expected.__getitem__)]


_RAYS = 32
_HIGHEST = 0.85
_LEAST = 0.03


def fill_rays(
    lifted: LiftedShapes, masks: Float[Tensor, "items side side"], level: float, *, symmetric: bool
) -> Float[Tensor, "items depth height width"]:
    """Return occupancy raised along rays of the mask that nothing reaches ``level`` on, so that their likeliest voxels do."""
    flat = lifted.occupancy.flatten(1)
    image = _projected_grid(lifted)
    at = ((image + 1) / 2 * _RAYS).long()
    inside = ((at >= 0) & (at < _RAYS)).all(-1)
    at = at.clamp(0, _RAYS - 1)
    ray = at[..., 1] * _RAYS + at[..., 0]
    covered = nn.functional.interpolate(masks[:, None], (_RAYS, _RAYS), mode="area")[:, 0].flatten(1) > 0.5
    top = flat.new_zeros(len(flat), _RAYS**2).scatter_reduce(1, ray, flat * inside, "amax")
    wanted = 1.02 * level / _HIGHEST
    gain = (wanted / top.clamp_min(1e-6)).clamp(1, wanted / _LEAST).where(covered, 1.0)
    filled = (flat * gain.gather(1, ray)).clamp(max=1).view_as(lifted.occupancy)
    return torch.maximum(filled, filled.flip(-1)) if symmetric else filled
