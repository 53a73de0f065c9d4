"""The verb predict: keypoints in, poses out (or masks in, shapes out), in the format of the output's ending."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.cli.detect import check_keypoints_output, keypoints_in
from uplift.cli.kinds import KINDS
from uplift.cli.lifters import hint_for
from uplift.cli.live import LIVE, live_command
from uplift.cli.outputs import check_outputs, outputs_of, refuse_outputs, shows_video, write_outputs
from uplift.cli.parsing import Keys, keyed, known_camera
from uplift.cli.together import TOGETHER_KEYS, check_together, lift_views, views_of, write_found
from uplift.cli.verbs import NWB_KEYS, REFINE, SHAPE_KEYS
from uplift.config.files import files_of
from uplift.config.loading import load_settings
from uplift.config.progress import say
from uplift.config.run import Weights, read_weights
from uplift.config.settings import DataSettings
from uplift.config.trust import Trust, consents
from uplift.data.clean import clean
from uplift.data.datasets import DATA_SETS
from uplift.data.far import without_far
from uplift.data.formats import read_masks
from uplift.data.formats.base import ReadOptions
from uplift.data.load import format_of_run, in_skeleton, load_file, load_split
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.export import check_axes, check_measure, write, writer_for
from uplift.export.scene import in_axes
from uplift.metrics.pose_metrics import bone_cv, bone_lengths, never_seen_so_long
from uplift.models.known_body import check_body
from uplift.models.known_camera import KnownCamera
from uplift.models.likely_size import odd_size, small_size
from uplift.models.metric_scale import size_from
from uplift.models.model import Model, load_poses, load_shapes
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.models.together import CAMERA_NAME
from uplift.skeleton import Skeleton
from uplift.skeleton.match import WrongJoints
from uplift.video.detect import Detection
from uplift.video.detector import Detector
from uplift.video.frames import is_frames

__all__ = [
    "Request", "keypoint_arguments", "lift_keypoints", "lift_masks", "mask_arguments", "pose_summary", "predict",
    "predict_command", "shape_summary",
]  # fmt: skip


@dataclass(frozen=True)
class Request:
    """What is to be lifted, and what becomes of it: the arguments of `predict`."""

    weights: Weights
    input: str | Path
    output: str | Path | None
    overrides: tuple[str, ...]
    refine: bool | str
    hypotheses: int
    constant_bones: bool
    size: Mapping[str, Any]
    reading: ReadOptions | None
    axes: str | None
    page: str | None
    options: Mapping[str, Any]
    camera: KnownCamera | None = None
    ground: bool = False
    detection: Detection = field(default_factory=Detection)
    keypoints: str | Path | None = None
    check: bool = True

    @property
    def outputs(self) -> list[str]:
        """The files to write."""
        return outputs_of(self.output)

    @property
    def title(self) -> str:
        """The name of the first file."""
        return Path(str(self.input).split(",")[0]).stem


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
    (`uplift.models.known_body`), too.

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
    request = Request(
        weights,
        input,
        output,
        overrides,
        refine,
        hypotheses,
        constant_bones,
        size or {},
        reading,
        axes,
        page,
        options,
        camera,
        ground,
        Detection(detector, detector_options or {}, people, start_s, end_s),
        keypoints,
        check,
    )
    prediction, files = KINDS[weights.lifts].predict(request)
    if written is not None:
        written |= files
    return prediction


def predict_command(words: Sequence[str]) -> None:
    """Lift, write, and print what was done."""
    keys = keyed("predict", words)
    weights = read_weights(keys["run"])
    kind = KINDS[weights.lifts]
    kind.refuse_others("predict", keys, keys["run"])
    if keys["output"] == LIVE and weights.lifts == "keypoints":
        live_command(keys, weights)
        return
    if "port" in keys:
        raise UserError("port= goes with output=live.")
    overrides = [f"{key}={value}" for key, value in keys.items() if key.startswith("data.")]
    files: dict[Path, str] = {}
    arguments = kind.predict_arguments(keys) | {"axes": keys.get("axes"), "page": keys.get("page"), "written": files}
    lines = [weights.note] * bool(weights.note)
    lines += kind.predict_summary(predict(weights, keys["input"], keys["output"], *overrides, **arguments))
    lines += [] if weights.folder is None else weights.folder.warnings()
    shown = [path for name in dict.fromkeys(path.suffix for path in files) for path in _first_of(name, files)]
    lines += [f"wrote {path}" + (f": {files[path]}" if files[path] else "") for path in shown]
    lines += [f"and {len(files) - len(shown)} more"] * (len(files) > len(shown))
    lines += [f"look: open {path} in a browser" for path in files if path.suffix.lower() == ".html"]
    say("\n".join(lines))


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
        "reading": keys.reading(),
        **({"nwb": nwb} if nwb else {}),
        **keys.given("images", "video", "frames", "seed", "csv_safe", "mass_kg", "together", *TOGETHER_KEYS),
    }


def lift_keypoints(request: Request) -> tuple[Prediction, dict[Path, str]]:
    """Lift keypoints and write the poses, if there is an output; return the files with a remark on each."""
    axes, options = request.axes, dict(request.options)
    together = check_together(options, request.outputs)
    check_axes("", axes)
    _check_request(request, together, options)
    options |= _footage(request, together, options)
    model = load_poses(request.weights)
    for output in request.outputs:
        check_measure(output, model.skeleton)
    how = {
        "title": request.title,
        "refine": request.refine,
        "size": size_from(model.skeleton, **request.size),
        "constant_bones": request.constant_bones,
    }
    cameras = []
    if together:
        views = views_of(request.input, lambda path: _read(replace(request, input=path), model.skeleton, alone=False))
        strange = _check(request, model, views)
        prediction, cameras = lift_views(model, views, together, **how)
    else:
        data = _read(request, model.skeleton)
        clean(data, model.skeleton)  # refuses a file with nothing to lift, before any work
        strange = _check(request, model, [data])
        more = {"hypotheses": request.hypotheses, "camera": request.camera, "ground": request.ground}
        prediction = model.predict(data, **how, **more)
    odd = odd_size(model.skeleton, request.size)
    prediction = replace(prediction, notes=(*prediction.notes, *([odd] if odd else []), *strange))
    files = write_outputs(prediction, request.outputs, request.page, axes, options)
    if request.keypoints is not None:
        files[Path(request.keypoints)] = "the 2D"
    if "cameras_output" in together:
        write_found(prediction, cameras, together["cameras_output"])
        files[Path(together["cameras_output"])] = f"{len(cameras)} cameras"
    return prediction if axes is None else in_axes(prediction, axes), files


def _check(request: Request, model: Model, views: Sequence[PoseData]) -> list[str]:
    """Return warnings about views that hardly show the body that the lifter knows; a ready one refuses other bodies."""
    if not request.check:
        return []
    weights = request.weights
    found = [check_body(model, view, weights.run, refuse=weights.ready) for view in views]
    return list(dict.fromkeys(filter(None, found)))


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


def _read(request: Request, skeleton: Skeleton, *, alone: bool = True) -> PoseData:
    """Return the keypoints of the input; raises UserError that names a lifter that fits, where another body's joints are in it."""
    try:
        return _keypoints(request, skeleton, alone=alone)
    except WrongJoints as error:
        hint = hint_for(error.names, request.weights.run)
        known = f"{request.input}: {request.weights.run} knows {skeleton.name} ({skeleton.description})"
        raise UserError(f"{known}; {hint}" if request.weights.ready and hint else f"{error} {hint}".strip()) from None


