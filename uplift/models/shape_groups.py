"""`lift_groups`: masks of one object from several sides, or frames of a video, lifted together: one shape, many poses."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.models.shape_lifter import (
    FIRST_STEPS,
    LiftedShapes,
    State,
    chosen_views,
    encoded,
    expected_shapes,
    first_states,
    refined,
    target_of,
)
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import ObjectPose

__all__ = ["lift_groups"]

_PART = 50
"""Masks that are refined at a time; the code of a group with more is refined with so many of them, evenly spaced."""
_ROUNDS = 2
"""Times that views are chosen by the shared code, and the code is found from these views."""


def lift_groups(
    space: ShapeSpace,
    masks: Float[Tensor, "items side side"],
    group: Int[Tensor, " items"],
    *,
    resolution: int,
    steps: int,
) -> LiftedShapes:
    """Return one shape for each group of masks, carved by all of them, and a pose of it for each mask.

    Each mask is lifted alone at first. The code of a group is then the product of what its masks say of it (Gaussians,
    and the prior once); each mask takes the view from which the shared code explains it best; in the end code and poses
    are refined together.

    Args:
        space: the trained shapes.
        masks: 0..1.
        group: of each mask, numbered from 0 without gaps.
        resolution: voxels along each axis of the result.
        steps: of each refinement; 0: as the encoder and the view head say.
    """
    with torch.no_grad():
        features = space.features(masks)
        starts, _ = first_states(space, features)
    target, count = target_of(masks, space.settings.pixels), len(masks)
    first = min(steps, FIRST_STEPS)
    states, cost = _in_parts(space, starts, target, first, None)
    best, chosen = chosen_views(states.pose, cost, count)
    code, deviation = _product(states.pick(best), group)
    for _ in range(_ROUNDS):
        tried, cost = _in_parts(space, State(code, deviation, starts.pose), target, first, group)
        best, chosen = chosen_views(tried.pose, cost, count)
        pose = tried.pose.pick(best)
        with torch.no_grad():
            code, deviation = _product(encoded(space, features, pose), group)
    state = _jointly(space, State(code, deviation, pose), target, steps, group)
    return expected_shapes(space, state, masks, resolution, chosen, group)


def _product(states: State, group: Tensor) -> tuple[Float[Tensor, "groups code"], Float[Tensor, "groups code"]]:
    """Return mean and deviation of the code of each group: the product of its masks' likelihoods and one prior."""
    sure = states.deviation.square().clamp(max=1).reciprocal()
    groups = int(group.max()) + 1
    empty = sure.new_zeros(groups, sure.shape[1])
    precision = 1 + empty.index_add(0, group, sure - 1)
    return empty.index_add(0, group, states.code * sure) / precision, precision.rsqrt()


def _in_parts(
    space: ShapeSpace, state: State, target: Tensor, steps: int, group: Tensor | None
) -> tuple[State, Float[Tensor, " candidates"]]:
    """Return `refined` of many masks, some at a time; with ``group`` the codes are those of groups, and stay."""
    count = len(target)
    candidates = torch.arange(len(state.pose.scale), device=target.device).view(-1, count)
    states, costs = [], []
    for rows in torch.arange(count, device=target.device).split(_PART):
        part = candidates[:, rows].flatten()
        own = state.pick(part) if group is None else state._replace(pose=state.pose.pick(part))
        which = None if group is None else group[rows].repeat(len(candidates))
        found, cost = refined(space, own, target[rows], steps, group=which, still=group is not None)
        states.append(found)
        costs.append(cost.view(-1, len(rows)))
    back = [torch.cat([part.view(len(candidates), -1, *part.shape[1:]) for part in parts], 1).flatten(0, 1)
            for parts in zip(*(one.pose for one in states), strict=True)]  # fmt: skip
    pose, cost = ObjectPose(*back), torch.cat(costs, 1).flatten()
    if group is not None:
        return state._replace(pose=pose), cost
    code, deviation = (
        torch.cat([part.view(len(candidates), -1, part.shape[1]) for part in parts], 1).flatten(0, 1)
        for parts in ([one.code for one in states], [one.deviation for one in states])
    )
    return State(code, deviation, pose), cost


def _jointly(space: ShapeSpace, state: State, target: Tensor, steps: int, group: Tensor) -> State:
    """Return codes and poses refined together; of very many masks the codes by some, and then the poses of all."""
    if not steps:
        return state
    rows = torch.linspace(0, len(target) - 1, min(_PART, len(target)), device=target.device).round().long()
    found, _ = refined(space, state._replace(pose=state.pose.pick(rows)), target[rows], steps, group=group[rows])
    if len(rows) == len(target):
        return found
    found, _ = _in_parts(space, found._replace(pose=state.pose), target, steps, group)
    return found
