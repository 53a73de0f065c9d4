"""The verb predict: keypoints in, poses out (or masks in, shapes out), in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from uplift.cli.detect import check_keypoints_output
from uplift.cli.in_parts import lift_in_parts
from uplift.cli.inputs import long_input, read_input
from uplift.cli.kinds import KINDS
from uplift.cli.outputs import check_outputs, shows_video, write_outputs
from uplift.cli.parsing import Keys, known_camera
from uplift.cli.pose_summary import Summary
from uplift.cli.request import Request, request_of
from uplift.cli.together import TOGETHER_KEYS, check_together, lift_views, views_of, write_found
from uplift.cli.verbs import NWB_KEYS, REFINE
from uplift.config.files import files_of
from uplift.config.run import Weights, read_weights
from uplift.config.trust import Trust, consents
from uplift.data.clean import clean
from uplift.data.formats.base import ReadOptions
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.export import check_axes, check_measure
from uplift.export.scene import in_axes
from uplift.models.known_body import check_body
from uplift.models.known_camera import KnownCamera
from uplift.models.likely_size import odd_size
from uplift.models.metric_scale import size_from
from uplift.models.model import Model, load_poses
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.video.detector import Detector
from uplift.video.frames import is_frames

__all__ = ["Done", "keypoint_arguments", "lift_keypoints", "predict", "predict_keys"]


@consents
def predict(
    run: str | Path | Weights,
    input: str | Path,
    output: str | Path | None = None,
    *overrides: str,
    refine: bool | str = True,
    hypotheses: int = 0,
    constant_bones: bool = False,
    size: Mapping[str, Any] | None = None,
    camera: KnownCamera | None = None,
    ground: bool = False,
    detector: str | Detector | None = None,
    detector_options: Mapping[str, Any] | None = None,
    people: int | None = None,
    start_s: int | float | None = None,
    end_s: int | float | None = None,
    keypoints: str | Path | None = None,
    reading: ReadOptions | None = None,
    axes: str | None = None,
    page: str | None = None,
    check: bool = True,
    accelerator: str = "auto",
    written: dict[Path, str] | None = None,
    trust: Trust = None,
    **options: Any,
) -> Prediction | ShapePrediction:
    """Lift the keypoints or masks of ``input`` with the model of ``run`` and write them to ``output``, if given.

    ``input`` is a file or folder in any format that is read, several with commas or a pattern; a video or pictures, in which
    keypoints are found as `uplift.detect` does, and written to ``keypoints`` (.npz or .csv), if given; or ``SET:SPLIT`` of a
    published data set (``file.py:Class:SPLIT`` for a class of yours), whose ``data.root`` and ``data.options.*`` are
    ``overrides`` such as a fit takes. ``reading`` is what the files lack. ``output`` is a file, or several with commas, each in
    the format of its ending.

    The frames of a clip are lifted together unless ``refine`` is off (or ``"causal"``: as far as a live picture allows).
    ``hypotheses`` are so many poses of each frame, with their probabilities. ``size`` are arguments of
    `uplift.models.metric_scale.size_from`. ``camera`` is what is known of how the camera stands, and ``ground`` keeps
    standing feet where they are. Without ``check`` a ready lifter lifts what does not look like the body that it knows
    (`uplift.models.known_body`), too. ``accelerator`` is what computes: ``"auto"``, ``"cpu"``, ``"cuda"`` or ``"mps"``.

    ``axes`` are those of `uplift.export.scene`, the format's usual ones by default. ``page`` is the kind of an .html,
    ``viewer`` or ``gallery``, and ``options`` are those of the writers. The files written, with a remark on each, are added
    to ``written``. ``trust`` are files and modules of code that may run where the run names it, such as ``"my_nets.py"``.

    With a run that lifts masks, ``options`` (and ``size`` among them) are those of `uplift.export.write` for shapes and
    of `uplift.data.formats.read_masks`; what goes with keypoints is refused.

    Raises:
        UserError: no such run or input, joints that do not fit the model's skeleton, another body than a ready lifter's, no
            mask that can be used, an output that exists already or cannot be written.
    """
    weights = run if isinstance(run, Weights) else read_weights(run)
    given = {
        "refine": refine,
        "hypotheses": hypotheses,
        "constant_bones": constant_bones,
        "size": size,
        "camera": camera,
        "ground": ground,
        "detector": detector,
        "detector_options": detector_options,
        "people": people,
        "start_s": start_s,
        "end_s": end_s,
        "keypoints": keypoints,
        "reading": reading,
        "axes": axes,
        "page": page,
        "check": check,
        "accelerator": accelerator,
    }
    request = request_of(weights, input, output, overrides, given | options)
    prediction, files = KINDS[weights.lifts].predict(request)
    if written is not None:
        written |= files
    return prediction


@dataclass(frozen=True)
class Done:
    """What one command of predict did."""

    frames: int
    notes: list[str]
    """What there is to say of the poses or shapes."""
    files: dict[Path, str]
    """The files written, with a remark on each."""

    def lines(self) -> list[str]:
        """Return what to print."""
        files = self.files
        shown = [path for name in dict.fromkeys(path.suffix for path in files) for path in _first_of(name, files)]
        lines = [*self.notes, *(f"wrote {path}" + (f": {files[path]}" if files[path] else "") for path in shown)]
        lines += [f"and {len(files) - len(shown)} more"] * (len(files) > len(shown))
        return lines + [f"look: open {path} in a browser" for path in files if path.suffix.lower() == ".html"]


def predict_keys(keys: Keys, weights: Weights, outputs: Sequence[str] | None = None) -> Done:
    """Lift and write what the words of the command ask for, to ``outputs`` where they are given; long inputs in parts."""
    kind = KINDS[weights.lifts]
    kind.refuse_others("predict", keys, keys["run"])
    if "port" in keys:
        raise UserError("port= goes with output=live.")
    overrides = tuple(f"{key}={value}" for key, value in keys.items() if key.startswith("data."))
    arguments = kind.predict_arguments(keys) | {"axes": keys.get("axes"), "page": keys.get("page")}
    found, files = kind.predict(request_of(weights, keys["input"], outputs or keys["output"], overrides, arguments))
    notes = [weights.note] * bool(weights.note) + kind.predict_summary(found)
    notes += [] if weights.folder is None else weights.folder.warnings()
    return Done(len(found), notes, files)


def _first_of(ending: str, files: Mapping[Path, str]) -> list[Path]:
    """Return the first five files with this ending."""
    return [path for path in files if path.suffix == ending][:5]


# Keypoints in, poses out.


def keypoint_arguments(keys: Keys) -> dict[str, Any]:
    """Return the arguments of `predict` that the command line gives for keypoints."""
    size = keys.given("height_mm", "bone_mm", "camera_height_mm")
    if "bone" in keys:
        size["bone"] = tuple(keys.value("bone"))
    nwb = {name.removeprefix("nwb."): said for name, said in keys.given(*NWB_KEYS).items()}
    return {
        "refine": REFINE[keys.value("refine")],
        "hypotheses": keys.value("hypotheses"),
        "constant_bones": keys.value("bones") == "constant",
        "size": size,
        "camera": known_camera(keys),
        "ground": keys.value("ground"),
        **keys.detection(),
        "keypoints": keys.value("keypoints"),
        "check": keys.value("check"),
        "accelerator": keys.value("accelerator"),
        "part_frames": keys.value("part_frames"),
        "reading": keys.reading(),
        **({"nwb": nwb} if nwb else {}),
        **keys.given("images", "video", "frames", "seed", "csv_safe", "mass_kg", "together", *TOGETHER_KEYS),
    }


def lift_keypoints(request: Request) -> tuple[Prediction | Summary, dict[Path, str]]:
    """Lift keypoints and write the poses, if there is an output; return the files with a remark on each.

    Of an input that is lifted in parts there is no prediction, but its summary.
    """
    axes, options = request.axes, dict(request.options)
    together = check_together(options, request.outputs)
    check_axes("", axes)
    _check_request(request, together, options)
    options |= _footage(request, together, options)
    model = load_poses(request.weights).on(request.accelerator)
    for output in request.outputs:
        check_measure(output, model.skeleton)
    how = {
        "title": request.title,
        "refine": request.refine,
        "size": size_from(model.skeleton, **request.size),
        "constant_bones": request.constant_bones,
    }
    request = replace(request, options=options)
    if together:
        found, files = _lift_together(request, model, together, how)
    else:
        how |= {"hypotheses": request.hypotheses, "camera": request.camera, "ground": request.ground}
        found, files = _lift_alone(request, model, how)
    if axes is not None and isinstance(found, Prediction):
        found = in_axes(found, axes)
    return found, files


def _lift_together(
    request: Request, model: Model, together: Mapping[str, Any], how: Mapping[str, Any]
) -> tuple[Prediction, dict[Path, str]]:
    """Lift several cameras of one scene as one body."""

    def read(path: str) -> PoseData:
        return read_input(replace(request, input=path), model.skeleton, alone=False)

    views = views_of(request.input, read)
    warnings = _warnings(request, model, views)
    prediction, cameras = lift_views(model, views, dict(together), **how)
    prediction, files = _written(prediction, request, warnings)
    if "cameras_output" in together:
        write_found(prediction, cameras, together["cameras_output"])
        files[Path(together["cameras_output"])] = f"{len(cameras)} cameras"
    return prediction, files


def _lift_alone(request: Request, model: Model, how: Mapping[str, Any]) -> tuple[Prediction | Summary, dict[Path, str]]:
    """Lift each camera by itself: all frames at once, or those of a long input in parts."""
    skeleton = model.skeleton
    source = long_input(request, skeleton)
    if source is None:
        data = read_input(request, skeleton)
        clean(data, skeleton)  # refuses a file with nothing to lift, before any work
        source = long_input(request, skeleton, data)
        if source is None:
            warnings = _warnings(request, model, [data])
            return _written(model.predict(data, **how), request, warnings)
        del data  # it is the parts' now, and goes with them
    found, files = lift_in_parts(request, model, source, lambda part: _warnings(request, model, [part]), how)
    return found, files | _kept(request)


def _written(prediction: Prediction, request: Request, warnings: Sequence[str]) -> tuple[Prediction, dict[Path, str]]:
    """Write a prediction whose notes end with warnings; return it, and the files with a remark on each."""
    prediction = replace(prediction, notes=(*prediction.notes, *warnings))
    files = write_outputs(prediction, request.outputs, request.page, request.axes, request.options)
    return prediction, files | _kept(request)


def _kept(request: Request) -> dict[Path, str]:
    """Return the file of the keypoints that were found in a video, with a remark."""
    return {} if request.keypoints is None else {Path(request.keypoints): "the 2D"}


def _warnings(request: Request, model: Model, views: Sequence[PoseData]) -> list[str]:
    """Return warnings about a size that cannot be, and views that hardly show the body that the lifter knows.

    A ready lifter refuses other bodies.
    """
    odd = odd_size(model.skeleton, request.size)
    strange: list[str | None] = []
    if request.check:
        weights = request.weights
        strange = [check_body(model, view, weights.run, refuse=weights.ready) for view in views]
    return list(dict.fromkeys(filter(None, [odd, *strange])))


def _check_request(request: Request, together: Mapping[str, Any], options: Mapping[str, Any]) -> None:
    """Refuse what does not go together, and outputs that cannot be written: before any work."""
    if together and (request.hypotheses or request.camera or request.ground or request.refine == "causal"):
        raise UserError(
            "together=true does not go with hypotheses=, camera.tilt_deg=, camera.roll_deg=, ground= or refine=causal: these "
            "are for one camera."
        )
    _check_frames(request, together)
    if options.get("images") is not None and request.reading is not None:
        for key in {"flip_x", "flip_y", "rotate"} & set(request.reading.set_names()):
            raise UserError(f"{key}= turns the keypoints and not the photos of images=: give one of the two.")
    if request.outputs:
        check_outputs(request.outputs, request.page, request.axes, options, request.hypotheses)


def _footage(request: Request, together: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, str]:
    """Return the option of the video that a page or a film shows: what was asked for, else the input that is one."""
    turned = request.reading and request.reading.set_names()
    turned = sorted({"flip_x", "flip_y", "rotate"} & set(turned or ()))
    shown = request.page != "gallery" and any(map(shows_video, request.outputs))
    if "video" not in options:
        own = shown and is_frames(request.input) and not (together or turned or _is_camera(request.input))
        return {"video": str(request.input)} if own else {}
    if not shown:
        raise UserError(
            f"video= goes with a page (output=FILE.html) or a film (.mp4, .gif), not with {request.output}."
        )
    if turned or together:
        why = f"{turned[0]}= turns the keypoints and not the video" if turned else "together=true shows no one video"
        raise UserError(f"video={options['video']}: {why}: give one of the two.")
    files_of(options["video"])  # refuses what is not there, before any work
    return {}


def _is_camera(input: str | Path) -> bool:
    return str(input).startswith("camera:")


def _check_frames(request: Request, together: Mapping[str, Any]) -> None:
    """Refuse what goes with videos and pictures alone, and with neither."""
    if not is_frames(request.input):
        given = [name for name, value in vars(request.detection).items() if value is not None and value != {}]
        given += ["keypoints"] if request.keypoints is not None else []
        if given:
            name = {"options": "detector.options", "start_s": "video.start_s", "end_s": "video.end_s"}.get(
                given[0], given[0]
            )
            raise UserError(f"{name}= goes with a video or pictures as input=; {request.input} is none.")
    elif request.keypoints is not None and together:
        raise UserError("keypoints= goes with one video, not with together=true: uplift detect writes those of each.")
    elif request.keypoints is not None:
        check_keypoints_output(request.keypoints, "keypoints")
