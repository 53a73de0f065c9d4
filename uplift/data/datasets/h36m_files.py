"""Human3.6M's names, cameras and the files it comes in: VideoPose3D, the 2018 pickles, Martinez et al., official CDF."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.data.datasets.base import WantedFile
from uplift.data.formats.layouts import H36M_JOINTS as JOINTS
from uplift.data.formats.layouts import HOURGLASS_JOINTS
from uplift.data.parsers.files import check_claim, check_memory
from uplift.data.parsers.pickles import load_object_npz, load_pickle
from uplift.errors import UserError, did_you_mean, listed
from uplift.geometry.lens import Lens
from uplift.geometry.rigid import quaternion_matrix

__all__ = [
    "ACTIONS",
    "CAMERAS",
    "LAYOUTS",
    "OF_32",
    "Clip",
    "Family",
    "Martinez",
    "OfficialCdf",
    "Pickles",
    "VideoPose3D",
    "published",
]

# What Human3.6M calls its subjects, actions and joints, and what the files made of it call them.

_SUBJECTS = {"train": ("S1", "S5", "S6", "S7", "S8"), "test": ("S9", "S11")}

ACTIONS = (
    "Directions", "Discussion", "Eating", "Greeting", "Phoning", "Photo", "Posing", "Purchases", "Sitting",
    "SittingDown", "Smoking", "Waiting", "WalkDog", "Walking", "WalkTogether",
)  # fmt: skip
"""In the order of the papers' tables."""

_OTHER_NAMES = {"TakingPhoto": "Photo", "WalkingDog": "WalkDog"}

OF_32 = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
"""Their indices in the 32 joints of the motion capture; the others do not move, or are there twice."""


def _places(joints: tuple[str, ...]) -> dict[str, tuple[int, ...]]:
    return {joint: (joints.index(joint),) for joint in JOINTS if joint in joints}


LAYOUTS: dict[str, dict[str, tuple[int, ...]]] = {
    "h36m": _places(JOINTS),
    "hourglass": _places(HOURGLASS_JOINTS),
    # Trained on MPII: there place 7 is the thorax and 8 the neck, and nothing marks the spine.
    "hourglass_mpii": {**_places(HOURGLASS_JOINTS), "thorax": (7,), "spine": (6, 7)},
    "coco": {
        "hip": (11, 12), "rhip": (12,), "rknee": (14,), "rankle": (16,), "lhip": (11,), "lknee": (13,),
        "lankle": (15,), "spine": (5, 6, 11, 12), "thorax": (5, 6), "nose": (0,), "lshoulder": (5,),
        "lelbow": (7,), "lwrist": (9,), "rshoulder": (6,), "relbow": (8,), "rwrist": (10,),
    },
}  # fmt: skip
"""Layouts of 2D keypoints: our joint -> the keypoints it is the mean of. The hourglass network has no nose."""


def _action(name: str) -> str:
    """Return the action of a name such as ``WalkingDog 1`` or ``Photo_2.54138969.h5``, known or not."""
    word = re.split(r"[ _.]", name.strip(), maxsplit=1)[0]
    return _OTHER_NAMES.get(word, word)


def _sequence_name(name: str, where: str) -> tuple[str, str] | None:
    """Return action and sequence of a name such as ``WalkingDog 1`` or ``Photo_2``; None for ``_ALL``.

    Raises:
        UserError: not an action of the set.
    """
    if name.startswith("_"):
        return None
    word, _, number = name.replace("_", " ").strip().partition(" ")
    action = _action(name)
    if action not in ACTIONS or (number and not number.isdigit()):
        raise UserError(
            f"{where}: '{name}' is not an action of Human3.6M.{did_you_mean(word, (*ACTIONS, *_OTHER_NAMES))}"
        )
    return action, f"{action} {number}".strip()


_CORRUPT = ("S11", "Directions", "54138969")
"""Subject, sequence and camera of the one video that cannot be played."""

# Human3.6M's four cameras and where they stood for each subject, as published.

CAMERAS = ("54138969", "55011271", "58860488", "60457274")


@dataclass(frozen=True)
class _Camera:
    """A camera and its position: a point X of the room, in mm, is R (X - T) in its frame."""

    lens: Lens
    rotation: np.ndarray = field(compare=False)
    """R, (3, 3)."""
    place_mm: np.ndarray = field(compare=False)
    """T, (3,)."""

    def see(self, points_mm: np.ndarray) -> np.ndarray:
        """Return points of the room, (..., 3), in the camera frame (x right, y down, z away), mm."""
        from_here = (points_mm - self.place_mm.astype(points_mm.dtype)).reshape(-1, 3)  # one large product, not many
        return (from_here @ self.rotation.T.astype(points_mm.dtype)).reshape(points_mm.shape)

    @property
    def tilt_deg(self) -> float:
        """Down-tilt: gravity is (0, cos, sin) in the camera frame, but for the little that it rolls."""
        down = -self.rotation[:, 2]
        return float(np.degrees(np.arctan2(down[2], down[1])))