def _keypoints(request: Request, skeleton: Skeleton, *, alone: bool = True) -> PoseData:
    """Return the keypoints of files, or of a split of a data set; a note says where cameras that are lifted ``alone`` show one scene."""
    input, overrides, reading = request.input, request.overrides, request.reading
    if is_frames(input):
        return _read_frames(request, skeleton)
    use, colon, split = str(input).rpartition(":")
    if not colon or Path(input).exists():
        if overrides:
            raise UserError(f"'{overrides[0]}' goes with a data set, input=SET:SPLIT; input={input} is a file.")
        trained = request.weights.settings()
        if trained is not None and (reading is None or reading.format is None):
            reading = replace(reading or ReadOptions(), format=format_of_run(trained, input))
        found = load_file(input, skeleton, reading)
        found = replace(found, notes=(*found.notes, *_cameras_of_one_scene(found))) if alone else found
        return found if trained is None else _with_turns(found, trained.data, reading or ReadOptions())
    if reading is not None and reading.set_names():
        raise UserError(f"{reading.set_names()[0]}= goes with files, not with a published set, input={input}.")
    named = [f"data.name={use}"] if use in DATA_SETS else []
    if use not in DATA_SETS and ":" not in use:
        hint = f"{did_you_mean(use, DATA_SETS)} Your own is file.py:Class:SPLIT; a file has no colon in its name."
        raise UserError(f"input={input}: no data set '{use}'.{hint}")
    settings = load_settings(None, [*named, f"data.use={use}", *overrides])
    if not settings.data.name and settings.data.root is None:
        raise UserError(f"input={input}: where are its files? Give data.root=FOLDER.")
    settings.data.train = split
    return load_split(settings, "train", skeleton)


