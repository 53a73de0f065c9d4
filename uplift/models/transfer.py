"""`copy_weights`, which gives a lifter what another one has learned, joint by joint of the same name."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.errors import UserError, listed
from uplift.models.lifter import Lifter
from uplift.models.networks import KudoNetwork, ResidualNetwork
from uplift.models.signs import Chain
from uplift.skeleton import Skeleton
from uplift.skeleton.match import shared_joints

__all__ = ["copy_weights"]

_ENDS = {ResidualNetwork: ("enter", "leave"), KudoNetwork: ("layers.0", "layers.3")}
"""The first and the last layer of the networks whose inputs and outputs are known by name."""
_LEAST_JOINTS, _LEAST_SHARE = 3, 1 / 3
"""Joints that two skeletons must have in common."""

Shared = dict[str, tuple[str, ...]]
Name = tuple[str, str]


@torch.no_grad()
def copy_weights(into: Lifter, given: Lifter) -> Shared:
    """Copy the weights of ``given``; return the joints of ``into`` that it knows, each with its own that they are made of.

    Lifters with the same joints, inputs and outputs lift alike from then on. Otherwise the layers between stay as they
    are and the ends are matched by what each number is: inputs of joints that ``given`` does not know count for nothing
    at first, and outputs that it does not have keep the weights that they have. Depth signs are known where all chains
    of bones are the same (`Lifter.knows_signs`).

    Raises:
        UserError: skeletons with too few joints in common, networks of other kinds or sizes.
    """
    shared = _checked(shared_joints(into.skeleton, given.skeleton), into.skeleton, given.skeleton)
    if _body(into.skeleton) == _body(given.skeleton):
        if _shapes(into) == _shapes(given):
            into.load_state_dict(given.state_dict())
            return shared
        into.bone_mm.copy_(given.bone_mm)
    back = _as_inputs(given.skeleton, shared)
    inputs = _input_matrix(into.input_names(), given.input_names(), back, into.skeleton, given.skeleton)
    outputs = _output_matrix(into.output_names(), given.output_names(), shared)
    _copy_network(into.network, given.network, inputs, outputs)
    if into.signs is not None and given.signs is not None:
        inputs = torch.block_diag(inputs, torch.ones(1, 1))  # after the others, the inverse distance
        outputs = _sign_matrix(into, given, shared)
        _copy_network(into.signs, given.signs, inputs, outputs)
        if not outputs.any(1).all():  # weights that nobody has trained would decide poses
            into.signs.leave.weight.zero_()
            into.signs.leave.bias.zero_()
    if into.tilt == given.tilt == "learned":
        into.common_tilt.copy_(given.common_tilt)
    return shared


def _body(skeleton: Skeleton) -> tuple[object, ...]:
    return skeleton.joints, skeleton.root, skeleton.bones


def _shapes(lifter: nn.Module) -> dict[str, torch.Size]:
    return {key: value.shape for key, value in lifter.state_dict().items()}


def _checked(shared: Shared, skeleton: Skeleton, given: Skeleton) -> Shared:
    """Return the shared joints; raises UserError where they are too few."""
    if len(shared) >= max(_LEAST_JOINTS, _LEAST_SHARE * len(skeleton.joints)):
        return shared
    found = f"only {listed(shared)}" if shared else "none"
    raise UserError(
        f"it was trained on skeleton '{given.name}' ({len(given.joints)} joints: {listed(given.joints, 6)}), this fit is "
        f"for '{skeleton.name}' ({len(skeleton.joints)} joints: {listed(skeleton.joints, 6)}): of these it has {found}, "
        f"and a third are needed. A `from:` map with the names of '{given.name}' in the skeleton's YAML says which "
        "joints are the same."
    )


def _copy_network(
    into: nn.Module,
    given: nn.Module,
    inputs: Float[Tensor, "theirs ours"],
    outputs: Float[Tensor, "ours_out theirs_out"],
) -> None:
    """Copy a network between other inputs and outputs: ``inputs`` makes its own of ours, ``outputs`` ours of its own."""
    ends = _ENDS.get(type(given))
    inner = [
        {key: value for key, value in network.state_dict().items() if ends and not key.startswith(ends)}
        for network in (into, given)
    ]
    shapes = [{key: value.shape for key, value in state.items()} for state in inner]
    if ends is None or type(into) is not type(given) or shapes[0] != shapes[1]:
        names = [f"{type(network).__name__} of {_weights(network):,} weights" for network in (given, into)]
        raise UserError(f"it has another network: {names[0]}, this fit {names[1]}.")
    into.load_state_dict(inner[1], strict=False)
    (first, last), (their_first, their_last) = ([_linear(one, end) for end in ends] for one in (into, given))
    first.weight.copy_(their_first.weight @ inputs)
    first.bias.copy_(their_first.bias)
    known = outputs.abs().sum(1) > 0
    last.weight[known] = outputs[known] @ their_last.weight
    last.bias[known] = outputs[known] @ their_last.bias


def _linear(network: nn.Module, name: str) -> nn.Linear:
    layer = network.get_submodule(name)
    assert isinstance(layer, nn.Linear)
    return layer


def _weights(network: nn.Module) -> int:
    return sum(weight.numel() for weight in network.parameters())


def _as_inputs(given: Skeleton, shared: Shared) -> dict[str, str]:
    """Return for each joint of ``given`` that is seen the one of the other skeleton that shows where it is.

    Where that has only a mean of several, they are taken to be there.
    """
    found: dict[str, str] = {}
    for joint in sorted(shared, key=lambda joint: len(shared[joint])):  # joints of their own first
        for part in shared[joint]:
            found.setdefault(part, joint)
    return {joint: found[joint] for joint in given.joints if joint in found}


def _input_matrix(
    ours: list[Name], theirs: list[Name], back: dict[str, str], into: Skeleton, given: Skeleton
) -> Float[Tensor, "theirs ours"]:
    """Return the inputs of ``given`` as sums of those of ``into``; positions are about its own root."""
    place = {name: number for number, name in enumerate(ours)}
    origin = [back[joint] for joint in _nearest_to_root(given, set(back))]
    origin = [] if set(origin) == {into.root} else origin  # which is at 0
    matrix = torch.zeros(len(theirs), len(ours))
    for row, (what, joint) in enumerate(theirs):
        name = (what, back.get(joint, joint))
        if (joint in back or not joint) and name in place:
            matrix[row, place[name]] = 1.0
        if joint in back and what in ("x", "y"):
            for part in origin:
                matrix[row, place[what, part]] -= 1 / len(origin)
    return matrix


def _nearest_to_root(skeleton: Skeleton, seen: set[str]) -> list[str]:
    """Return the root if it is ``seen``, else the joints beside it that are: what stands in for it in inference."""
    neighbours: dict[str, set[str]] = {joint: set() for joint in skeleton.joints}
    for one, other in skeleton.bones:
        neighbours[one].add(other)
        neighbours[other].add(one)
    near, passed = {skeleton.root}, {skeleton.root}
    while near and not near & seen:
        near = {other for joint in near for other in neighbours[joint]} - passed
        passed |= near
    return sorted(near & seen)


def _output_matrix(ours: list[Name], theirs: list[Name], shared: Shared) -> Float[Tensor, "ours theirs"]:
    """Return the outputs of ``into`` as means of those of ``given``; a row of 0 for one that it does not have."""
    place = {name: number for number, name in enumerate(theirs)}
    matrix = torch.zeros(len(ours), len(theirs))
    for row, (what, joint) in enumerate(ours):
        parts = shared.get(joint, ()) if joint else ("",)
        known = [place[what, part] for part in parts if (what, part) in place]
        matrix[row, known] = 1 / max(1, len(known))
    return matrix


def _sign_matrix(into: Lifter, given: Lifter, shared: Shared) -> Float[Tensor, "ours theirs"]:
    """Return which states of chains of bones are the same."""
    alone = {joint: parts[0] for joint, parts in shared.items() if len(parts) == 1}
    theirs = {_named(chain, given.skeleton): number for number, chain in enumerate(given.chains.chains)}
    matrix = torch.zeros(sum(into.chains.counts), sum(given.chains.counts))
    row, starts = 0, [sum(given.chains.counts[:number]) for number in range(len(given.chains.counts))]
    for chain, count in zip(into.chains.chains, into.chains.counts, strict=True):
        named = tuple(tuple(alone.get(joint, "") for joint in bone) for bone in _named(chain, into.skeleton))
        if named in theirs:
            start = starts[theirs[named]]
            matrix[row : row + count, start : start + count] = torch.eye(count)
        row += count
    return matrix


def _named(chain: Chain, skeleton: Skeleton) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(skeleton.joints[joint] for joint in bone) for bone in chain)