# focal length x y, centre x y (px), k1 k2 k3, p1 p2, image size. From the set's metadata.xml, as copied
# in facebookresearch/VideoPose3D, common/h36m_dataset.py.
_LENSES = {
    "54138969": ((1145.0494384765625, 1143.7811279296875), (512.54150390625, 515.4514770507812),
                 (-0.20709891617298126, 0.24777518212795258, -0.0030751503072679043),
                 (-0.0009756988729350269, -0.00142447161488235), (1000, 1002)),
    "55011271": ((1149.6756591796875, 1147.5916748046875), (508.8486328125, 508.0649108886719),
                 (-0.1942136287689209, 0.2404085397720337, 0.006819975562393665),
                 (-0.0016190266469493508, -0.0027408944442868233), (1000, 1000)),
    "58860488": ((1149.1407470703125, 1148.7989501953125), (519.8158569335938, 501.40264892578125),
                 (-0.2083381861448288, 0.25548800826072693, -0.0024604974314570427),
                 (0.0014843869721516967, -0.0007599993259645998), (1000, 1000)),
    "60457274": ((1145.5113525390625, 1144.77392578125), (514.9682006835938, 501.88201904296875),
                 (-0.198384091258049, 0.21832367777824402, -0.008947807364165783),
                 (-0.0005872055771760643, -0.0018133620033040643), (1000, 1002)),
}  # fmt: skip

# Of each camera in the order of CAMERAS: quaternion w x y z that turns the camera frame into the room, place (mm).
_STANDS = {
    "S1": (
        (0.1407056450843811, -0.1500701755285263, -0.755240797996521, 0.6223280429840088, 1841.1070556640625, 4955.28466796875, 1563.4454345703125),
        (0.6157187819480896, -0.764836311340332, -0.14833825826644897, 0.11794740706682205, 1761.278564453125, -5078.0068359375, 1606.2650146484375),
        (0.14651472866535187, -0.14647851884365082, 0.7653023600578308, -0.6094175577163696, -1846.7777099609375, 5215.04638671875, 1491.972412109375),
        (0.5834008455276489, -0.7853162288665771, 0.14548823237419128, -0.14749594032764435, -1794.7896728515625, -3722.698974609375, 1574.8927001953125),
    ),
    "S5": (
        (0.1467377245426178, -0.162370964884758, -0.7551892995834351, 0.6178938746452332, 2097.3916015625, 4880.94482421875, 1605.732421875),
        (0.6159758567810059, -0.7626792192459106, -0.15728192031383514, 0.1189815029501915, 2031.7008056640625, -5167.93310546875, 1612.923095703125),
        (0.14291371405124664, -0.12907841801643372, 0.7678384780883789, -0.6110143065452576, -1620.5948486328125, 5171.65869140625, 1496.43701171875),
        (0.5920479893684387, -0.7814217805862427, 0.1274748593568802, -0.15036417543888092, -1637.1737060546875, -3867.3173828125, 1547.033203125),
    ),
    "S6": (
        (0.1337897777557373, -0.15692396461963654, -0.7571090459823608, 0.6198879480361938, 1935.4517822265625, 4950.24560546875, 1618.0838623046875),
        (0.6147197484970093, -0.7628812789916992, -0.16174767911434174, 0.11819244921207428, 1969.803955078125, -5128.73876953125, 1632.77880859375),
        (0.1529948115348816, -0.13529130816459656, 0.7646096348762512, -0.6112781167030334, -1769.596435546875, 5185.361328125, 1476.993408203125),
        (0.5916101336479187, -0.7804774045944214, 0.12832270562648773, -0.1561593860387802, -1721.668701171875, -3884.13134765625, 1540.4879150390625),
    ),
    "S7": (
        (0.1435241848230362, -0.1631336808204651, -0.7548328638076782, 0.6188824772834778, 1974.512939453125, 4926.3544921875, 1597.8326416015625),
        (0.6141672730445862, -0.7638262510299683, -0.1596645563840866, 0.1177929937839508, 1937.0584716796875, -5119.7900390625, 1631.5665283203125),
        (0.14550060033798218, -0.12874816358089447, 0.7660516500473022, -0.6127139329910278, -1741.8111572265625, 5208.24951171875, 1464.8245849609375),
        (0.5912848114967346, -0.7821764349937439, 0.12445473670959473, -0.15196487307548523, -1734.7105712890625, -3832.42138671875, 1548.5830078125),
    ),
    "S8": (
        (0.14110587537288666, -0.15589867532253265, -0.7561917304992676, 0.619644045829773, 2150.65185546875, 4896.1611328125, 1611.9046630859375),
        (0.6169601678848267, -0.7647668123245239, -0.14846350252628326, 0.11158157885074615, 2219.965576171875, -5148.453125, 1613.0440673828125),
        (0.1471444070339203, -0.13377119600772858, 0.7670128345489502, -0.6100369691848755, -1571.2215576171875, 5137.0185546875, 1498.1761474609375),
        (0.5927824378013611, -0.7825870513916016, 0.12147816270589828, -0.14631995558738708, -1476.913330078125, -3896.7412109375, 1547.97216796875),
    ),
    "S9": (
        (0.15540587902069092, -0.15548215806484222, -0.7532095313072205, 0.6199594736099243, 2044.45849609375, 4935.1171875, 1481.2275390625),
        (0.618784487247467, -0.7634735107421875, -0.14132238924503326, 0.11933968216180801, 1990.959716796875, -5123.810546875, 1568.8048095703125),
        (0.13357827067375183, -0.1367100477218628, 0.7689454555511475, -0.6100738644599915, -1670.9921875, 5211.98583984375, 1528.387939453125),
        (0.5879399180412292, -0.7823407053947449, 0.1427614390850067, -0.14794869720935822, -1696.04345703125, -3827.099853515625, 1591.4127197265625),
    ),
    "S11": (
        (0.15232472121715546, -0.15442320704460144, -0.7547563314437866, 0.6191070079803467, 2098.440185546875, 4926.5546875, 1500.278564453125),
        (0.6189449429512024, -0.7600917220115662, -0.15300633013248444, 0.1255258321762085, 2083.182373046875, -4912.1728515625, 1561.07861328125),
        (0.14943228662014008, -0.15650227665901184, 0.7681233882904053, -0.6026304364204407, -1609.8153076171875, 5177.3359375, 1537.896728515625),
        (0.5894251465797424, -0.7818877100944519, 0.13991211354732513, -0.14715361595153809, -1590.738037109375, -3854.1689453125, 1578.017578125),
    ),
}  # fmt: skip


