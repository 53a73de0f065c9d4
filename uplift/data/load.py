"""From settings to cleaned `PoseData` in the skeleton's joints: find, read, match, clean, split."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from uplift.config.files import data_root, files_of, shipped_names
from uplift.config.loading import read_task, task_path
from uplift.config.settings import DataSettings, Settings
from uplift.data.clean import MIN_VISIBLE, clean
from uplift.data.concat import concat_poses
from uplift.data.datasets import DATA_SETS, DataSet, WantedFile, data_set, read_cached
from uplift.data.far import without_far
from uplift.data.formats import KEYPOINT_FORMATS, MASK_FORMATS, with_options
from uplift.data.formats.base import ReadOptions, size_of
from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.data.individuals import by_individuals
from uplift.data.joints import in_joints_of
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.data.reading import read_each
from uplift.data.select import choice_of, chosen_rows
from uplift.data.upright import upright_notes
from uplift.errors import MissingFiles, UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.propose import TOO_LONG, stretch_of

__all__ = [
    "Loaded", "cleaned", "find_data", "format_of", "format_of_run", "how_to_get", "in_joints_of", "in_skeleton", "load_data", "load_file", "load_split",
    "named_set", "not_simulated", "of_labelled", "read_files", "read_options", "set_of", "with_labels_of", "with_test",
]  # fmt: skip


@dataclass(frozen=True)
class Loaded:
    """What a fit trains on and is evaluated on, and what was noticed on the way."""

    train: PoseData
    """Its `labelled` says which poses may be learned from."""
    test: PoseData | None
    notes: list[str]
    more: PoseData | None = None
    """Labelled frames of another file, to train on beside them."""

    @property
    def unit(self) -> str:
        """The unit of the poses that training may learn from."""
        return self.train.unit if self.more is None else self.more.unit


def load_data(settings: Settings, skeleton: Skeleton, load: Load[PoseData] | None = None) -> Loaded:
    """Return the training and test frames that ``settings.data`` asks for, or that ``load`` returns.

    Raises UserError: a file that is missing or wrong, other joints, no frames left.
    """

    def load_or_simulate(settings: Settings, which: str) -> PoseData:
        simulated = settings.data.simulate and not (which == "test" and settings.data.test)
        return _simulated(settings, which, skeleton) if simulated else load_split(settings, which, skeleton)

    load = load or load_or_simulate
    train, test = with_test(settings, load)
    train, more = with_labels_of(settings, train, load)
    notes = not_simulated(settings)
    train = cleaned("train", train, skeleton, notes)
    if train.labelled is not None:
        notes.append(f"labelled: {int(train.labelled.sum()):,} of these frames, in 3D")
    more = None if more is None else cleaned("labelled", more, skeleton, notes)
    test = None if test is None else cleaned("test", test, skeleton, notes)
    return Loaded(train, test, notes, more)


def not_simulated(settings: Settings) -> list[str]:
    """Return the note on a task that simulates what it trains on, where the user gives files; nothing otherwise."""
    data = settings.data
    if not data.train or data.simulate or settings.task not in shipped_names("tasks"):
        return []
    simulated = (read_task(task_path(settings.task)).get("data") or {}).get("simulate")
    return [f"data.train is given: what task '{settings.task}' simulates is not used"] if simulated else []


def _simulated(settings: Settings, which: str, skeleton: Skeleton) -> PoseData:
    from uplift.data.synthetic.simulate import simulate

    frames, seed, source = settings.data.simulate, settings.seed, f"simulated {skeleton.name}"
    if which == "test":  # other bodies, motions and cameras than any training seed's
        frames, seed, source = max(200, frames // 10), seed + 2**31, f"{source}, other bodies"
    return replace(simulate(skeleton, frames, seed=seed), source=source)


def cleaned(which: str, data: PoseData, skeleton: Skeleton, notes: list[str]) -> PoseData:
    """Return the cleaned ``train``, ``test`` or ``labelled`` frames, and add to the notes what was found."""
    data, report = clean(data, skeleton)
    notes += [f"{which}: {len(data):,} frames from {data.source}", *(f"{which}: {note}" for note in data.notes)]
    notes += report.lines()
    return data


# Which frames or masks a fit trains on, is evaluated on, and may learn from.

Data = TypeVar("Data", PoseData, MaskData)
Load = Callable[[Settings, str], Data]
"""Returns the ``train`` or ``test`` samples that settings name, read or simulated."""


def _words(data: PoseData | MaskData) -> tuple[str, str, str]:
    """Return what a sample and its truth are called, and how labels come by it."""
    if isinstance(data, MaskData):
        return "mask", "true shapes", "masks with truth (`uplift data render`)"
    return "frame", "'pose'", "frames with poses"


def with_test(settings: Settings, load: Load[Data]) -> tuple[Data, Data | None]:
    """Return the training samples that ``data.select`` leaves, and those of ``data.test`` or ``data.hold_out``.

    Raises UserError: both are set, or nothing is left to train on.
    """
    chosen = settings.data
    train = load(settings, "train")
    test = load(settings, "test") if chosen.test or chosen.simulate else None
    item, _, _ = _words(train)
    held_out = choice_of(chosen.hold_out)
    if held_out:
        if test is not None:
            other = "data.test" if chosen.test else f"data.simulate, which simulates test {item}s too,"
            raise UserError(f"{other} and data.hold_out are both set: the test {item}s come from one of them.")
        rows = chosen_rows(train, held_out, settings.seed)
        if rows.all():
            raise UserError(f"data.hold_out={held_out} leaves no {item} to train on.")
        test, train = train.select(rows), train.select(~rows)
    wanted = choice_of(chosen.select)
    return (train.select(chosen_rows(train, wanted, settings.seed)) if wanted else train), test


def with_labels_of(settings: Settings, train: Data, load: Load[Data]) -> tuple[Data, Data | None]:
    """Return the training samples with `labelled` as ``data.labelled`` says, and the labelled ones of another file.

    With ``data.labelled.only`` the first are the labelled ones alone. The same samples and seed always
    give the same labels.

    Raises UserError: no such samples, or samples without truth.
    """
    chosen = settings.data.labelled
    wanted = choice_of(chosen)
    item, truth, needed = _words(train)
    if not wanted and chosen.file is None:
        if chosen.only:
            hint = "set data.labelled.fraction (1 for all)"
            raise UserError(f"data.labelled.only is on, but no {item} is labelled: {hint}.")
        return train, None
    source = train if chosen.file is None else load(of_labelled(settings), "train")
    if (source.truth if isinstance(source, MaskData) else source.pose) is None:
        raise UserError(f"{source.source}: holds no {truth} to learn from: data.labelled needs {needed}.")
    rows = chosen_rows(source, wanted, settings.seed)
    labelled = replace(source, labelled=rows)
    if chosen.file is None:
        kept = rows | ~chosen_rows(source, {**wanted, "fraction": 1}) if chosen.rest == "leave_out" else rows | True
        return labelled.select(rows if chosen.only else kept), None
    more = labelled.select(rows)
    return (more, None) if chosen.only else (train, more)


def of_labelled(settings: Settings) -> Settings:
    """Return settings whose ``train`` samples are those of ``data.labelled.file``: a file, or SET:SPLIT in the set's own folder."""
    named = str(settings.data.labelled.file)
    use, colon, split = named.partition(":")
    format = format_of(settings.data, named)
    data = replace(settings.data, simulate=0, most=None, use=None, train=named, format=format)
    if colon and use in DATA_SETS:
        data = replace(data, name=use, root=None, use=use, options={}, train=split, unit=None)
    return replace(settings, data=data)


