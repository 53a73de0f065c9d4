"""Cameras and joints of data sets against what others published of them: none of these figures is the package's."""

from __future__ import annotations

import numpy as np
import pytest

from uplift.data.datasets.cmu import JOINTS as CMU_JOINTS
from uplift.data.datasets.h36m_files import LAYOUTS, OF_32, published
from uplift.data.datasets.mpi_inf_3dhp import _TEST_JOINTS, _TRAIN_JOINTS, published_cameras
from uplift.data.datasets.mpii import AUTHORS_JOINTS, MPII_JOINTS
from uplift.data.formats.layouts import COCO_JOINTS, H36M_JOINTS, HOURGLASS_JOINTS
from uplift.skeleton import load_skeleton

# Human3.6M's calibration as karfly/human36m-camera-parameters takes it from metadata.xml: where the room's origin is
# in the camera's frame, mm, and where the room's up points there.
ROOM = {
    "S1": ((-346.05, 546.98, 5474.48, 0.02575, -0.98225, -0.18582), (251.43, 420.94, 5588.20, 0.00225, -0.97684, -0.21396),
           (480.48, 253.83, 5704.21, -0.04572, -0.97570, -0.21429), (51.88, 378.42, 4406.15, 0.06191, -0.95923, -0.27578)),
    "S5": ((-219.31, 544.48, 5518.74, 0.02097, -0.98091, -0.19335), (103.90, 395.67, 5767.97, 0.01227, -0.97701, -0.21283),
           (520.33, 283.37, 5591.12, -0.06173, -0.97521, -0.21247), (-79.12, 425.59, 4454.48, 0.08405, -0.96361, -0.25374)),
    "S6": ((-239.52, 545.81, 5523.93, 0.00804, -0.98064, -0.19568), (169.03, 409.67, 5714.34, 0.01853, -0.97615, -0.21630),
           (521.99, 286.28, 5643.27, -0.06856, -0.97618, -0.20586), (-56.30, 420.30, 4499.32, 0.09192, -0.96355, -0.25122)),
    "S7": ((-323.91, 541.77, 5506.57, 0.01475, -0.98113, -0.19277), (178.62, 403.59, 5694.88, 0.01617, -0.97585, -0.21785),
           (441.11, 271.92, 5660.12, -0.06515, -0.97621, -0.20682), (25.77, 431.06, 4461.87, 0.09055, -0.96280, -0.25458)),
    "S8": ((-82.70, 552.19, 5557.35, 0.02020, -0.98114, -0.19226), (-209.06, 375.07, 5818.28, 0.01252, -0.97679, -0.21382),
           (623.10, 290.91, 5534.38, -0.06251, -0.97518, -0.21241), (-178.37, 423.47, 4421.64, 0.08500, -0.96336, -0.25440)),
    "S9": ((-321.21, 467.13, 5514.33, 0.04132, -0.98224, -0.18300), (19.19, 404.23, 5702.17, -0.00733, -0.97858, -0.20573),
           (455.40, 273.36, 5657.81, -0.03862, -0.97475, -0.21993), (-69.27, 422.18, 4457.89, 0.06362, -0.96218, -0.26488)),
    "S11": ((-234.72, 464.34, 5536.65, 0.03873, -0.98159, -0.18701), (-11.93, 449.42, 5541.11, -0.00142, -0.97932, -0.20230),
            (781.13, 235.31, 5576.37, -0.04094, -0.97256, -0.22901), (-155.14, 422.16, 4435.42, 0.06518, -0.96291, -0.26185)),
}  # fmt: skip
CAMERAS = ("54138969", "55011271", "58860488", "60457274")
# From the same place: focal lengths and centre, px, and OpenCV's k1 k2 p1 p2 k3.
LENSES = {
    "54138969": (1145.0494, 1143.7811, 512.5415, 515.4515, -0.207099, 0.247775, -0.00142447, -0.000975699, -0.00307515),
    "55011271": (1149.6757, 1147.5917, 508.8486, 508.0649, -0.194214, 0.240409, -0.00274089, -0.00161903, 0.00681998),
    "58860488": (1149.1407, 1148.7990, 519.8158, 501.4027, -0.208338, 0.255488, -0.00075999, 0.00148439, -0.0024605),
    "60457274": (1145.5113, 1144.7739, 514.9682, 501.8820, -0.198384, 0.218324, -0.00181336, -0.000587206, -0.00894781),
}  # fmt: skip


@pytest.mark.parametrize("subject", ROOM)
def test_cameras_of_human36m_stand_where_they_stood(subject: str) -> None:
    for camera, (x, y, z, *up) in zip(CAMERAS, ROOM[subject], strict=True):
        origin, above = published(subject, camera).see(np.array([[0.0, 0, 0], [0, 0, 1]]))
        np.testing.assert_allclose(origin, (x, y, z), atol=0.1)
        np.testing.assert_allclose(above - origin, up, atol=1e-4)