def published(subject: str, camera: str, *, swapped: bool = False) -> _Camera:
    """Return the camera as it stood for ``subject``.

    The data set's projection, and Martinez', multiply p1 with y and p2 with x; VideoPose3D's, which made its
    ground truth, swaps them (``swapped``): some tenths of a pixel.
    """
    focal_px, centre_px, radial, (p1, p2), size = _LENSES[camera]
    stand = np.array(_STANDS[subject][CAMERAS.index(camera)])
    lens = Lens(focal_px, centre_px, radial, (p1, p2) if swapped else (p2, p1), size)
    quaternion = np.roll(stand[:4] / np.linalg.norm(stand[:4]), -1)
    return _Camera(lens, quaternion_matrix(quaternion).T, stand[4:])


# `Clip`: one sequence of Human3.6M seen by one camera; `Family`: one kind of files that hold such clips.


@dataclass(frozen=True)
class Clip:
    """One sequence seen by one camera, not read yet."""

    subject: str
    action: str
    sequence: str
    camera_id: str
    camera: _Camera
    where: str
    """The file, and the place in it, for messages."""
    frames: int
    """Of the motion capture, at 50 Hz."""
    positions: Callable[[int], np.ndarray]
    """Every so many frames: (frames, 17, 3) float32, camera frame, mm."""
    seen: Callable[[], np.ndarray] | None = None
    """(frames, joints, 2 or 3), px and confidence, in `layout`; None where the positions are projected."""
    layout: str = "h36m"