def _read_frames(request: Request, skeleton: Skeleton) -> PoseData:
    """Return the keypoints of videos or pictures in the joints of a skeleton, and keep them in a file where that is asked for."""
    if request.overrides:
        raise UserError(
            f"'{request.overrides[0]}' goes with a data set, input=SET:SPLIT; input={request.input} does not."
        )
    found = keypoints_in(request.input, request.keypoints, request.detection, skeleton, request.reading)
    return in_skeleton([without_far(found)], [], skeleton)


def _cameras_of_one_scene(data: PoseData) -> list[str]:
    """Return a note where clips seem to be seen by several cameras at once: names that differ in the camera alone, in the same frames."""
    sequence, frame = data.identity.get("sequence"), data.identity.get("frame")
    if sequence is None or frame is None:
        return []
    camera = data.identity.get("camera", np.full(len(data), ""))
    frames: dict[str, dict[str, np.ndarray]] = {}
    names, code = np.unique(np.stack([sequence.astype(str), camera.astype(str)]), axis=1, return_inverse=True)
    for place, (name, named) in enumerate(names.T.tolist()):
        seen_by = " ".join([*(found[0] for found in CAMERA_NAME.finditer(name)), *filter(None, [named])])
        if seen_by:
            frames.setdefault(CAMERA_NAME.sub("", name), {})[seen_by] = np.unique(frame[code == place])
    for scene in frames.values():
        cameras, (first, *others) = list(scene), list(scene.values())
        if any(2 * len(np.intersect1d(first, other)) >= min(len(first), len(other)) for other in others):
            shown = ", ".join(cameras[:4]) + (", ..." if len(cameras) > 4 else "")
            return [
                f"these look like {len(cameras)} cameras of one scene ({shown}): each is lifted by itself, in its own axes; "
                "together=true makes one body of them (docs/several-cameras.md)"
            ]
    return []


def _with_turns(data: PoseData, trained: DataSettings, reading: ReadOptions) -> PoseData:
    """Return ``data`` with a note where the files of the training were flipped or turned, and these are not."""
    turns = [key for key in ("flip_x", "flip_y", "rotate") if getattr(trained, key) and not getattr(reading, key)]
    if not turns:
        return data
    asked = " ".join(f"{key}={str(getattr(trained, key)).lower()}" for key in turns)
    note = f"the run was trained on files that {asked} put upright: add it where this input is like them"
    return replace(data, notes=(*data.notes, note))


def pose_summary(found: Prediction) -> list[str]:
    """Return what to print about poses."""
    blank = int(np.isnan(found.pose).all((1, 2)).sum())
    lines = [*found.notes, f"lifted {len(found) - blank:,} frames of {found.skeleton.name}, unit {found.unit}"]
    if blank:
        why = "too few joints, or all in one point"
        lines.append(f"{blank:,} of {len(found):,} frames cannot be lifted ({why}): their rows are NaN")
    if found.filled is not None and found.filled.any():
        share = found.filled[np.isfinite(found.pose[..., 0])]
        lines.append(f"{share.mean():.1%} of joints were not seen and are filled in (`filled`)" if share.size else "")
    if found.root is not None and found.unit == "mm" and np.isfinite(found.root).any():
        lines.append(f"placed: the camera is {np.nanmedian(found.root[:, 2]) / 1000:.2f} m away (median)")
    lines += _motion(found)
    if never_seen_so_long(found.pose, found.skeleton) > 0.2:
        why = "too little training, or a body that is only ever seen from one side (docs/how-it-works.md)"
        lines.append(f"WARNING: many bones are twice as long as they ever look from the camera: {why}")
    if found.unit == "px":
        height = "height_mm=, or " if "of_height" in found.skeleton.size else ""
        lines.append(f"for millimetres give {height}bone=JOINT,JOINT bone_mm= (docs/output.md)")
    return [line for line in lines if line]


