"""Gait of a body that walks or runs: foot strikes and toe-offs, and spatio-temporal measures of every stride.

Events are told from the way of each foot along the heading, relative to the hips (or shoulders) of its pair: it strikes
where it is farthest ahead and leaves where it is farthest behind (Zeni, Richards and Higginson 2008, Gait & Posture 27).
That needs no place of the body in the room, so that one camera, a treadmill, and a camera that goes along will do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["MEASURES", "Foot", "Gait", "Stride", "feet_of", "gait_of", "mean_of"]

_LEAST_REACH = 0.2
"""A foot that walks goes at least so far from behind to ahead, in lengths of its leg."""
_LOW = 0.3
"""A foot strikes less than so many leg lengths above its lowest place: a kick ends high."""
_STEADY_S = 1.0
"""Time over which a body keeps its heading."""
_ALIKE = (0.6, 1.6)
"""Of the median stride: one much shorter or longer is none of the walk."""
_FLAT = (0.1, 0.5)
"""Shares of a stance between which the foot is flat: before it the heel comes down, after it the heel rises."""
_CUT_HZ = 6.0
"""Of the low-pass filter of places over time (Winter 2009, Biomechanics and Motor Control of Human Movement, 2.2)."""


@dataclass(frozen=True)
class Foot:
    """One limb that stands: its joints by their places in the skeleton."""

    name: str
    """The last joint that all its contacts hang on; the contact itself where it has one."""
    contacts: tuple[int, ...]
    limb: tuple[int, ...]
    """From the hip or shoulder to the foot."""
    partner: int
    """Place among the feet of the same on the other side; its own where it has none."""


@dataclass(frozen=True)
class Stride:
    """From one strike of a foot to its next; what is not known is NaN."""

    foot: str
    number: int
    """From 1, of this foot in this clip."""
    strike_s: float
    toe_off_s: float
    end_s: float
    measures: dict[str, float]


@dataclass(frozen=True)
class Gait:
    """The strides of one body in one clip, in order of time, or why there are none."""

    strides: tuple[Stride, ...]
    feet: tuple[str, ...]
    asymmetry: dict[str, dict[str, float]] = field(default_factory=dict)
    """The feet of a pair -> measure -> 100 |R - L| / ((R + L) / 2) of the means (Robinson et al. 1987)."""
    why_not: str = ""


MEASURES = (
    "stride_time_s", "stance_time_s", "stance_percent", "swing_percent", "double_support_percent", "step_time_s",
    "cadence_steps_per_min", "step_length", "stride_length", "speed_per_s",
)  # fmt: skip
"""Of a stride. Lengths are in the unit of the poses."""


def feet_of(skeleton: Skeleton) -> list[Foot]:
    """Return the limbs that stand, by the skeleton's ``contacts``; raises UserError without these, gravity or facing."""
    if not skeleton.gravity or not skeleton.contacts:
        lacks = "gravity is false" if not skeleton.gravity else "it names no contacts"
        raise UserError(
            f"gait needs joints that stand on the ground, and skeleton '{skeleton.name}' has none: {lacks}."
        )
    if not skeleton.facing:
        raise UserError(f"gait needs to know which way is ahead: skeleton '{skeleton.name}' has no facing.")
    places = {joint: place for place, joint in enumerate(skeleton.joints)}
    across = skeleton.mirror_permutation
    limbs: dict[str, list[list[str]]] = {}
    for contact in skeleton.contacts:
        chain = [contact]
        while (above := skeleton.parents[chain[-1]]) is not None and across[places[above]] != places[above]:
            chain.append(above)
        limbs.setdefault(chain[-1], []).append(chain[::-1])
    tops = list(limbs)
    feet = []
    for top, chains in limbs.items():
        shared = [joint for joint in max(chains, key=len) if all(joint in chain for chain in chains)]
        other = skeleton.joints[across[places[top]]]
        contacts = tuple(places[chain[-1]] for chain in chains)
        limb = tuple(places[joint] for joint in shared)
        feet.append(Foot(shared[-1], contacts, limb, tops.index(other) if other in tops else len(feet)))
    return feet