class Family:
    """One kind of files that Human3.6M comes in; a subclass has `files`, `_open`, `_names` and `_clip`."""

    name: ClassVar[str]
    poses: ClassVar[tuple[str, ...]]
    """Patterns of the files of the 3D, below the folder."""
    files_of: ClassVar[dict[str, str]] = {}
    """Kind of keypoints -> where they are, as part of `found_by`."""
    found_by: ClassVar[str] = "{}"
    may_lack: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Subjects and actions that published files leave out."""

    def __init__(self, folder: Path, keypoints: str, partial: bool):
        self.folder, self.keypoints, self.partial = folder, keypoints, partial

    @classmethod
    def is_in(cls, folder: Path) -> bool:
        """Return whether the 3D of this kind is in ``folder``."""
        return any(any(folder.glob(pattern)) for pattern in cls.poses)

    @classmethod
    def offers(cls, folder: Path, keypoints: str) -> bool:
        """Return whether 2D of this kind is in ``folder``, or can be projected."""
        place = cls.files_of.get(keypoints)
        return keypoints in ("gt", "projected") or bool(place and any(folder.glob(cls.found_by.format(place))))

    def files(self, split: str) -> list[WantedFile]:
        """Return the files that ``split`` is read from."""
        raise NotImplementedError

    def clips(self, split: str) -> list[Clip]:
        """Return the clips of ``split``; raises UserError where the files are not as they should be."""
        self._open(split)
        clips = []
        for subject in _SUBJECTS[split]:
            for name, action, sequence in self._in_order(subject):
                for camera_id in CAMERAS:
                    found = self._clip(subject, name, sequence, camera_id)
                    if found:
                        clips.append(Clip(subject, action, sequence, camera_id, *found))
        return clips

    def _open(self, split: str) -> None:
        """Read what all clips need."""

    def _names(self, subject: str) -> tuple[list[str], str]:
        """Return the names of the subject's sequences, and where they are."""
        raise NotImplementedError

    def _clip(self, subject: str, name: str, sequence: str, camera_id: str) -> tuple | None:
        """Return the fields of a `Clip` from its camera on; None where there is none."""
        raise NotImplementedError

    def _in_order(self, subject: str) -> list[tuple[str, str, str]]:
        """Return (name in the file, action, sequence) in the order of the papers' tables.

        Raises:
            UserError: a name that is not an action, or an action that is missing, but for those in ``may_lack``.
        """
        names, where = self._names(subject)
        known = [(name, *parsed) for name in names if (parsed := _sequence_name(name, where))]
        there = {action for _, action, _ in known}
        lacking = [action for action in ACTIONS if action not in there and (subject, action) not in self.may_lack]
        if lacking and not self.partial:
            raise UserError(
                f"{where}: {subject} has no {', '.join(lacking)} ({len(ACTIONS) - len(lacking)} of {len(ACTIONS)} "
                "actions). Get the rest, or set data.options.partial=true to go on with what is there."
            )
        sequences = [sequence for _, _, sequence in known]
        twice = [sequence for sequence in sequences if sequences.count(sequence) > 1]
        if twice:
            raise UserError(f"{where}: {subject} has '{twice[0]}' twice, under two names.")
        return sorted(known, key=lambda item: (ACTIONS.index(item[1]), item[2]))

    def _in(self, subject: str, place: str, example: str, what: str) -> list[WantedFile]:
        """Return the files in a folder of a subject; where there are none, the one that should be there first."""
        folder = self.folder / subject / place
        found = sorted(path for path in folder.glob(f"*{Path(example).suffix}") if not path.name.startswith("_"))
        return [WantedFile(path, what, f"{subject} {_action(path.name)}") for path in found or [folder / example]]


