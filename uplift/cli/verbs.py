"""What each verb takes: the words and the ``key=value`` settings that parsing, `--help`, completion and docs share."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Optional

from uplift.config.device import ACCELERATORS
from uplift.config.settings import MAX_SIDE, MIN_SIDE, Setting, all_settings

__all__ = [
    "CAMERA_KEYS",
    "DETECT",
    "DETECTOR_KEYS",
    "EVALUATE",
    "NEEDED",
    "NWB_KEYS",
    "POSE_KEYS",
    "PREDICT",
    "READ_KEYS",
    "REFINE",
    "SHAPE_KEYS",
    "SIMULATE",
    "VERBS",
    "Verb",
    "sub_verbs",
]  # fmt: skip

NEEDED: Any = type("Needed", (), {"__repr__": lambda self: "needed"})()
"""The default of a setting that must be given."""

Table = dict[str, Setting]


class Verb(NamedTuple):
    """A verb of the command line, or one of the actions of ``data`` and ``skeleton``."""

    about: str
    """One line."""
    usage: tuple[str, ...]
    """Its forms, without ``uplift``."""
    words: Mapping[str, str] = MappingProxyType({})
    """What its plain words are."""
    settings: Mapping[str, Setting] = MappingProxyType({})
    notes: tuple[str, ...] = ()
    """Paragraphs below the settings."""


def _table(*settings: Setting) -> Table:
    return {one.name: one for one in settings}


def _key(name: str, kind: Any, default: Any, help: str, low: Any = None, high: Any = None, **more: Any) -> Setting:
    return Setting(name, kind, default, help, low, high, more.get("choices", ()), more.get("only"))


def _of_fit(name: str, **changed: Any) -> Setting:
    """Return a setting of `uplift fit` below ``data.`` as a setting of a verb."""
    return all_settings()[f"data.{name}"]._replace(name=name, only=None)._replace(**changed)


_SEED_LIMITS = (0, 2**31 - 1)
_MOST_ITEMS = 10**8

_TRUST = _table(
    _key(
        "trust",
        list[str],
        [],
        "code that may run where a file names it: my_priors.py, or my_package.nets; several with commas",
    )
)
"""What any command takes that opens a task, a run or a lifter; what words of the command name needs none."""

# Reading files of keypoints: the fields of `uplift.data.formats.base.ReadOptions`.

READ_KEYS = _table(
    *map(_of_fit, ("format", "layout", "image_size", "fps", "focal_px", "min_confidence", "flip_x", "flip_y", "rotate"))
)
"""What any command that reads keypoints takes."""

DETECTOR_KEYS = _table(
    _key("detector", Optional[str], None, "what finds keypoints in videos and pictures: mediapipe (bodies), mediapipe_hand, or a "
         "class of yours, my.py:MyDetector; unset: the built-in that finds the skeleton's joints"),
    _key("detector.options", dict[str, Any], {}, "options of that class"),
    _key("people", Optional[int], None, "at most so many people or animals, the largest and longest in the picture; unset: all", 1, 1000),
    _key("video.start_s", Optional[float], None, "where to begin in a video, seconds from its beginning", 0, 1e7),
    _key("video.end_s", Optional[float], None, "where to stop; of a camera, how long it is watched", 1e-3, 1e7),
)  # fmt: skip
"""How keypoints are found in videos and pictures."""

CAMERA_KEYS = _table(
    _key("camera.tilt_deg", Optional[float], None, "how far the camera looks down, where known; unset: estimated", -90, 90),
    _key("camera.roll_deg", Optional[float], None, "how far up leans to the right in the image, where known; unset: "
         "estimated", -180, 180),
)  # fmt: skip
"""How the camera stands, in place of estimates."""

NWB_KEYS = _table(
    *(
        _key(f"nwb.{name}", Optional[str], None, f"of an .nwb: {help}")
        for name, help in {
            "session_start_time": "when filming began, 2026-05-01T10:30:00+02:00",
            "session_description": "what was done",
            "identifier": "name of the file among all others; unset: the input's, with a digest of the poses",
            "experimenter": "who filmed, Curie, Marie",
            "institution": "where",
            "lab": "in which laboratory",
            "subject_id": "who is filmed; unset: the track's name",
            "species": "its Latin name, Mus musculus",
            "sex": "M, F, U (unknown) or O (other); unset: U",
            "age": "ISO 8601, P90D are 90 days",
        }.items()
    )
)
"""What is known of the session and the subject of an .nwb."""

_CSV_SAFE = _key(
    "csv_safe", bool, False, "put an apostrophe before names in a .csv that a spreadsheet would run as formulas"
)

REFINE = {"on": True, "off": False, "causal": "causal"}
"""Values of ``refine=``, as arguments in Python."""

# predict: what goes with every run, with keypoints alone, with masks alone.

_ALL_KEYS = _table(
    _key("run", str, NEEDED, "run folder, a lifter's file (.pt, .safetensors), or a ready lifter (uplift lifters)"),
    _key("input", str, NEEDED, "file or folder of keypoints, a video, pictures, several with commas or *, or SET:SPLIT of a "
         "published set"),
    _key("output", str, NEEDED, "new file, several with commas; the ending is the format: .html .npz .csv .bvh .glb .nwb ...; "
         "angles.csv, .mot: joint angles, gait.csv: gait; FOLDER/ or FOLDER/*.csv: one for each input; or live: a page of this "
         "machine that shows a camera's poses as they come"),
    _key("page", Optional[str], None, "kind of an .html; unset: viewer", choices=("viewer", "gallery")),
    _key("axes", Optional[str], None, "axes of the output; unset: the format's usual ones",
         choices=("camera", "level", "opencv", "blender", "opensim", "unity", "own", "gltf", "print")),
    _key("height_mm", Optional[float], None, "height of each body or object, millimetres", 1e-9, 1e9),
    _key("images", Optional[str], None, "folder of photos that a page shows beside the results"),
    _key("together", Optional[str], None, "keypoints: true solves the files, or the cameras of a file, as views of one "
         "scene; masks: true puts all shapes side by side in one .glb, unset: up to 16", choices=("true", "false")),
    _of_fit("format"),
    _key("workers", Optional[int], None, "with output=FOLDER/: inputs that are lifted at a time, each in a process; unset: as many as "
         "cores", 1, 1000),
)  # fmt: skip
POSE_KEYS = _table(
    _key("refine", str, "on", "lift the frames of a clip together; off: each on its own; causal: with those up to half a "
         "second later, as live use can", choices=tuple(REFINE)),
    _key("accelerator", str, "auto", "what computes; auto: a CUDA device where there is one, else the processor",
         choices=ACCELERATORS),
    _key("hypotheses", int, 0, "poses of each frame that are likely, with their probabilities, into an .npz", 0, 64),
    _key("bones", str, "free", "constant: bones of one length over a clip", choices=("free", "constant")),
    _key("bone", list[str], [], "joints along a known length, with bone_mm=: rhip,rknee"),
    _key("bone_mm", Optional[float], None, "that length, millimetres", 1e-9, 1e9),
    _key("camera_height_mm", Optional[float], None, "height of the camera above the ground, millimetres", 1e-9, 1e9),
    *DETECTOR_KEYS.values(),
    _key("keypoints", Optional[str], None, "with a video or pictures: new .npz or .csv file for the 2D"),
    _key("video", Optional[str], None, "video or folder of pictures that the keypoints were found in, shown behind them on a page or "
         "in a film; several with commas, named as the clips; unset: the input, where that is one"),
    _key("port", int, 0, "with output=live: port of its page; 0: any that is free", 0, 65535),
    *CAMERA_KEYS.values(),
    _key("ground", bool, False, "true: find the ground, and keep standing feet where they are; needs a size"),
    _key("cameras", Optional[str], None, "with together=true: calibrated cameras, .toml of Pose2Sim or Anipose, or .json"),
    _key("cameras_unit", Optional[str], None, "unit of the places in it; unset: told from the file", choices=("mm", "m")),
    _key("cameras_output", Optional[str], None, "with together=true: new .toml file for the cameras that are found"),
    *(one for name, one in READ_KEYS.items() if name != "format"),
    _key("part_frames", Optional[int], None, "frames that are lifted at a time, where there are more; 0: all at once; unset: inputs of "
         "more than 200,000 frames in parts of 50,000", 0, 10**9),
    _key("check", bool, True, "false: a ready lifter lifts what does not look like the body that it knows, too"),
    *NWB_KEYS.values(),
    _key("frames", int, 40, "frames that page=gallery shows", 1, 500),
    _key("seed", int, 0, "seed of the choice of those frames", *_SEED_LIMITS),
    _CSV_SAFE,
    _key("mass_kg", Optional[float], None, "with output=FILE.osim: mass of each body, kilograms; unset: 70", 1e-9, 1e6),
    *(all_settings()[f"data.{name}"] for name in ("name", "root", "options")),
)  # fmt: skip
"""What predict takes for keypoints alone."""
POSE_KEYS = {name: one._replace(only="keypoints") for name, one in POSE_KEYS.items()}
SHAPE_KEYS = _table(
    *map(_of_fit, ("border", "pieces", "category", "most")),
    _key("unit", Optional[str], None, "unit of meshes: px of the photo, crop (half a mask's side), or mm, with a size; "
         "unset: px, or mm with a size", choices=("px", "mm", "crop")),
    _key("length_mm", Optional[float], None, "length of the longest side of each object, millimetres", 1e-9, 1e9),
    _key("smooth", int, 4, "rounds of smoothing of meshes, which keep the volume", 0, 10_000),
    _key("texture", Optional[str], None, "false: meshes without the photos that the masks name; true: it is an error where there are none; unset: "
         "with those that are found", choices=("true", "false")),
    _key("items", Optional[int], None, "shapes at most that a page shows", 1, _MOST_ITEMS),
    _key("group", Optional[str], None, "masks that are views of one object and get one shape: all of them, those of a folder, or "
         "those whose name is the same up to its last number (cow_001.png, cow_002.png); unset: each mask is lifted alone",
         choices=("all", "folder", "name")),
    _key("refine_steps", Optional[int], None, "steps in which code and view of each mask are refined; unset: shape.refine of the run; 0: as the "
         "network says at once", 0, 10_000),
    _key("front", Optional[float], None, "azimuth, degrees, at which this lifter sees objects from their front; unset: 0. Masks do "
         "not say which side that is: 180 where shapes look backwards", -360, 360),
)  # fmt: skip
"""What predict takes for masks alone."""
SHAPE_KEYS = {name: one._replace(only="masks") for name, one in SHAPE_KEYS.items()}
PREDICT = _ALL_KEYS | _TRUST | POSE_KEYS | SHAPE_KEYS

EVALUATE = _table(
    _key("run", Optional[str], None, "run folder to evaluate, or a ready lifter or lifter's file, with data.test="),
    _key("poses", Optional[str], None, "in place of a run: poses from a file, such as predict writes"),
    _key("data.test", Optional[str], None, "file with the truth; unset: the test data of the run"),
    _key("skeleton", Optional[str], None, "skeleton of poses=; unset: the shipped one whose joints those are"),
    POSE_KEYS["refine"],
    POSE_KEYS["accelerator"],
    _key(
        "hypotheses",
        int,
        0,
        "whole poses of each frame whose errors and probabilities are judged; 0: none",
        0,
        100,
        only="keypoints",
    ),
    *(POSE_KEYS[name] for name in CAMERA_KEYS),
    _key("items", int, 100, "masks at most that are scored", 1, _MOST_ITEMS, only="masks"),
    _key("evaluation", Optional[str], None, "name that the evaluation is kept under in the run; unset: date and time"),
    *_TRUST.values(),
)
_COMPARE = _table(
    _key("evaluation", list[str], [], "name of the evaluation, or one for each run with commas; unset: the newest"),
    _key("data.test", Optional[str], None, "the newest evaluation on this file, in place of the newest of all"),
    *_TRUST.values(),
)
SIMULATE = _table(
    _key("skeleton", str, NEEDED, "a shipped name, or a YAML file; it must say how the body is built"),
    _key("output", str, NEEDED, "new file: .npz with the true poses, .csv with the 2D alone; or new folder: shards with the true "
         "poses, for any number of frames"),
    _key("frames", int, 20000, "frames", 1, 10**10),
    _key("seed", int, 0, "seed of everything random", *_SEED_LIMITS),
    _key("clip_seconds", float, 3.0, "length of a clip, seconds", 1e-9, 1e9),
    _key("noise_px", float, 0.0, "noise of the keypoints, standard deviation in pixels", 0, 1e9),
    _key("missing", float, 0.0, "share of joints left out", 0, 0.99),
    _key("tracker", Optional[str], None, "write the .csv as this tracker does, a file for each clip",
         choices=("deeplabcut",)),
    _CSV_SAFE,
)  # fmt: skip

DETECT = _table(
    _key("input", str, NEEDED, "a video, a picture or a folder of them, several with commas or *"),
    _key("output", str, NEEDED, "new .npz or .csv file"),
    *DETECTOR_KEYS.values(),
    _key(
        "skeleton",
        Optional[str],
        None,
        "a shipped name, or a YAML file: its joints are looked for; all that the detector finds are written",
    ),
    *(READ_KEYS[name] for name in ("fps", "focal_px", "min_confidence")),
    _CSV_SAFE,
)

# data cmu, data render.

_CMU = _table(
    _key("output", str, NEEDED, "folder that gets train.npz and test.npz; neither may exist"),
    _key("fps", float, 10.0, "frames per second that are kept; must divide the capture rate", 1e-9, 1000),
    _key("cameras", int, 4, "fixed cameras around each motion", 1, 100),
    _key("tilt", float, 8.0, "how far down they look, mean in degrees", -60, 60),
    _key("tilt_sd", float, 2.0, "standard deviation of that", 0, 30),
    _key("distance", float, 5.0, "metres to the middle of the motion, give or take a tenth; more where the subject "
         "would leave the image", 1, 1000),
    _key("focal_px", float, 1145.0, "focal length, pixels", 1e-9, 1e6),
    _key("image_size", str, "1000x1000", "width and height of the images, pixels"),
    _key("seed", int, 0, "seed of the cameras and of the test subjects", *_SEED_LIMITS),
    _key("test", list[str], [], "subjects or motions of the test file, S5,35_01; empty: drawn, 15 % of the frames"),
    _key("index", Optional[str], None, "file with lines of a motion, a tab and what it is; unset: found by its name"),
    _key("rate", list[str], ["120"], "frames per second of .amc files, and of subjects or motions: 120,S60:60"),
    _key("skip", list[str], [], "subjects or motions to leave out"),
    _key("unit_mm", Optional[float], None, "millimetres in the files' unit of length; unset: told from the files",
         1e-9, 1e9),
)  # fmt: skip
_RENDER = _table(
    _key("output", str, NEEDED, "new .npz file, or new folder: a .png for each mask, and truth.npz"),
    _key("items", int, 2000, "how many masks", 1, _MOST_ITEMS),
    _key("views", int, 1, "masks of each shape, one after the other", 1, _MOST_ITEMS),
    _key("side", int, 64, "pixels along a mask", MIN_SIDE, MAX_SIDE),
    _key("seed", int, 0, "seed of everything random", *_SEED_LIMITS),
    _key("azimuth_deg", tuple[float, float], (-180.0, 180.0), "from,to: degrees that the object is turned about "
         "gravity, uniform; 0 faces the camera", -360, 360),
    _key("elevation_deg", tuple[float, float], (15.0, 10.0), "mean,spread: degrees that cameras look down; normal, cut "
         "off at -10 and 60 or at twice the spread, whichever is wider", (-90, 0), (90, 90)),
    _key("distance", tuple[float, float], (4.0, 8.0), "from,to: distance of the camera, uniform; a shape's longest "
         "side is 1.8; inf,inf for parallel rays", 2, float("inf")),
    _key("upright", str, "true", "false: uniform over all rotations, for what has no up", choices=("true", "false")),
    _key("category", Optional[str], None, "name of the kind of all masks, in place of each file's"),
    _key("poses", int, 20, "files with animations: moments drawn from each; 0: the pose it has at rest", 0, 100_000),
    _key("animations", list[str], [], "files with animations: parts of the names of those to draw from, Walk,Gallop; "
         "with a minus those to leave out, -Death; empty: all"),
    _key("up", str, "y", "axis of the files that points up", choices=("x", "y", "z", "-x", "-y", "-z")),
    _key("front", Optional[str], None, "axis of the files the object looks along; unset: z, or -y where up is z or -z",
         choices=("x", "y", "z", "-x", "-y", "-z")),
)  # fmt: skip

_SHARD = _table(
    _key("output", str, NEEDED, "new folder"),
    _key("dtype", str, "float32", "float16 halves the folder; joints are off by a 2048th of the body's size at most",
         choices=("float32", "float16")),
    _key("frames", int, 250_000, "frames of a shard at most, where no clip is longer", 1, _MOST_ITEMS),
    _key("skeleton", Optional[str], None, "a shipped name, or a YAML file, whose joints are kept; unset: those of the files, "
         "which must be the same"),
    _key("workers", Optional[int], None, "processes that read files; unset: one for each core, where files are many", 1, 1024),
    *READ_KEYS.values(),
    *(all_settings()[f"data.{name}"]._replace(only=None) for name in ("name", "root", "options")),
    *_TRUST.values(),
)  # fmt: skip

# fit, and the verbs themselves.

_FIT_WORDS = _table(
    all_settings()["task"]._replace(help="a shipped task or a YAML file; uplift tasks lists them"),
    _key(
        "resume",
        Optional[str],
        None,
        "folder of a fit or a sweep that was stopped: it goes on; takes no other settings",
    ),
    *_TRUST.values(),
)
_FIT = _FIT_WORDS | {name: one for name, one in all_settings().items() if name != "task"}

VERBS = {
    "fit": Verb(
        "train a lifter of keypoints or masks",
        ("fit task=NAME [key=value ...]", "fit skeleton=NAME data.train=FILE", "fit task=masks data.train=FOLDER",
         "fit task=NAME seed=0..15 SETTING=a,b,c", "fit resume=RUN"),
        settings=_FIT,
    ),
    "evaluate": Verb(
        "every metric of a run, or of poses from a file",
        ("evaluate run=RUN [data.test=FILE]", "evaluate poses=FILE data.test=FILE"),
        settings=EVALUATE,
    ),
    "predict": Verb(
        "lift keypoints or masks to 3D",
        ("predict run=RUN input=FILE output=FILE.html|.npz|.csv|.glb|...", "predict run=RUN input=VIDEO output=..."),
        settings=PREDICT,
    ),
    "detect": Verb(
        "keypoints of a video or pictures",
        ("detect input=VIDEO output=FILE.npz|.csv [detector=NAME]",),
        settings=DETECT,
    ),
    "detectors": Verb(
        "the built-in detectors, and whether their networks are there",
        ("detectors", "detectors get NAME"),
        {"NAME": "a built-in whose networks are fetched, once: later commands need no network"},
    ),
    "simulate": Verb(
        "simulated bodies with exact poses",
        ("simulate skeleton=NAME output=FILE.npz|.csv|FOLDER",),
        settings=SIMULATE,
    ),
    "compare": Verb(
        "evaluated runs side by side",
        ("compare RUN RUN ... [data.test=FILE]", "compare RUN RUN ... evaluation=NAME"),
        {"RUN": "run folder with an evaluation; two or more"},
        _COMPARE,
    ),
    "tables": Verb(
        "the tables of Kudo et al. 2018, published rows and your own fits",
        ("tables [TABLE ...] [task=NAME] [key=value ...]", "tables run=RUN", "tables show=true"),
        {"TABLE": "table1, table2 (Human3.6M) or 3dhp (MPI-INF-3DHP); without any: all"},
        _table(
            _key("task", list[str], [], "tasks to fit in place of the table's"),
            _key("run", list[str], [], "finished runs to use as they are, in place of fitting"),
            _key("seeds", list[int], [0, 1, 2], "a fit for each seed", *_SEED_LIMITS),
            _key("show", bool, False, "published rows and stored results alone; nothing is fitted"),
            _key("markdown", bool, False, "tables in Markdown"),
            *_TRUST.values(),
        ),
        ("Any setting of `uplift fit` holds for all fits: data.root=FOLDER, trainer.max_time=00:30:00.",),
    ),
    "data check": Verb(
        "which data a task needs, and what of it is there",
        ("data check task=NAME [key=value ...]",),
        settings={name: one for name, one in _FIT.items() if name != "resume"},
    ),
    "data cmu": Verb(
        "training and test data from CMU's motion capture files",
        ("data cmu FOLDER output=FOLDER",),
        {"FOLDER": "folder with .asf, .amc or .bvh files"},
        _CMU,
    ),
    "data render": Verb(
        "masks of meshes or of simulated shapes, with the shapes",
        ("data render MESHES ... output=FILE.npz|FOLDER",),
        {"MESHES": "files of meshes, folders of them, or one family of simulated shapes such as chairs"},
        _RENDER,
    ),
    "data shard": Verb(
        "keypoints of many files as one folder, read bit by bit",
        ("data shard FILES ... output=FOLDER",),
        {"FILES": "files or folders of keypoints in any format, patterns with *, splits of published sets as SET:SPLIT, or shards"},
        _SHARD,
    ),
    "tasks": Verb("the shipped tasks, and whether their data is there", ("tasks",)),
    "skeletons": Verb("the shipped skeletons", ("skeletons",)),
    "lifters": Verb(
        "the ready lifters, or the model card of one",
        ("lifters", "lifters NAME"),
        {"NAME": "a ready lifter, which run= takes"},
    ),
    "skeleton check": Verb(
        "check a skeleton and draw it",
        ("skeleton check FILE|NAME [output=FILE.png]",),
        {"FILE": "skeleton as YAML, or a shipped name"},
        _table(_key("output", Optional[str], None, "new .png; unset: named after the skeleton")),
    ),
    "skeleton new": Verb(
        "start a skeleton of your own, or propose one from a tracker's file",
        ("skeleton new FILE", "skeleton new FILE --from TRACKER_FILE"),
        {"FILE": "new YAML file"},
        _table(
            _key("from", Optional[str], None, "file or folder of a tracker, several with commas or *, whose joints it is proposed "
                 "for; also --from FILE"),
            _key("root", Optional[str], None, "joint that is the root; unset: guessed"),
            _key("gravity", str, "yes", "whether the thing stands upright", choices=("yes", "no", "true", "false")),
        ) | READ_KEYS,
    ),
    "skeleton map": Verb(
        "which joint of a tracker's file goes where in a skeleton",
        ("skeleton map TRACKER_FILE skeleton=NAME",),
        {"TRACKER_FILE": "file or folder of keypoints in any format that is read, several with commas or *"},
        _table(_key("skeleton", str, NEEDED, "a shipped name, or a YAML file")) | READ_KEYS,
    ),
    "schema task": Verb(
        "write the JSON schema of task files, for editors",
        ("schema task [output=FILE.json]",),
        settings=_table(_key("output", str, "task.schema.json", "new .json file")),
    ),
    "schema skeleton": Verb(
        "write the JSON schema of skeleton files, for editors",
        ("schema skeleton [output=FILE.json]",),
        settings=_table(_key("output", str, "skeleton.schema.json", "new .json file")),
    ),
}  # fmt: skip
"""Every verb by its name; those of two words share the first."""


def sub_verbs(verb: str) -> dict[str, Verb]:
    """Return the actions of ``data`` and ``skeleton`` by their own name; none for other verbs."""
    return {name.partition(" ")[2]: one for name, one in VERBS.items() if name.startswith(f"{verb} ")}