def _motion(found: Prediction) -> list[str]:
    """Return how much bones vary over each clip, where there are clips."""
    clips = PoseData(found.keypoints, found.confidence, found.joint_names, identity=dict(found.identity)).clips()
    if not len(clips) or clips.max() + 1 == len(clips):
        return []
    lengths = bone_lengths(found.pose, found.skeleton)
    lengths = lengths / np.maximum(lengths.sum(1, keepdims=True), 1e-9) if found.unit != "mm" else lengths
    varies = bone_cv(lengths, np.unique(clips, return_inverse=True)[1])
    return [f"bones vary by {varies:.1%} within a clip; bones=constant makes them the same"] * (varies > 1e-4)


# Masks in, shapes out.

_READING = ("format", "border", "pieces", "category", "most", "images", "side")
_OF_MESHES = ("axes", "unit", "height_mm", "length_mm", "smooth", "together")


def mask_arguments(keys: Keys) -> dict[str, Any]:
    """Return the arguments of `predict` that the command line gives for masks."""
    options = keys.given("format", "images", "height_mm", "together", *SHAPE_KEYS)
    if "together" in options:
        options["together"] = options["together"] == "true"
    return options


def lift_masks(request: Request) -> tuple[ShapePrediction, dict[Path, str]]:
    """Lift masks and write the shapes, if there is an output; return the files with a remark on each."""
    others = (
        request.overrides,
        request.refine is not True,
        request.hypotheses,
        request.constant_bones,
        request.reading,
        request.camera,
        request.ground,
        request.detection != Detection(),
        request.keypoints,
        not request.check,
    )
    if any(others):
        of_keypoints = (
            "overrides, refine, hypotheses, constant_bones, reading, camera, ground, check, keypoints and detectors"
        )
        raise UserError(f"{request.weights.run} lifts masks: {of_keypoints} go with keypoints.")
    options = {**request.options, **request.size, **({} if request.axes is None else {"axes": request.axes})}
    reading = {key: options.pop(key) for key in _READING if key in options}
    for output in request.outputs:
        _check_mesh_output(output, request.page, options)
    refuse_outputs(request.outputs)
    model, trained = load_shapes(request.weights), request.weights.settings()
    if trained is not None:
        reading = {"side": trained.data.side, "format": format_of_run(trained, request.input), **reading}
    data = read_masks(request.input, **reading)
    prediction = model.predict(data.without_truth(), title=request.title)
    notes = tuple(note for note in data.notes if note not in prediction.notes)
    small = small_size({key: options.get(key) for key in ("height_mm", "length_mm")})
    prediction.notes = (*notes, *prediction.notes, *([small] if small else []))
    files: dict[Path, str] = {}
    for output in request.outputs:
        files |= write(prediction, output, request.page, **options)
    return prediction, files


def _check_mesh_output(output: str | Path, page: str | None, options: Mapping[str, Any]) -> None:
    """Refuse an output that cannot be written, before any work."""
    writer, ending = writer_for(output, page, "shapes"), Path(output).suffix.lower()
    for key in options:
        if key in _OF_MESHES and writer.holds == "all":
            raise UserError(f"{key}= goes with the formats of meshes (.glb .obj .ply .stl), not with {output}.")
        if key not in _OF_MESHES and ending != ".html":
            raise UserError(f"{key}= is for a page (.html), not for {ending}.")
    if options.get("smooth", 0) < 0:
        raise UserError(f"smooth={options['smooth']}: expected rounds of smoothing, 0 or more.")
    if options.get("items", 1) < 1:
        raise UserError(f"items={options['items']}: a page shows at least one shape.")


def shape_summary(found: ShapePrediction) -> list[str]:
    """Return what to print about shapes."""
    side = found.resolution
    lines = [*found.notes, f"lifted {len(found):,} masks, {side} x {side} x {side} voxels each"]
    empty = sum(not (grid > found.level).any() for grid in found.occupancy)
    note = f"{empty:,} of {len(found):,} shapes are empty: nothing of them is above the level {found.level:g}"
    return [*lines, note] if empty else lines