# The frames of a file or of a published set, in the skeleton's joints.


def load_split(settings: Settings, which: str, skeleton: Skeleton) -> PoseData:
    """Return the ``train`` or ``test`` frames of ``settings`` in the skeleton's joints, not cleaned."""
    source = set_of(settings, which)
    if source is None:
        path = find_data(settings, which)
        data = load_file(path, skeleton, read_options(settings.data, path))
    else:
        options = read_options(settings.data)
        for name in options.set_names():
            if name != "min_confidence":
                raise UserError(f"data.{name} goes with files; a published set (data.use) knows its own.")
        data = in_joints_of(read_cached(source, Path(getattr(settings.data, which)).name), skeleton)
        data = with_options(data, options)
    return replace(data, unit=settings.data.unit) if settings.data.unit else data


def set_of(settings: Settings, which: str) -> DataSet | None:
    """Return the published data set that the ``train`` or ``test`` frames are a split of; None where they are a file.

    Raises UserError: no such set, or files of it that are missing, with where they come from.
    """
    found = named_set(settings, which)
    if found is None:
        return None
    source, split = found
    missing = source.missing(split)
    if missing:
        raise MissingFiles(f"{_named(settings, source, missing)}\n{how_to_get(settings, source)}")
    return source


def named_set(settings: Settings, which: str) -> tuple[DataSet, str] | None:
    """Return the published data set of the ``train`` or ``test`` frames and their split, whether its files are there or not.

    Raises UserError: no such set, an option or a split that it does not have.
    """
    chosen = settings.data
    split = getattr(chosen, which)
    if not chosen.use or not split:
        return None
    folder = data_root(chosen.name, chosen.root).absolute()
    source = data_set(chosen.use, folder, chosen.options)
    if Path(split).is_absolute():  # a file in place of the split; a split named on the command line was made a path
        if Path(split).exists() or Path(split).name not in source.splits:
            return None
        split = Path(split).name
    source.check_split(split)
    return source, split