def _table_of(value: Any, where: str, wanted: Collection[str] = ()) -> dict[str, Any]:
    """Return ``value`` where it is a dict by text that has the ``wanted`` keys; raises UserError."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise UserError(f"{where} is {_kind(value)}, expected a dict by name.")
    lacking = [key for key in wanted if key not in value]
    if lacking:
        found = listed(sorted(value))
        raise UserError(
            f"{where} has no {', '.join(lacking)} (found: {found or 'nothing'}): part of the file, or another's?"
        )
    return value


def _points_of(value: Any, where: str, joints: Collection[int], size: Collection[int]) -> np.ndarray:
    """Return ``value`` as (frames, joints, size) where it is numbers of such a shape, flattened or not."""
    wanted = f"({', '.join(['frames', '|'.join(map(str, joints)), '|'.join(map(str, size))])}) of numbers"
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise UserError(f"{where} is {_kind(value)}, expected an array {wanted}.")
    if value.ndim == 2:
        fitting = [(j, s) for j in joints for s in size if j * s == value.shape[1]]
        value = value.reshape(len(value), *fitting[0]) if fitting else value
    if value.ndim != 3 or value.shape[1] not in joints or value.shape[2] not in size:
        raise UserError(f"{where} has shape {value.shape}, expected {wanted}.")
    return value


def _kind(value: Any) -> str:
    return f"an array of {value.dtype}, {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def _in_room(points: Callable[[], np.ndarray], camera: _Camera, mm: int = 1) -> Callable[[int], np.ndarray]:
    """Return `Clip.positions` for (frames, 32, 3) points of the room, ``mm`` millimetres a unit."""

    def positions(step: int) -> np.ndarray:
        chosen = points()[::step, OF_32].astype(np.float32)
        if mm != 1:
            chosen *= np.float32(mm)
        return camera.see(chosen)

    return positions


# The npz files of VideoPose3D: 3D in metres in the room, ground truth and detections in pixels.

# By number of joints and the indices of the left ones, which every file has in its 'metadata'.
_LEFT = {(17, (4, 5, 6, 11, 12, 13)): "h36m", (17, (1, 3, 5, 7, 9, 11, 13, 15)): "coco", (16, (3, 4, 5, 13, 14, 15)): "hourglass"}  # fmt: skip


class VideoPose3D(Family):
    """As written by the scripts of facebookresearch/VideoPose3D (data/prepare_data_h36m.py and beside it).

    2D of sequences without 3D is left out, as VideoPose3D does.
    """

    name = "videopose3d"
    poses = ("data_3d_h36m.npz",)
    files_of: ClassVar[dict[str, str]] = {
        "gt": "data_2d_h36m_gt.npz",
        "cpn": "data_2d_h36m_cpn_ft_h36m_dbb.npz",
        "detectron": "data_2d_h36m_detectron_ft_h36m.npz",
        "detectron_coco": "data_2d_h36m_detectron_pt_coco.npz",
        "sh": "data_2d_h36m_sh_ft_h36m.npz",
        "sh_mpii": "data_2d_h36m_sh_pt_mpii.npz",
    }
    may_lack = (("S11", "Directions"),)

    def files(self, split: str) -> list[WantedFile]:
        """Return the 3D, and the 2D unless it is projected."""
        wanted = [WantedFile(self.folder / self.poses[0], "3D joints of all subjects, as VideoPose3D prepares them")]
        path = self._keypoints_file()
        if path:
            wanted.append(WantedFile(path, f"2D keypoints ({self.keypoints}), as VideoPose3D has them"))
        return wanted

    def _keypoints_file(self) -> Path | None:
        file = self.files_of.get(self.keypoints)
        if file is None or (self.keypoints == "gt" and not (self.folder / file).is_file()):
            return None
        return self.folder / file

    def _open(self, split: str) -> None:
        self.path, self.seen_path = self.folder / self.poses[0], self._keypoints_file()
        self.points = self._by_subject(_arrays(self.path, ["positions_3d"]), self.path, split)
        self.layout = "h36m"
        if self.seen_path:
            arrays = _arrays(self.seen_path, ["positions_2d", "metadata"])
            self.layout = self._layout(arrays["metadata"])
            self.seen = self._by_subject(arrays, self.seen_path, split)

    def _by_subject(self, arrays: dict[str, Any], path: Path, split: str) -> dict[str, Any]:
        name = next(iter(arrays))
        return _table_of(arrays[name], f"{path}, '{name}'", _SUBJECTS[split])

    def _layout(self, metadata: Any) -> str:
        facts = _table_of(metadata, f"{self.seen_path}, 'metadata'", ["num_joints", "keypoints_symmetry"])
        try:
            left = tuple(int(place) for place in facts["keypoints_symmetry"][0])
            layout = _LEFT[int(facts["num_joints"]), left]
        except (KeyError, TypeError, ValueError, IndexError):
            raise UserError(
                f"{self.seen_path}: unknown layout of keypoints (metadata: {str(facts)[:200]}), expected that of "
                "Human3.6M (17 joints), COCO (17) or the stacked hourglass (16)."
            ) from None
        return "hourglass_mpii" if layout == "hourglass" and self.keypoints == "sh_mpii" else layout

    def _names(self, subject: str) -> tuple[list[str], str]:
        where = f"{self.path}, '{subject}'"
        return list(_table_of(self.points[subject], where)), where

    def _clip(self, subject: str, name: str, sequence: str, camera_id: str) -> tuple | None:
        where = f"{self.path}, '{subject}', '{name}'"
        points = _points_of(self.points[subject][name], where, (32,), (3,))
        where = f"{where}, camera {camera_id}"
        camera = published(subject, camera_id, swapped=self.keypoints == "gt")
        seen = None
        if self.seen_path:
            view = self._views(subject, name)[CAMERAS.index(camera_id)]
            if view is None:
                return None
            count = 16 if self.layout.startswith("hourglass") else 17
            array = _points_of(view, f"the 2D of {where}", (count,), (2, 3))
            seen = partial(np.asarray, array)
        return camera, where, len(points), _in_room(lambda: points, camera, 1000), seen, self.layout

    def _views(self, subject: str, name: str) -> Any:
        """Return the four cameras' keypoints of a sequence."""
        where = f"{self.seen_path}, '{subject}'"
        views = _table_of(self.seen[subject], where, [name])[name]
        if not isinstance(views, (list, tuple, np.ndarray)) or len(views) != len(CAMERAS):
            raise UserError(f"{where}, '{name}' is not a list of {len(CAMERAS)} cameras' keypoints.")
        return views


def _arrays(path: Path, names: list[str]) -> dict[str, Any]:
    arrays = load_object_npz(path, names)
    for name in names:
        if name not in arrays:
            raise UserError(f"{path} has no array '{name}': another data set's file?")
    return {name: arrays[name] for name in names}


# The pickles that the authors of Kudo et al. 2018 published: 3D in mm in the room, cameras, detections.

_SHAPES = {"R": (3, 3), "T": (3,), "f": (2,), "c": (2,), "k": (3,), "p": (2,)}


