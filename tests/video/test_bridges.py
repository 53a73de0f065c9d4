"""The detectors of docs/video.md, each with a stand-in for the library it calls that takes and gives what the library does."""

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

import uplift
from uplift.data.formats.layouts import COCO_JOINTS

PAGE = Path(__file__).resolve().parents[2] / "docs/video.md"
BLUE, RED = (10, 20, 250), (240, 30, 10)
TRUE = np.random.default_rng(0).uniform(5, 60, (2, 17, 2)).astype(np.float32)
SURE = np.random.default_rng(1).uniform(0.4, 1, (2, 17)).astype(np.float32)


def block(file: str) -> str:
    return next(
        text
        for text in re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.M | re.S)
        if text.startswith(f"# {file}\n")
    )


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Return a function that writes a detector of the page, lets it import ``modules``, and runs it on a picture."""
    pixels = np.full((48, 64, 3), BLUE, np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")

    def run(file: str, name: str, modules: dict[str, dict], **options):
        for module, contents in modules.items():
            made = ModuleType(module)
            vars(made).update(contents)
            monkeypatch.setitem(sys.modules, module, made)
        (tmp_path / file).write_text(block(file))
        return uplift.detect(tmp_path / "a.png", detector=f"{tmp_path / file}:{name}", detector_options=options)

    return run


def is_bgr(image) -> None:
    assert image.dtype == np.uint8 and image.flags.c_contiguous and tuple(image[0, 0]) == BLUE[::-1]


def two_people(data, points=TRUE, sure=SURE):
    np.testing.assert_allclose(data.keypoints, points, atol=1e-4)
    np.testing.assert_allclose(data.confidence, sure, atol=1e-6)


def test_the_class_of_the_page(written):
    data = written("my.py", "MyDetector", {}, threshold=0.4)
    assert data.joint_names == ("head", "thorax", "abdomen_tip")
    np.testing.assert_allclose(data.confidence, [[0.9, 0.8, 0]])


def test_rtmlib(written):
    class Body:
        def __init__(self, mode, backend, device):
            assert (mode, backend, device) == ("lightweight", "onnxruntime", "cpu")

        def __call__(self, image):
            is_bgr(image)
            return TRUE, SURE

    data = written("rtm.py", "Rtm", {"rtmlib": {"Body": Body}}, mode="lightweight")
    assert data.joint_names == COCO_JOINTS
    two_people(data)


def test_ultralytics(written):
    points = TRUE.copy()
    points[1, 3] = 0

    class YOLO:
        def __init__(self, model):
            assert model == "yolo11n-pose.pt"

        def predict(self, image, verbose):
            is_bgr(image)
            return [SimpleNamespace(keypoints=SimpleNamespace(xy=torch.tensor(points), conf=torch.tensor(SURE)))]

    data = written("yolo.py", "Yolo", {"ultralytics": {"YOLO": YOLO}})
    assert data.confidence[1, 3] == 0
    seen = data.confidence > 0
    two_people(data, np.where(seen[..., None], points, data.keypoints), np.where(seen, SURE, 0))


@pytest.mark.parametrize("kind", ["pytorch", "base"])
def test_deeplabcut(written, kind):
    names, calls = ["snout", "left_ear", "tail"], []

    class DLCLive:
        is_initialized = False

        def __init__(self, model, model_type):
            assert (model, model_type) == ("exported", kind)

        def read_config(self):
            return {"metadata": {"bodyparts": names}} if kind == "pytorch" else {"all_joints_names": names}

        def init_inference(self, image):
            self.is_initialized = True
            calls.append("init")
            return self.get_pose(image)

        def get_pose(self, image):
            assert self.is_initialized
            is_bgr(image)
            return np.concatenate([TRUE[0, :3], SURE[0, :3, None]], 1)  # of one animal: no axis of individuals

    data = written("dlc.py", "Dlc", {"dlclive": {"DLCLive": DLCLive}}, model="exported", kind=kind)
    assert data.joint_names == tuple(names) and calls == ["init"]
    two_people(data, TRUE[:1, :3], SURE[:1, :3])


def test_sleap(written):
    points, sure = np.full((1, 3, 17, 2), np.nan, np.float32), np.full((1, 3, 17), np.nan, np.float32)
    points[0, :2], sure[0, :2] = TRUE, SURE  # there may be up to three

    class Predictor:
        skeleton = SimpleNamespace(node_names=[f"node{number}" for number in range(17)])

        @classmethod
        def from_model_paths(cls, models):
            assert models == ["centroid", "instance"]
            return cls()

        def predict(self, images, make_labels):
            assert images.shape == (1, 48, 64, 3) and tuple(images[0, 0, 0]) == BLUE and not make_labels  # it wants RGB
            return [SimpleNamespace(pred_keypoints=torch.tensor(points), pred_peak_values=torch.tensor(sure))]

    fakes = {"sleap_nn": {}, "sleap_nn.inference": {"Predictor": Predictor}}
    data = written("sleap.py", "Sleap", fakes, models="centroid,instance")
    assert data.joint_names[:2] == ("node0", "node1")
    two_people(data)