@pytest.mark.parametrize("camera", CAMERAS)
def test_lenses_of_human36m_see_as_its_own_projection_does(camera: str) -> None:
    """With the figures as named by OpenCV, whose p2 comes first in the file: its terms in x y without the factor 2."""
    fx, fy, cx, cy, k1, k2, p2, p1, k3 = LENSES[camera]
    points = np.random.default_rng(0).normal(0, 0.3, (20, 2))
    (x, y), square = points.T, (points**2).sum(-1)
    bend = 1 + k1 * square + k2 * square**2 + k3 * square**3 + p1 * y + p2 * x
    expected = np.stack([fx * (x * bend + p2 * square) + cx, fy * (y * bend + p1 * square) + cy], -1)
    lens = published("S1", camera).lens
    np.testing.assert_allclose(lens.project(np.c_[points, np.ones(20)]), expected, atol=1e-2)
    assert lens.image_size == ((1000, 1002) if camera in ("54138969", "60457274") else (1000, 1000))


def test_test_cameras_of_3dhp_are_those_that_others_use() -> None:
    """In pixels, of several repositories that train on the set; theirs have one focal length for both axes of TS1-4."""
    (studio,), (outdoors, plain) = published_cameras(1), published_cameras(6)
    found = (studio.lens.focal_px[0], *studio.lens.centre_px)
    np.testing.assert_allclose(found, (1500.172288, 1017.38733568, 1043.03198208))
    for camera in (outdoors, plain):
        np.testing.assert_allclose(camera.lens.focal_px, (1683.98345952, 1672.59370772), rtol=1e-6)
        np.testing.assert_allclose(camera.lens.centre_px, (939.85754016, 560.140743168), rtol=1e-6)
    assert outdoors.lens.radial == (-0.276859611, 0.131125256, -0.049318332)
    assert outdoors.lens.tangential == (-0.001149441, -0.000360494) and not plain.lens.bends


def plain(names: tuple[str, ...]) -> str:
    """Return names without underscores, capitals and the word for the side: l or r before the part."""
    short = (name.lower().replace("_", "") for name in names)
    return " ".join(name.replace("left", "l").replace("right", "r") for name in short)


# The motion capture's 32 joints, as una-dinosauria/3d-pose-baseline numbers them.
NAMES_OF_32 = {
    0: "hip", 1: "rhip", 2: "rknee", 3: "rankle", 6: "lhip", 7: "lknee", 8: "lankle", 12: "spine", 13: "thorax",
    14: "nose", 15: "headtop", 17: "lshoulder", 18: "lelbow", 19: "lwrist", 25: "rshoulder", 26: "relbow", 27: "rwrist",
}  # fmt: skip
COCO = "nose leye reye lear rear lshoulder rshoulder lelbow relbow lwrist rwrist lhip rhip lknee rknee lankle rankle"


def test_joints_of_human36m_are_on_their_sides() -> None:
    assert dict(zip(OF_32, H36M_JOINTS, strict=True)) == NAMES_OF_32
    assert CMU_JOINTS == H36M_JOINTS == load_skeleton("h36m17").joints
    # joints_left and joints_right of VideoPose3D's files, of each kind of 2D.
    for names, left, right in (
        (H36M_JOINTS, (4, 5, 6, 11, 12, 13), (1, 2, 3, 14, 15, 16)),
        (HOURGLASS_JOINTS, (3, 4, 5, 13, 14, 15), (2, 1, 0, 12, 11, 10)),
    ):
        assert [names[place][0] for place in left] == ["l"] * 6
        assert [names[place] for place in right] == [f"r{names[place][1:]}" for place in left]
    mpii = "rankle rknee rhip lhip lknee lankle hip thorax upperneck headtop rwrist relbow rshoulder lshoulder lelbow lwrist"
    assert plain(MPII_JOINTS) == plain(load_skeleton("mpii16").joints[:16]) == mpii
    parts = ("hip thorax upperneck headmiddle headtop", "hip knee ankle", "shoulder elbow wrist")
    middle, leg, arm = (part.split() for part in parts)
    sides = {side: ([f"{side}{part}" for part in leg], [f"{side}{part}" for part in arm]) for side in "lr"}
    assert plain(AUTHORS_JOINTS).split() == [
        middle[0], *sides["r"][0], *sides["l"][0], *middle[1:], *sides["l"][1], *sides["r"][1]
    ]  # fmt: skip


def test_keypoints_of_coco_make_the_joints_of_human36m() -> None:
    names = COCO.split()
    assert plain(COCO_JOINTS) == COCO
    for joint, places in LAYOUTS["coco"].items():
        made = {names[place] for place in places}
        both = {"hip": {"lhip", "rhip"}, "thorax": {"lshoulder", "rshoulder"}}
        assert made == both.get(joint, {joint} if joint != "spine" else both["hip"] | both["thorax"]), joint


def test_joints_of_3dhp_are_on_their_sides() -> None:
    """The order of mpii_get_joint_set.m; and the 17 of the test set among them, as P-STMO picks them."""
    limbs = "clavicle shoulder elbow wrist hand", "hip knee ankle foot toe"
    arms, legs = ([f"{side}{part}" for side in "lr" for part in limb.split()] for limb in limbs)
    trunk = ["spine3", "spine4", "spine2", "spine", "pelvis", "neck", "head", "headtop"]
    assert plain(_TRAIN_JOINTS).split() == [*trunk, *arms, *legs]
    chosen = (7, 5, 14, 15, 16, 9, 10, 11, 23, 24, 25, 18, 19, 20, 4, 3, 6)
    assert [_TRAIN_JOINTS[place] for place in chosen] == list(_TEST_JOINTS)
    assert (
        load_skeleton("mpi_inf_3dhp28").joints == _TRAIN_JOINTS
        and load_skeleton("mpi_inf_3dhp17").joints == _TEST_JOINTS
    )
