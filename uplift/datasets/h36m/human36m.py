"""The data set Human3.6M: which files, which keypoints, how many frames a second."""

from __future__ import annotations

from pathlib import Path

from uplift.data.container import PoseData
from uplift.datasets.base import DataSet, WantedFile
from uplift.datasets.h36m.assemble import RATE, assemble
from uplift.datasets.h36m.cdf import OfficialCdf
from uplift.datasets.h36m.clips import Family
from uplift.datasets.h36m.martinez import Martinez
from uplift.datasets.h36m.pickles import Pickles
from uplift.datasets.h36m.videopose3d import VideoPose3D
from uplift.errors import UserError, did_you_mean

__all__ = ["Human36M"]

_FAMILIES: dict[str, type[Family]] = {family.name: family for family in (VideoPose3D, Pickles, Martinez, OfficialCdf)}
_KINDS = ("gt", "projected", "sh", "cpn", "detectron", "sh_mpii")
_DETECTORS = ("sh", "cpn", "detectron", "sh_mpii")


class Human36M(DataSet):
    """Human3.6M (Ionescu et al. 2014): four cameras, 15 actions, 17 of its 32 joints.

    Args:
        folder: where the files are.
        keypoints: ``gt``, ``projected`` (the ground truth made anew from the 3D), ``sh``, ``cpn``,
            ``detectron``, ``sh_mpii``, or ``detected``: the first of these detectors that is there.
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
        told = f"Human3.6M {split} in {self.folder} ({family.name}, keypoints {how}, {self.fps} frames/s)"
        return assemble(clips, RATE // self.fps, family.keypoints, told)

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
