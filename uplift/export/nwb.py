"""A clip in Neurodata Without Borders (``.nwb``): a PoseEstimation of ndx-pose for each individual, in 3D."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import replacing_by_name
from uplift.config.run import version_of
from uplift.errors import UserError, did_you_mean
from uplift.export.clips import Clip, evenly, frame_rate, one_clip
from uplift.export.scene import AXES, known_points
from uplift.export.tables import labels
from uplift.models.prediction import Prediction

__all__ = ["SESSION", "SUBJECT", "check_nwb", "write_nwb"]

SESSION = ("session_start_time", "session_description", "identifier", "experimenter", "institution", "lab")
SUBJECT = ("subject_id", "species", "sex", "age")
"""What a user may say of the recording and of whom it shows; as NWB has them: age P90D, sex M, F, U or O."""
_UNKNOWN = "1970-01-01T00:00:00+00:00"
_UNITS = {"mm": ("meters", 0.001), "px": ("pixels", 1.0), "relative": ("relative", 1.0)}
"""NWB wants SI units."""
_ANY_AGE = "P0D/"
"""Zero days or more, as NWB writes a range."""
_CONFIDENCE = "of the 2D keypoint by its tracker, 0 to 1; 0: not seen, and filled in"


def check_nwb(nwb: Mapping[str, str]) -> None:
    """Raise UserError for words of ``nwb.*`` that NWB does not have, and for a time that is none."""
    for key in nwb:
        if key not in (*SESSION, *SUBJECT):
            raise UserError(f"nwb.{key}: no such word.{did_you_mean(key, (*SESSION, *SUBJECT))}")
    given = nwb.get("session_start_time", _UNKNOWN)
    try:
        datetime.fromisoformat(given)
    except ValueError:
        expected = "a date and time such as 2026-05-01T10:30:00+02:00"
        raise UserError(f"nwb.session_start_time={given}: expected {expected}.") from None
    if nwb.get("sex", "U") not in ("M", "F", "U", "O"):
        raise UserError(f"nwb.sex={nwb['sex']}: expected M, F, U (unknown) or O (other).")


def write_nwb(prediction: Prediction, path: str | Path, nwb: Mapping[str, str] | None = None) -> str:
    """Write one clip: ``processing/behavior`` gets a PoseEstimation for each individual, and their Skeleton.

    The only individual's is called PoseEstimation, as other programs expect; several are called as they are. Each joint
    is a series (frames, 3) of metres, or of pixels where there is no size, with its confidence, at an even rate; what
    is missing is NaN. ``nwb`` has words of `SESSION` and `SUBJECT`. Returns what was not known and had to be made up.
    Raises UserError without a frame rate, for several clips, and as `check_nwb`.
    """
    import pynwb
    from ndx_pose import PoseEstimation, Skeleton, Skeletons

    nwb = nwb or {}
    check_nwb(nwb)
    clip, start = evenly(one_clip(prediction, path), path)
    rate = frame_rate(prediction, None)
    if rate is None:
        raise UserError(f"{path}: NWB counts seconds, and the frame rate is not known. Give it: fps=30.")
    names = labels(prediction.joint_names, "/:")
    file = _file(prediction, clip, nwb)
    edges = prediction.bone_indices.astype(np.uint8 if len(names) < 256 else np.uint16)
    skeleton = Skeleton(
        name=labels([prediction.skeleton.name], "/:")[0], nodes=names, edges=edges, subject=file.subject
    )
    module = file.create_processing_module("behavior", "Poses in 3D, lifted from 2D keypoints of one camera")
    module.add(Skeletons(skeletons=[skeleton]))
    shared = {
        "scorer": "uplift",
        "source_software": "uplift",
        "source_software_version": version_of("uplift3d") or "unknown",
    }
    for who, (title, series) in enumerate(
        zip(_titles(clip), _series(prediction, clip, names, start, rate), strict=True)
    ):
        shared |= {"name": title, "description": _about(prediction, clip, who)}
        module.add(PoseEstimation(pose_estimation_series=series, skeleton=skeleton, **shared))
    with replacing_by_name(path) as written, pynwb.NWBHDF5IO(path=str(written), mode="w") as io:
        io.write(container=file)
    unknown = [key for key in ("session_start_time", "species", "sex", "age") if key not in nwb]
    stands = f" ({_UNKNOWN[:10]} stands for the time)" if unknown[:1] == ["session_start_time"] else ""
    return f"not known{stands}: {', '.join(unknown)}; say it by nwb.{unknown[0]}=" if unknown else ""


def _series(prediction: Prediction, clip: Clip, names: list[str], start: int, rate: float) -> Iterator[list[Any]]:
    """Yield each individual's series of joints: places, NaN where missing, and confidences, 0 there."""
    from ndx_pose import PoseEstimationSeries

    unit, scale = _UNITS[prediction.unit]
    points = clip.by_moment(known_points(prediction.points) * scale).astype(np.float32)
    seen = np.nan_to_num(clip.by_moment(np.asarray(prediction.confidence, float))).clip(0, 1).astype(np.float32)
    shared = {"reference_frame": _frame_of(prediction), "unit": unit, "rate": rate, "starting_time": start / rate}
    shared |= {"confidence_definition": _CONFIDENCE}
    for who in range(len(clip.individual_names)):
        yield [
            PoseEstimationSeries(
                name=name,
                description=f"Where {name} is",
                data=points[:, who, at],
                confidence=seen[:, who, at],
                **shared,
            )
            for at, name in enumerate(names)
        ]


def _titles(clip: Clip) -> list[str]:
    """Return the names of the individuals' objects: that of the default for the only one, which readers look for."""
    if len(clip.individual_names) == 1:
        return ["PoseEstimation"]
    taken = "Skeletons"  # what else lies in the module
    return labels([taken, *clip.individual_names], "/:")[1:]


def _frame_of(prediction: Prediction) -> str:
    zero = f"the joint '{prediction.skeleton.root}'" if prediction.root is None else "the camera"
    return f"(0, 0, 0) is {zero}; {AXES[prediction.axes]}".encode("utf-8", "replace").decode()


def _about(prediction: Prediction, clip: Clip, who: int) -> str:
    parts = [clip.individual_names[who], clip.title or clip.name, prediction.title]
    of = ", ".join(dict.fromkeys(part for part in parts if part))
    return labels([f"3D pose of {of}, lifted from 2D keypoints; the frame rate is that of the keypoints"])[0]


def _file(prediction: Prediction, clip: Clip, nwb: Mapping[str, str]) -> Any:
    """Return an NWBFile with what is known of the session."""
    import pynwb

    digest = hashlib.sha256(prediction.pose.tobytes()).hexdigest()[:12]
    name = labels([prediction.title or clip.name])[0]
    when = datetime.fromisoformat(nwb.get("session_start_time", _UNKNOWN))
    about = "Video of which the poses are known; nothing else was said of the session."
    known = {"session_description": about, "identifier": f"{name}-{digest}"}
    known |= {key: nwb[key] for key in SESSION[1:] if key in nwb}
    who = ", ".join(filter(None, clip.individual_names)) or name
    subject = {"subject_id": labels([who], "/")[0], "sex": "U", "age": _ANY_AGE}
    subject |= {key: nwb[key] for key in SUBJECT if key in nwb}
    return pynwb.NWBFile(
        session_start_time=when if when.tzinfo else when.replace(tzinfo=UTC),
        experiment_description="3D poses lifted from 2D keypoints of a video",
        keywords=["pose estimation", "3D", "behavior"],
        subject=pynwb.file.Subject(**subject),
        **known,
    )