def gait_of(
    pose: Float[np.ndarray, "frames joints 3"],
    time_s: Float[np.ndarray, " frames"],
    skeleton: Skeleton,
    contact: Bool[np.ndarray, "frames joints"] | None = None,
) -> Gait:
    """Return the gait of one body in one clip.

    Args:
        pose: in level axes (x right, y down, z away), relative to the root or not, in any unit; blank frames are NaN.
        time_s: of each frame, growing.
        skeleton: its ``contacts`` stand on the ground, its ``facing`` says which way is ahead.
        contact: the joints that stand, where a ground was found (`uplift.models.ground`): strikes and toe-offs are then
            where standing begins and ends.

    Raises:
        UserError: the skeleton has no contacts, no gravity, or no facing.
    """
    feet = feet_of(skeleton)
    names = tuple(foot.name for foot in feet)
    known = np.flatnonzero(np.isfinite(pose[:, _used(skeleton, feet)]).all((1, 2)))
    pieces = np.split(known, np.flatnonzero(np.diff(time_s[known]) > _GAP_S) + 1)
    strides = [
        one
        for rows in pieces
        if len(rows) >= _LEAST_FRAMES
        for one in _strides_of(pose[rows], time_s[rows], skeleton, feet, None if contact is None else contact[rows])
    ]
    why_not = _not_walking(strides, feet) if len(known) >= _LEAST_FRAMES else f"fewer than {_LEAST_FRAMES} frames"
    if why_not:
        return Gait((), names, why_not=why_not)
    strides.sort(key=lambda one: (one.strike_s, one.foot))
    count = Counter[str]()
    for place, one in enumerate(strides):
        count[one.foot] += 1
        strides[place] = replace(one, number=count[one.foot])
    return Gait(tuple(strides), names, _asymmetry(strides, feet))


def _used(skeleton: Skeleton, feet: list[Foot]) -> list[int]:
    """Return the joints that gait is told from."""
    facing = {skeleton.index(joint) for way in ("left", "front") for end in skeleton.facing[way] for joint in end}
    return sorted(facing.union(*(foot.contacts + foot.limb for foot in feet)))


def _strides_of(
    pose: np.ndarray, time: np.ndarray, skeleton: Skeleton, feet: list[Foot], contact: np.ndarray | None
) -> list[Stride]:
    """Return the strides of frames without a gap."""
    walk = _walk_of(pose, time, skeleton, feet)
    events = [_events(walk, k) for k in range(len(feet))]
    if contact is not None and contact.any():
        stands = [np.asarray(contact[:, foot.contacts].any(1)) for foot in feet]
        events = [_edges(one, time) if one.any() else found for one, found in zip(stands, events, strict=True)]
    return _strides(walk, feet, events)


# The way of every foot along the heading.

_GAP_S = 0.3
"""A longer gap between frames is not filled."""
_LEAST_FRAMES = 12
_LEAST_STRIDES = 2


@dataclass(frozen=True)
class _Walk:
    """Places over evenly spaced times, in lengths of the leg where that is said."""

    time: Float[np.ndarray, " times"]
    heel: Float[np.ndarray, "feet times"]
    """How far ahead of the middle of the pair's hips each foot's hindmost contact is."""
    toe: Float[np.ndarray, "feet times"]
    """The same of its foremost contact."""
    height: Float[np.ndarray, "feet times"]
    """Of its lowest contact above the lowest it ever is."""
    leg: Float[np.ndarray, " feet"]
    """Length of the limb."""


def _walk_of(pose: np.ndarray, time: np.ndarray, skeleton: Skeleton, feet: list[Foot]) -> _Walk:
    used = _used(skeleton, feet)
    at = {joint: place for place, joint in enumerate(used)}
    evenly, pose = _filtered(pose[:, used].astype(np.float64), time)
    ahead = _heading(pose, evenly, skeleton, used)
    heel, toe, height, leg = [], [], [], []
    for foot in feet:
        tops = pose[:, [at[foot.limb[0]], at[feet[foot.partner].limb[0]]]].mean(1)
        contacts = pose[:, [at[joint] for joint in foot.contacts]]
        along = np.einsum("fjc,fc->jf", contacts - tops[:, None], ahead)
        order = np.argsort(np.median(along, 1))
        heel.append(along[order[0]])
        toe.append(along[order[-1]])
        up = tops[:, 1] - contacts[..., 1].max(1)
        height.append(up - np.percentile(up, 2))
        chain = [*foot.limb, *([] if foot.limb[-1] in foot.contacts else foot.contacts[:1])]
        bones = np.diff(pose[:, [at[joint] for joint in chain]], axis=1)
        leg.append(np.median(np.linalg.norm(bones, axis=-1).sum(1)))
    return _Walk(evenly, np.array(heel), np.array(toe), np.array(height), np.array(leg))