class Pickles(Family):
    """As read by DwangoMediaVillage/3dpose_gan, projection_gan/pose/dataset/pose_dataset.py."""

    name = "pickles"
    poses = ("points_3d.pkl",)
    files_of: ClassVar[dict[str, str]] = {"sh": "sh_detect_2d.pkl"}

    def files(self, split: str) -> list[WantedFile]:
        """Return the 3D, the cameras and the detections."""
        wanted = [
            WantedFile(self.folder / "points_3d.pkl", "3D joints of all subjects, as the authors of 2018 have them"),
            WantedFile(self.folder / "cameras.pkl", "the cameras, from the same place"),
        ]
        if self.keypoints == "sh":
            wanted.append(WantedFile(self.folder / self.files_of["sh"], "2D detections, from the same place"))
        return wanted

    def _open(self, split: str) -> None:
        self.paths = [file.path for file in self.files(split)]
        self.tables = [_table_of(load_pickle(path), str(path), _SUBJECTS[split]) for path in self.paths]

    def _names(self, subject: str) -> tuple[list[str], str]:
        points_at, cameras_at, *seen_at = (f"{path}, '{subject}'" for path in self.paths)
        points, cameras, *seen = (table[subject] for table in self.tables)
        cameras = _table_of(cameras, cameras_at, CAMERAS)
        self.cameras = {c: _camera(cameras[c], f"{cameras_at}, '{c}'") for c in CAMERAS}
        if seen:
            views = _table_of(seen[0], seen_at[0])
            self.views = {parsed[1]: v for name, v in views.items() if (parsed := _sequence_name(name, seen_at[0]))}
        return list(_table_of(points, points_at)), points_at

    def _clip(self, subject: str, name: str, sequence: str, camera_id: str) -> tuple | None:
        if (subject, sequence.partition(" ")[0], camera_id) == _CORRUPT:  # both sequences, as the authors' code does
            return None
        where = f"{self.paths[0]}, '{subject}', '{name}'"
        points = _points_of(self.tables[0][subject][name], where, (32,), (3,))
        seen = None
        if self.keypoints == "sh":
            at = f"{self.paths[2]}, '{subject}'"
            views = _table_of(_table_of(self.views, at, [sequence])[sequence], f"{at}, '{sequence}'", [camera_id])
            seen = _without_nose(views[camera_id], f"{at}, '{sequence}', '{camera_id}'")
        camera = self.cameras[camera_id]
        return camera, f"{where}, camera {camera_id}", len(points), _in_room(lambda: points, camera), seen


def _without_nose(view: Any, where: str) -> Callable[[], np.ndarray]:
    """Return keypoints whose nose, where it is the middle of thorax and head, counts as missing."""
    array = _points_of(view, where, (17,), (2, 3))

    def seen() -> np.ndarray:
        between = (array[:, 8, :2] + array[:, 10, :2]) / 2
        if len(array) and np.abs(array[:, 9, :2] - between).max() > 0.01:
            return array
        marked = array.astype(np.float32)
        marked[:, 9, :2] = np.nan  # the network behind these detections has no nose: it was interpolated
        return marked

    return seen


def _camera(facts: Any, where: str) -> _Camera:
    """Return the camera whose parameters have the names of Martinez' code, in which p1 goes with y."""
    facts = _table_of(facts, where, list(_SHAPES))
    values = {}
    for name, shape in _SHAPES.items():
        value = np.asarray(facts[name])
        if value.dtype.kind not in "fiu" or value.size != np.prod(shape) or not np.isfinite(value).all():
            raise UserError(f"{where}: '{name}' is {value.dtype} of shape {value.shape}, expected {shape} numbers.")
        values[name] = value.astype(float).reshape(shape)
    focal_px, centre_px, radial, (p1, p2) = (tuple(values[name].tolist()) for name in "fckp")
    # The files do not give the size of the videos: two of the cameras have 1002 rows.
    lenses = [published("S1", camera).lens for camera in CAMERAS]
    nearest = min(lenses, key=lambda lens: float(np.abs(np.array(lens.centre_px) - centre_px).sum()))
    return _Camera(Lens(focal_px, centre_px, radial, (p2, p1), nearest.image_size), values["R"], values["T"])


# The h5 files of Martinez et al. 2017: 3D in mm in the room, hourglass detections in pixels, cameras.