def find_data(settings: Settings, which: str) -> Path:
    """Return the path of the ``train`` or ``test`` file; a UserError that says how to get it where it is not."""
    data = settings.data
    name = getattr(data, which)
    if not name:
        kind, where, demo = "data", "FILE (with skeleton=...)", "demo"
        if settings.lifts == "masks":
            kind, where, demo = "masks", "FOLDER (or FILE)", "masks_demo"
        raise UserError(
            f"No training {kind}: set data.train={where}, or a task that names its own (`uplift tasks`). "
            f"`uplift fit task={demo}` needs no data."
        )
    folder = data_root(data.name, data.root)
    path = (folder / name).absolute()
    if path.exists():
        return path
    several = ",".join(str((folder / part).absolute()) for part in str(name).split(",") if part)
    if not any(sign in several for sign in ",*?["):
        raise MissingFiles(_missing_file(settings, path))
    files_of(several)  # says which is missing
    return Path(several)


def load_file(path: str | Path, skeleton: Skeleton, options: ReadOptions | None = None) -> PoseData:
    """Read keypoint files (one, several with commas, or a pattern) into the joints of ``skeleton``, matched by name.

    Raises UserError: as `in_skeleton`.
    """
    return in_skeleton(*read_files(path, options, skeleton), skeleton)


def in_skeleton(found: Iterable[PoseData], left_out: Sequence[str], skeleton: Skeleton) -> PoseData:
    """Return what was read, file by file, as one in the joints of ``skeleton``; notes begin with those on files ``left_out``.

    Raises UserError: as `in_joints_of`, or files of fewer keypoints than anything can be lifted from.
    """
    parts = []
    for data in found:
        if len(data.joint_names) < MIN_VISIBLE:
            raise UserError(
                f"{data.source}: holds {len(data.joint_names)} keypoints ({', '.join(data.joint_names)}). Nothing can be "
                f"lifted from fewer than {MIN_VISIBLE}: a pose needs a shape."
            )
        data = in_joints_of(data, skeleton)
        stretch = stretch_of(data.keypoints, data.confidence, skeleton)
        if stretch >= TOO_LONG:
            note = (
                f"WARNING: the bones of {skeleton.name} are {stretch:.1f} times as long as the shortest lines that join "
                "its joints: joints seem to have the names of others "
                f"(uplift skeleton map {data.source} skeleton={skeleton.name})"
            )
            data = replace(data, notes=(*data.notes, note))
        parts.append(data)
    joined, lying = concat_poses(parts), upright_notes(parts, skeleton)
    return replace(joined, notes=(*left_out, *joined.notes, *lying)) if left_out or lying else joined


def read_files(
    paths: str | Path | Sequence[str], options: ReadOptions | None, skeleton: Skeleton | None = None
) -> tuple[Iterator[PoseData], list[str]]:
    """Return each keypoint file that ``paths`` mean (one, several with commas, or a pattern), and notes on those left out.

    Each is read as it comes, by its own joints: individuals apart (`uplift.data.individuals`), without keypoints that
    are far from everything else.

    Raises UserError: no such file, and as `uplift.data.formats.read`.
    """
    words = [paths] if isinstance(paths, str | Path) else paths
    files, left_out = keypoint_files(list(dict.fromkeys(one for word in words for one in files_of(word))))
    return (without_far(by_individuals(part, skeleton)) for part in read_each(files, options)), left_out