def _filtered(pose: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses at evenly spaced times, at least a hundred a second, smoothed where frames are that dense."""
    from scipy.interpolate import CubicSpline  # scipy takes half a second to import
    from scipy.signal import butter, sosfiltfilt

    step = float(np.median(np.diff(time)))
    rate = 1 / step
    even = np.arange(time[0], time[-1] + step / 2, step)
    if not np.allclose(time, even[: len(time)], atol=step / 10) or len(even) != len(time):
        pose, time = CubicSpline(time, pose)(even), even
    if rate > 2.5 * _CUT_HZ and len(pose) > 15:
        pose = sosfiltfilt(butter(2, _CUT_HZ, fs=rate, output="sos"), pose, axis=0)
    fine = np.arange(time[0], time[-1], min(step, 0.01))
    return fine, CubicSpline(time, pose)(fine)


def _heading(
    pose: np.ndarray, time: np.ndarray, skeleton: Skeleton, joints: list[int]
) -> Float[np.ndarray, "frames 3"]:
    """Return where the body heads, level unit vectors: square to its ``left``, or along its ``front`` where that is longer.

    A person's hips say it better than the knees, a long back better than the shoulders. Directions are summed over the
    second around each moment, so that one which is short there, and may point anywhere, counts little.
    """
    from scipy.ndimage import uniform_filter1d

    left, front = (skeleton.facing_matrix(name)[joints] @ pose * [1.0, 0.0, 1.0] for name in ("left", "front"))
    square = np.stack([left[:, 2], left[:, 1], -left[:, 0]], -1)  # a quarter turn about the vertical
    longer = np.median(np.linalg.norm(front, axis=-1)) > np.median(np.linalg.norm(left, axis=-1))
    around = max(1, round(_STEADY_S / (time[1] - time[0])))
    ahead = uniform_filter1d(front if longer else square, around, axis=0, mode="nearest")
    return ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)


# Strikes and toe-offs.

_LEAST_STEP = 0.1
"""Of the stride's time, that a step takes."""

_Events = tuple[np.ndarray, np.ndarray]
"""Times of strikes, and of toe-offs, seconds."""


def _events(walk: _Walk, foot: int) -> _Events:
    from scipy.signal import find_peaks

    reach = _LEAST_REACH * walk.leg[foot]
    strikes, _ = find_peaks(walk.heel[foot], prominence=reach)
    offs, _ = find_peaks(-walk.toe[foot], prominence=reach)
    strikes = strikes[walk.height[foot, strikes] < _LOW * walk.leg[foot]]
    return walk.time[strikes], walk.time[offs]


def _edges(stands: Bool[np.ndarray, " frames"], time: Float[np.ndarray, " frames"]) -> _Events:
    """Return where standing begins and ends, half way between two frames."""
    change, middle = np.diff(stands.astype(int)), (time[1:] + time[:-1]) / 2
    return middle[change > 0], middle[change < 0]


def _strides(walk: _Walk, feet: list[Foot], events: list[_Events]) -> list[Stride]:
    """Return every stride that has one toe-off between its two strikes and is about as long as the others."""
    found: list[Stride] = []
    speeds = _speeds(walk, events)
    for place, (foot, (strikes, offs)) in enumerate(zip(feet, events, strict=True)):
        for strike, end in pairwise(strikes.tolist()):
            inside = offs[(offs > strike) & (offs < end)].tolist()
            if len(inside) == 1:
                measures = _measure(walk, speeds, place, foot.partner, events, (strike, inside[0], end))
                found.append(Stride(foot.name, 0, strike, inside[0], end, measures))
    usual = np.median([one.end_s - one.strike_s for one in found]) if found else 0.0
    return [one for one in found if _ALIKE[0] * usual < one.end_s - one.strike_s < _ALIKE[1] * usual]


def _measure(
    walk: _Walk, speeds: np.ndarray, foot: int, other: int, events: list[_Events], times: tuple[float, float, float]
) -> dict[str, float]:
    strike, off, end = times
    stride = end - strike
    before = (
        events[other][0][(events[other][0] < end) & (events[other][0] > end - stride)] if other != foot else np.empty(0)
    )
    step = float(end - before[-1]) if len(before) else np.nan
    # Feet that strike as one, in a leap or where someone turns round, take no step.
    step = step if _LEAST_STEP * stride < step < (1 - _LEAST_STEP) * stride else np.nan
    at = min(int(np.searchsorted(walk.time, end)), len(walk.time) - 1)
    apart = float(walk.heel[foot, at] - walk.heel[other, at]) if np.isfinite(step) else np.nan
    over = speeds[:, (walk.time >= strike) & (walk.time <= end)]
    speed = float(np.mean(over[np.isfinite(over)])) if np.isfinite(over).any() else np.nan
    return {
        "stride_time_s": stride, "stance_time_s": off - strike, "stance_percent": 100 * (off - strike) / stride,
        "swing_percent": 100 * (end - off) / stride,
        "double_support_percent": 100 * _both_stand(events[other], strike, off) / stride if other != foot else np.nan,
        "step_time_s": step, "cadence_steps_per_min": 60 / step, "step_length": apart, "stride_length": speed * stride,
        "speed_per_s": speed,
    }  # fmt: skip


def _speeds(walk: _Walk, events: list[_Events]) -> Float[np.ndarray, "feet times"]:
    """Return how fast the body goes over each foot while that is flat on the ground, unit a second; NaN at other times."""
    found = np.full(walk.heel.shape, np.nan)
    for foot, (strikes, offs) in enumerate(events):
        speed = -np.gradient(walk.heel[foot], walk.time)
        for strike in strikes:
            after = offs[offs > strike]
            if len(after):
                start, end = (strike + share * (after[0] - strike) for share in _FLAT)
                rows = (walk.time >= start) & (walk.time <= end)
                found[foot, rows] = speed[rows]
    return found


def _both_stand(other: _Events, strike: float, off: float) -> float:
    """Return how long the other foot stands while this one does; NaN where that is not known."""
    strikes, offs = other
    if not (offs > off).any() or not (strikes > off).any():
        return np.nan
    # A foot stands until its next toe-off where that is before its next strike.
    together, at = 0.0, strike
    while at < off:
        leaves, lands = offs[offs > at][0], strikes[strikes > at][0]
        if leaves < lands:
            together += min(leaves, off) - at
        at = leaves if leaves < lands else lands
    return float(together)


def _not_walking(strides: list[Stride], feet: list[Foot]) -> str:
    """Return why strides are no walk; empty where the feet of a pair take turns, or one without a partner goes on."""
    for place, foot in enumerate(feet):
        mine = [one for one in strides if one.foot == foot.name]
        others = [one.strike_s for one in strides if one.foot == feet[foot.partner].name]
        if foot.partner == place and len(mine) >= _LEAST_STRIDES:
            return ""
        turns = [one for one in mine if sum(one.strike_s < other < one.end_s for other in others) == 1]
        if turns and len(mine) + len(others) >= _LEAST_STRIDES:
            return ""
    return f"no two feet that take turns for {_LEAST_STRIDES} strides: no walking or running was found"


def _asymmetry(strides: list[Stride], feet: list[Foot]) -> dict[str, dict[str, float]]:
    """Return the symmetry index of each pair's mean measures, per cent; 0 where both sides are alike."""
    found: dict[str, dict[str, float]] = {}
    for place, foot in enumerate(feet):
        if foot.partner <= place:
            continue
        sides = [[one.measures for one in strides if one.foot == name] for name in (foot.name, feet[foot.partner].name)]
        if all(sides):
            means = [{key: mean_of([one[key] for one in side]) for key in _COMPARED} for side in sides]
            found[f"{foot.name}/{feet[foot.partner].name}"] = {
                key: 200 * abs(one - means[1][key]) / (one + means[1][key]) for key, one in means[0].items()
            }
    return found


def mean_of(values: Sequence[float] | np.ndarray) -> float:
    """Return the mean of what is known; NaN where nothing is."""
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    return float(known.mean()) if len(known) else float("nan")


_COMPARED = ("stride_time_s", "stance_time_s", "step_time_s", "step_length")