class Martinez(Family):
    """As read by una-dinosauria/3d-pose-baseline, src/data_utils.py and src/cameras.py."""

    name = "martinez"
    poses = ("S*/MyPoses/3D_positions/*.h5",)
    files_of: ClassVar[dict[str, str]] = {"sh": "StackedHourglassFineTuned240", "sh_mpii": "StackedHourglass"}
    found_by = "S*/{}/*.h5"

    def files(self, split: str) -> list[WantedFile]:
        """Return every file of the split; of a subject without any, the one that should be there first."""
        wanted = []
        for subject in _SUBJECTS[split]:
            wanted += self._in(subject, "MyPoses/3D_positions", "Directions 1.h5", "3D joints (h36m.zip)")
            if self.keypoints in self.files_of:
                place, example = self.files_of[self.keypoints], "Directions_1.54138969.h5"
                wanted += self._in(subject, place, example, "2D detections of the stacked hourglass")
        if (self.folder / "cameras.h5").is_file():
            wanted.append(WantedFile(self.folder / "cameras.h5", "the cameras"))
        return wanted

    def _open(self, split: str) -> None:
        self.points = lru_cache(maxsize=1)(_points)  # the clips of one sequence follow one another
        self.layout = {"sh": "hourglass", "sh_mpii": "hourglass_mpii"}.get(self.keypoints, "h36m")
        self.cameras = {(s, c): published(s, c) for s in _SUBJECTS[split] for c in CAMERAS}
        path = self.folder / "cameras.h5"
        if path.is_file():
            self.cameras = {}
            for subject in _SUBJECTS[split]:
                for number in range(1, 5):
                    camera_id, camera = _read_camera(path, f"subject{subject[1:]}/camera{number}")
                    self.cameras[subject, camera_id] = camera

    def _names(self, subject: str) -> tuple[list[str], str]:
        self.seen = {}
        if self.keypoints in self.files_of:
            for path in sorted((self.folder / subject / self.files_of[self.keypoints]).glob("*.h5")):
                name, _, camera_id = path.stem.rpartition(".")
                parsed = _sequence_name(name, str(path))
                if parsed:
                    self.seen[parsed[1], camera_id] = path
        folder = self.folder / subject / "MyPoses" / "3D_positions"
        return sorted(path.stem for path in folder.glob("*.h5")), str(folder)

    def _clip(self, subject: str, name: str, sequence: str, camera_id: str) -> tuple | None:
        if (subject, sequence, camera_id) == _CORRUPT:
            return None
        path, seen = self.folder / subject / "MyPoses" / "3D_positions" / f"{name}.h5", None
        if self.keypoints in self.files_of:
            seen_path = self.seen.get((sequence, camera_id))
            if seen_path is None:
                folder = self.folder / subject / self.files_of[self.keypoints]
                raise UserError(f"{folder} has no detections of '{sequence}' by camera {camera_id}.")
            seen = partial(_read_hourglass, seen_path)
        frames = _h5(path, "3D_positions", lambda array: array.shape[-1] if array.shape else 0)
        camera = self.cameras[subject, camera_id]
        positions = _in_room(partial(self.points, path), camera)
        return camera, f"{path}, camera {camera_id}", frames, positions, seen, self.layout


def _read_camera(path: Path, place: str) -> tuple[str, _Camera]:
    facts = {key: _read_h5(path, f"{place}/{key}").astype(float).squeeze() for key in (*_SHAPES, "Name")}
    camera_id = "".join(chr(int(letter)) for letter in np.atleast_1d(facts.pop("Name")))
    if camera_id not in CAMERAS or any(facts[key].shape != shape for key, shape in _SHAPES.items()):
        raise UserError(f"{path}: {place} is not a camera of Human3.6M.")
    facts["R"] = facts["R"].T  # stored by column
    return camera_id, _camera(facts, f"{path}: {place}")


def _points(path: Path) -> np.ndarray:
    """Return (frames, 32, 3): the file has a column a frame."""
    values = _read_h5(path, "3D_positions")
    if values.ndim != 2 or values.shape[0] != 96:
        raise UserError(f"{path}: '3D_positions' has shape {values.shape}, expected (96, frames): 32 joints in 3D.")
    return values.T.reshape(-1, 32, 3)


def _read_hourglass(path: Path) -> np.ndarray:
    return _points_of(_read_h5(path, "poses"), f"{path}, 'poses'", (16,), (2, 3))


def _read_h5(path: Path, name: str) -> np.ndarray:
    array = _h5(path, name, lambda found: found[()])
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise UserError(f"{path}: '{name}' has no numbers.")
    return array


def _h5(path: Path, name: str, take: Callable[[Any], Any]) -> Any:
    """Return what ``take`` makes of an array of a file; raises UserError where there is none."""
    try:
        import h5py
    except ImportError:
        raise UserError(f'{path} is an HDF5 file: pip install "uplift3d[h36m]" to read it.') from None
    try:
        with h5py.File(path, "r") as file:
            found = file.get(name)
            if not isinstance(found, h5py.Dataset):
                raise UserError(f"{path} has no '{name}' (found: {listed(file) or 'nothing'}).")
            size = check_claim(f"{path}: '{name}'", found.shape, found.dtype)
            check_memory(path, f"'{name}'", size, path.stat().st_size)
            return take(found)
    except (OSError, ValueError, TypeError, KeyError, RuntimeError, MemoryError) as error:
        raise UserError(f"{path} cannot be read as HDF5 ({error}): truncated, or another format?") from error


