"""A clip as Universal Scene Description (``.usda``, ``.usdc``): a sphere for each joint, a line for each bone, moving."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.config.files import replacing_by_name
from uplift.data.poses import USUAL_FPS
from uplift.export.clips import evenly, frame_rate, one_clip
from uplift.export.scene import SIDE_COLOURS, body_of, in_metres, known_points, linear, row_places
from uplift.export.tables import labels, unique
from uplift.models.prediction import Prediction

__all__ = ["write_usd"]

_JOINT_SHARE, _BONE_SHARE = 0.016, 0.012  # radius and width, as shares of the body


def write_usd(prediction: Prediction, path: str | Path) -> str:
    """Write one clip with all its individuals: an Xform each, below it a Sphere for each joint and a curve for each bone.

    Metres where the prediction is in mm, else a body is about 1.7 large. Time codes are frames of the video at its rate (30 a second
    where none is known). Names are kept as display names where they are no identifiers. What is missing is invisible. USD
    has y or z up: z in the axes ``blender``, else y. Without a known place individuals stand side by side as in the image.
    Raises UserError for several clips, and for an individual that is in a frame twice.
    """
    from pxr import Usd, UsdGeom  # type: ignore

    clip, start = evenly(one_clip(prediction, path), path)
    rate = frame_rate(prediction, None)
    scale, size = in_metres(prediction)
    places = clip.by_moment((known_points(prediction.pose) + row_places(prediction, clip)[:, None]) * scale)
    names = [name or prediction.skeleton.name for name in clip.individual_names]
    with replacing_by_name(path) as written:
        stage = Usd.Stage.CreateNew(str(written))
        _set_up(stage, prediction, rate or USUAL_FPS, (start, start + len(places) - 1))
        top = UsdGeom.Xform.Define(stage, "/Poses")
        stage.SetDefaultPrim(top.GetPrim())
        about = {"axes": prediction.axes, "unit": prediction.unit, "scale": scale, "fps_assumed": rate is None}
        top.GetPrim().SetCustomDataByKey("uplift", about)
        for who, prim in enumerate(_identifiers(names)):
            _show(UsdGeom.Xform.Define(stage, f"/Poses/{prim}"), names[who])
            _Individual(stage, f"/Poses/{prim}", places[:, who], start, size).draw(prediction)
        stage.GetRootLayer().Save()
    notes = ["frames a second are not known: 30"] * (rate is None)
    notes += [f"1 px is {scale:.3g} m: the size is not known"] * (prediction.unit != "mm")
    return "; ".join(notes)


def _set_up(stage: Any, prediction: Prediction, rate: float, frames: tuple[int, int]) -> None:
    """Say which axis is up, how long a unit is, and how fast time goes."""
    from pxr import UsdGeom  # type: ignore

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if prediction.axes == "blender" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(frames[0])
    stage.SetEndTimeCode(frames[1])


@dataclass
class _Individual:
    """Where an individual's joints are, ``places`` (frames joints 3) in metres from frame ``start`` on, and the prim that holds them."""

    stage: Any
    top: str
    places: Float[np.ndarray, "frames joints 3"]
    start: int
    size: float

    def draw(self, prediction: Prediction) -> None:
        """Make a sphere for each joint and a line for each bone."""
        body, colours = body_of(prediction), [tuple(linear(rgb).tolist()) for rgb in SIDE_COLOURS.values()]
        names = list(prediction.joint_names)
        names += ["-".join(names[joint] for joint in bone) for bone in body.bones]
        prims, joints = _identifiers(names), len(prediction.joint_names)
        for joint, side in enumerate(body.joint_sides):
            _show(self._ball(prims[joint], joint, colours[side]), names[joint])
        for at, (bone, side) in enumerate(zip(body.bones, body.bone_sides, strict=True), start=joints):
            _show(self._line(prims[at], bone, colours[side]), names[at])

    def _ball(self, prim: str, joint: int, colour: tuple[float, ...]) -> Any:
        from pxr import UsdGeom, Vt  # type: ignore

        ball = UsdGeom.Sphere.Define(self.stage, f"{self.top}/{prim}")
        radius = _JOINT_SHARE * self.size
        ball.CreateRadiusAttr(radius)
        ball.CreateExtentAttr([(-radius,) * 3, (radius,) * 3])
        ball.CreateDisplayColorAttr([colour])
        move, known = ball.AddTranslateOp(), np.asarray(np.isfinite(self.places[:, joint]).all(-1))
        self._keep(move.GetAttr(), known, Vt.Vec3dArray.FromNumpy(self.places[known, joint]))
        _hide(ball, known, self.start)
        return ball

    def _line(self, prim: str, bone: Int[np.ndarray, "2"], colour: tuple[float, ...]) -> Any:
        from pxr import UsdGeom, Vt  # type: ignore

        line = UsdGeom.BasisCurves.Define(self.stage, f"{self.top}/{prim}")
        line.CreateTypeAttr(UsdGeom.Tokens.linear)
        line.CreateCurveVertexCountsAttr([2])
        line.CreateWidthsAttr([_BONE_SHARE * self.size])
        line.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        line.CreateDisplayColorAttr([colour])
        points, extent = line.CreatePointsAttr(), line.CreateExtentAttr()
        known = np.asarray(np.isfinite(self.places[:, bone]).all((1, 2)))
        ends = self.places[:, bone][known].astype(np.float32)
        self._keep(points, known, map(Vt.Vec3fArray.FromNumpy, ends))
        self._keep(extent, known, map(Vt.Vec3fArray.FromNumpy, np.stack([ends.min(1), ends.max(1)], 1)))
        _hide(line, known, self.start)
        return line

    def _keep(self, attribute: Any, known: Bool[np.ndarray, " frames"], values: Iterable[Any]) -> None:
        """Give an attribute its values of the frames that are known, in the layer itself: a stage looks at each again."""
        from pxr import Sdf  # type: ignore

        layer, path = self.stage.GetRootLayer(), attribute.GetPath()
        with Sdf.ChangeBlock():
            for time, value in zip((self.start + np.flatnonzero(known)).tolist(), values, strict=True):
                layer.SetTimeSample(path, float(time), value)


def _hide(shape: Any, known: Bool[np.ndarray, " frames"], start: int) -> None:
    """Hide a shape where it is not known; a visibility holds until the next."""
    from pxr import UsdGeom  # type: ignore

    changes = np.flatnonzero(np.diff(known, prepend=True))
    if known.all():
        return
    shape.CreateVisibilityAttr().Set(UsdGeom.Tokens.inherited, start)
    for frame in changes.tolist():
        now = UsdGeom.Tokens.inherited if known[frame] else UsdGeom.Tokens.invisible
        shape.GetVisibilityAttr().Set(now, start + frame)


def _identifiers(names: Iterable[str]) -> list[str]:
    """Return names that prims may have."""
    from pxr import Tf  # type: ignore

    return unique(Tf.MakeValidIdentifier(name) for name in labels(names))


def _show(schema: Any, name: str) -> None:
    """Keep the name for people."""
    schema.GetPrim().SetDisplayName(labels([name])[0])