def format_of(data: DataSettings, path: str | Path) -> str | None:
    """Return the format of a file of the settings, None where it is guessed.

    A user's own format is that of all files but of this project's npz beside others: truth to test on comes in these.
    """
    npz = [str(name or "").lower().endswith(".npz") for name in (path, data.train)]
    return None if _is_own(data.format) and npz == [True, False] else data.format


def format_of_run(settings: Settings, path: str | Path) -> str | None:
    """Return the format in which a run reads a file or folder that its settings do not name, None where it is guessed.

    That is a user's own where a file ends as the format says, or as what the run was trained on where it says nothing.
    """
    data, path = settings.data, Path(path)
    if not _is_own(data.format):
        return None
    ending = ""
    with suppress(UserError):  # a class that is gone is not needed for other files
        formats = MASK_FORMATS if settings.lifts == "masks" else KEYPOINT_FORMATS
        ending = formats.named(str(data.format)).ending
    if ending:
        names = [one.name for one in path.iterdir()] if path.is_dir() else [path.name]
        return data.format if any(name.lower().endswith(ending) for name in names) else None
    found, trained = ("" if one.is_dir() else one.suffix.lower() for one in (path, Path(str(data.train))))
    return data.format if found == trained else None


def _is_own(format: str | None) -> bool:
    return format is not None and ":" in format


def read_options(data: DataSettings, path: str | Path | None = None) -> ReadOptions:
    """Return how the settings want files, or this one, read; raises UserError for an invalid image size or number."""
    size = None if data.image_size is None else size_of(data.image_size, "data.image_size")
    format = data.format if path is None else format_of(data, path)
    return ReadOptions(
        format=format, layout=data.layout, image_size=size, fps=data.fps, focal_px=data.focal_px,
        min_confidence=data.min_confidence, flip_x=data.flip_x, flip_y=data.flip_y, rotate=data.rotate,
    )  # fmt: skip


# Messages for missing files: what is missing, how to get it, where to put it, what runs without.

_MOST_NAMED = 6


def _missing_file(settings: Settings, path: Path) -> str:
    first = f"No file {path}" + (f", which task '{settings.task}' needs." if settings.task else ".")
    return "\n".join([first, *_get(settings.data), *_places(settings.data, "it"), *_instead(settings)])


def how_to_get(settings: Settings, source: DataSet | None) -> str:
    """Return where missing files come from, where to put them, and what runs without them."""
    origin = [source.about.strip()] if source is not None and source.about.strip() else _get(settings.data)
    return "\n".join([*origin, *_places(settings.data, "them"), *_instead(settings)])


def _named(settings: Settings, source: DataSet, missing: Sequence[WantedFile]) -> str:
    needed = f", which task '{settings.task}' needs" if settings.task else ""
    count = f"{len(missing)} file is" if len(missing) == 1 else f"{len(missing)} files are"
    shown = missing[:_MOST_NAMED]
    names = [str(file.path).removeprefix(f"{source.folder}{os.sep}") for file in shown]
    wide = max(map(len, names))
    lines = [f"{source.title or type(source).__name__}{needed}: {count} not in {source.folder}"]
    lines += [f"  {name:<{wide}}  {file.what}" for name, file in zip(names, shown, strict=True)]
    return "\n".join(lines + [f"  and {len(missing) - len(shown)} more"] * (len(missing) > len(shown)))


def _get(data: DataSettings) -> list[str]:
    return [f"Get it: {data.get.strip()}"] if data.get else []


def _places(data: DataSettings, what: str) -> list[str]:
    if not data.name or Path(data.name).is_absolute():
        return []
    other = f"data.root=FOLDER (or UPLIFT_DATA=FOLDER, with a subfolder {data.name}/)"
    return [f"Put {what} there, or name another folder: {other}."]


def _instead(settings: Settings) -> list[str]:
    if settings.lifts == "masks":
        return ["Without: `uplift fit task=masks_demo` needs no data."]
    free = "" if settings.data.name == "cmu" else "`uplift fit task=semi_cmu` runs on open data, "
    return [f"Without: {free}`uplift fit task=demo` {'on none' if free else 'needs no data'}."]