# The official CDF poses: 2D in pixels, 3D in mm in the room or in each camera's frame.

_ROOM, _MONO, _SEEN = (f"MyPoseFeatures/{name}" for name in ("D3_Positions", "D3_Positions_mono", "D2_Positions"))


class OfficialCdf(Family):
    """As the archives Poses_D2_Positions_S*.tgz and Poses_D3_Positions(_mono)_S*.tgz unpack."""

    name = "cdf"
    poses = (f"S*/{_MONO}/*.cdf", f"S*/{_ROOM}/*.cdf")

    def __init__(self, folder: Path, keypoints: str, partial: bool):
        super().__init__(folder, keypoints, partial)
        self.mono = any(folder.glob(self.poses[0]))
        self.has_2d = keypoints == "gt" and any(folder.glob(f"S*/{_SEEN}/*.cdf"))
        self.points = lru_cache(maxsize=1)(lambda path: _read_cdf(path, 3))  # clips of a sequence follow one another

    def files(self, split: str) -> list[WantedFile]:
        """Return every file of the split; of a subject without any, the one that should be there first."""
        wanted = []
        of_camera = "Directions 1.54138969.cdf"
        for subject in _SUBJECTS[split]:
            place, example = (_MONO, of_camera) if self.mono else (_ROOM, "Directions 1.cdf")
            wanted += self._in(subject, place, example, f"3D joints (Poses_D3_Positions_{subject}.tgz)")
            if self.has_2d:
                wanted += self._in(subject, _SEEN, of_camera, f"2D joints (Poses_D2_Positions_{subject}.tgz)")
        return wanted

    def _names(self, subject: str) -> tuple[list[str], str]:
        folder = self.folder / subject / (_MONO if self.mono else _ROOM)
        stems = {path.stem.rpartition(".")[0] if self.mono else path.stem for path in folder.glob("*.cdf")}
        return sorted(stems), str(folder)

    def _clip(self, subject: str, name: str, sequence: str, camera_id: str) -> tuple | None:
        if (subject, sequence, camera_id) == _CORRUPT:
            return None
        camera, file = published(subject, camera_id), f"{name}.{camera_id}.cdf"
        folder = self.folder / subject
        path = folder / _MONO / file if self.mono else folder / _ROOM / f"{name}.cdf"
        positions = partial(_in_camera, path) if self.mono else _in_room(partial(self.points, path), camera)
        seen = (lambda: _read_cdf(folder / _SEEN / file, 2)[:, OF_32]) if self.has_2d else None
        return camera, str(path), _shape(path)[-2], positions, seen


def _in_camera(path: Path, step: int) -> np.ndarray:
    return _read_cdf(path, 3)[::step, OF_32].astype(np.float32)


def _read_cdf(path: Path, size: int) -> np.ndarray:
    """Return (frames, 32, size)."""
    _shape(path)
    values = np.asarray(_cdf(path, lambda file: file.varget("Pose")))
    values = values[0] if values.ndim == 3 and len(values) == 1 else values
    return _points_of(values, f"{path}, 'Pose'", (32,), (size,))


def _shape(path: Path) -> tuple[int, ...]:
    """Return the shape that the file claims for its poses: (frames, 64 or 96), with a 1 before it or not."""
    shape = _cdf(path, lambda file: (file.varinq("Pose").Last_Rec + 1, *file.varinq("Pose").Dim_Sizes))
    shape = tuple(int(n) for n in shape)
    if len(shape) not in (2, 3) or shape[-1] not in (64, 96) or (len(shape) == 3 and shape[0] != 1):
        raise UserError(f"{path}: 'Pose' has shape {shape}, expected (frames, 64 or 96): 32 joints in 2D or 3D.")
    if np.prod(shape, dtype=object) * 4 > 1000 * path.stat().st_size:
        raise UserError(f"{path}: 'Pose' claims {shape} numbers: damaged file.")
    return shape


def _cdf(path: Path, take: Callable[[Any], Any]) -> Any:
    """Return what ``take`` makes of a file; raises UserError where it cannot."""
    try:
        import cdflib
    except ImportError:
        raise UserError(f'{path} is a CDF file: pip install "uplift3d[h36m]" to read it.') from None
    if not path.is_file():
        raise UserError(f"No file {path}, which the others beside it lead to expect.")
    try:
        return take(cdflib.CDF(path))
    except UserError:
        raise
    except Exception as error:  # the reader raises whatever it stumbles over in a damaged file
        raise UserError(f"{path} cannot be read as CDF ({error}): truncated, or another format?") from error
