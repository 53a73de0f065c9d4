"""Human3.6M, from whichever of its files are there."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.data.datasets.base import DataSet, Rows, WantedFile
from uplift.data.datasets.h36m_files import LAYOUTS, Clip, Family, Martinez, OfficialCdf, Pickles, VideoPose3D
from uplift.data.formats.layouts import H36M_JOINTS as JOINTS
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["Human36M"]

RATE = 50
_MORE_FRAMES = (50, 0.2)
"""2D and 3D of one clip may differ by a second or a fifth at the end; by more they are not of one clip."""
_BODY_MM = (250.0, 1500.0)
"""From hip to top of the head, in the median over frames."""
_OFF_PX = {"gt": 5.0}
_OFF_DETECTED_PX = 100.0
"""How far the keypoints may be from the projected pose, in the median over joints, then over a subject's clips."""


def _assemble(clips: Sequence[Clip], step: int, keypoints: str, source: str) -> PoseData:
    """Return every ``step``-th frame of ``clips``, one after another.

    Raises:
        UserError: 2D and 3D that cannot be of one clip, or lengths of a body that are not a person's.
    """
    rows = Rows(sum(-(-clip.frames // step) for clip in clips), JOINTS)
    checks = defaultdict(list)
    for clip in clips:
        checks[clip.subject].append((clip, *_fill(rows, clip, step)))
    if not rows.used:
        raise UserError(f"{source}: no frame in the files.")
    for of_one in checks.values():
        _check_subject(of_one, _OFF_PX.get(keypoints, _OFF_DETECTED_PX))
    return rows.data(fps=RATE / step, source=source)


def _checked(clip: Clip, step: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return 3D and 2D of every ``step``-th frame that both have."""
    points = clip.positions(step)
    seen = None if clip.seen is None else clip.seen()
    if seen is not None:
        most = max(_MORE_FRAMES[0], _MORE_FRAMES[1] * max(clip.frames, len(seen)))
        if abs(clip.frames - len(seen)) > most or not len(seen):
            raise UserError(
                f"{clip.where}: {clip.frames} frames of 3D and {len(seen)} of 2D, expected as many but for a few at "
                "the end: 2D of another sequence or rate?"
            )
        points, seen = points[: len(seen[::step])], seen[::step][: len(points)]
    if not (points[..., 2] > 0).all():
        raise UserError(
            f"{clip.where}: not every joint is a number in front of the camera: other coordinates than these files have?"
        )
    return points, seen


def _fill(rows: Rows, clip: Clip, step: int) -> tuple[float, float]:
    """Append a clip; return hip to top of head (mm) and median pixels from 2D to projected 3D, of its middle frame."""
    points, seen = _checked(clip, step)
    frame = np.arange(len(points), dtype=np.int32) * step
    identity = {"subject": clip.subject, "action": clip.action, "sequence": clip.sequence, "camera": clip.camera_id}
    lens = clip.camera.lens
    keypoints, pose, confidence, root = rows.next(len(points), clip.camera.tilt_deg, {**identity, "frame": frame}, lens)
    root[:] = points[:, 0]
    np.subtract(points, points[:, :1], out=pose)
    if seen is None:
        keypoints[:], confidence[:] = lens.project(points), 1
    else:
        _into_joints(seen, clip.layout, keypoints, confidence)
    if not len(points):
        return np.nan, 0.0
    middle = len(points) // 2
    length_mm = float(np.linalg.norm(pose[middle, JOINTS.index("headtop")]))
    known = confidence[middle] > 0
    if seen is None or not known.any():
        return length_mm, 0.0
    off = np.linalg.norm(lens.project(pose[middle] + root[middle]) - keypoints[middle], axis=-1)
    return length_mm, float(np.median(off[known]))


def _into_joints(seen: np.ndarray, layout: str, keypoints: np.ndarray, confidence: np.ndarray) -> None:
    """Fill keypoints and confidence in our joints; what the layout lacks or is not finite is missing."""
    if layout == "h36m" and seen.shape[2] == 2:
        keypoints[:], confidence[:] = seen, 1
    else:
        keypoints[:], confidence[:] = 0, 0
        for joint, places in LAYOUTS[layout].items():
            place = JOINTS.index(joint)
            keypoints[:, place] = seen[:, places, :2].mean(1)
            confidence[:, place] = seen[:, places, 2].min(1) if seen.shape[2] == 3 else 1
    missing = ~np.isfinite(keypoints).all(-1)
    keypoints[missing], confidence[missing] = 0, 0


def _check_subject(checks: list[tuple[Clip, float, float]], most_px: float) -> None:
    """Refuse a body that has not the size of a person, and keypoints that are far from the projected pose."""
    clip = checks[0][0]
    length = float(np.nanmedian([length for _, length, _ in checks]))
    if not _BODY_MM[0] < length < _BODY_MM[1]:
        raise UserError(
            f"{clip.where}: from hip to head {clip.subject} measures {length:.3g} mm in the median, expected "
            f"{_BODY_MM[0]:.0f} to {_BODY_MM[1]:.0f}: another unit than these files have, or another order of joints?"
        )
    off_px = float(np.median([off for _, _, off in checks]))
    if not off_px < most_px:
        raise UserError(
            f"{clip.where}: the keypoints of {clip.subject} are {off_px:.0f} px off the projected 3D in the median, "
            f"expected less than {most_px:.0f}: 2D and 3D of different subjects, sequences or cameras?"
        )


_FAMILIES: dict[str, type[Family]] = {family.name: family for family in (VideoPose3D, Pickles, Martinez, OfficialCdf)}
_DETECTORS = ("sh", "cpn", "detectron", "sh_mpii", "detectron_coco")
_KINDS = ("gt", "projected", *_DETECTORS)


class Human36M(DataSet):
    """Human3.6M (Ionescu et al. 2014): four cameras, 15 actions, 17 of its 32 joints.

    Args:
        folder: where the files are.
        keypoints: ``gt``, ``projected`` (the ground truth made anew from the 3D), ``sh``, ``cpn``,
            ``detectron``, ``sh_mpii``, ``detectron_coco``, or ``detected``: the first of these detectors that is there.
        fps: frames a second, 50 or a divisor of it.
        source: which kind of files: ``videopose3d``, ``pickles``, ``martinez``, ``cdf``, or ``auto``: the
            first of these that is there and has such keypoints.
        partial: go on where actions are missing.
    """

    title = "Human3.6M"
    about = (
        "Human3.6M is free for academic use, after registration at http://vision.imar.ro/human3.6m: its licence does "
        "not let anyone pass it on.\nPut there data_3d_h36m.npz, with data_2d_h36m_gt.npz or a detector's "
        "data_2d_h36m_*.npz (made by the scripts of github.com/facebookresearch/VideoPose3D, DATASETS.md); or "
        "points_3d.pkl, cameras.pkl and sh_detect_2d.pkl of github.com/DwangoMediaVillage/3dpose_gan; or the folders "
        "S1, S5, ... as the official archives or h36m.zip of 3d-pose-baseline unpack (docs/data-h36m.md)."
    )

    def __init__(self, folder: Path, keypoints: str = "gt", fps: int = 10, source: str = "auto", partial: bool = False):
        super().__init__(folder)
        if keypoints not in (*_KINDS, "detected"):
            raise UserError(f"data.options.keypoints={keypoints!r}.{did_you_mean(keypoints, (*_KINDS, 'detected'))}")
        if source not in (*_FAMILIES, "auto"):
            raise UserError(f"data.options.source={source!r}.{did_you_mean(source, (*_FAMILIES, 'auto'))}")
        if fps < 1 or RATE % fps:
            raise UserError(f"data.options.fps={fps!r}: Human3.6M has {RATE} frames a second, set a divisor of it.")
        self.keypoints, self.fps, self.source, self.partial = keypoints, int(fps), source, partial

    def files(self, split: str) -> list[WantedFile]:
        """Return the files of ``split``, of the kind that was asked for or is there."""
        self.check_split(split)
        return self._family().files(split)

    def read(self, split: str) -> PoseData:
        """Return the frames of ``split``: S1, 5, 6, 7, 8 to train, S9, 11 to test."""
        self.check_split(split)
        family = self._family()
        how = family.keypoints
        clips = family.clips(split)
        if how == "gt" and clips and clips[0].seen is None:
            how = "gt, projected from the 3D"
        source = f"Human3.6M {split} in {self.folder} ({family.name}, keypoints {how}, {self.fps} frames/s)"
        return _assemble(clips, RATE // self.fps, family.keypoints, source)

    def _family(self) -> Family:
        """Return the first kind of files that is there with the keypoints that are wanted, else one that is missing."""
        families = list(_FAMILIES.values()) if self.source == "auto" else [_FAMILIES[self.source]]
        kinds = _DETECTORS if self.keypoints == "detected" else (self.keypoints,)
        there = [family for family in families if family.is_in(self.folder)]
        for kind in kinds:
            for family in there:
                if family.offers(self.folder, kind):
                    return family(self.folder, kind, self.partial)
        able = [
            (family, kind)
            for family in (*there, *families)
            for kind in kinds
            if kind in ("gt", "projected") or kind in family.files_of
        ]
        if not able:
            having = {f.name: ["gt", "projected", *(k for k in f.files_of if k != "gt")] for f in families}
            shown = "; ".join(f"{name}: {', '.join(names)}" for name, names in having.items())
            raise UserError(
                f"data.options.keypoints={self.keypoints}: the files of this kind have none. There may be: {shown}."
            )
        family, kind = able[0]
        return family(self.folder, kind, self.partial)
