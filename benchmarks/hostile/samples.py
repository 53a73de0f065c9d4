"""Small valid files of every kind that a command reads, and the commands that read them."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from benchmarks.reading.bodies import Walk
from benchmarks.reading.cells import CELLS

sys.path.append(str(ROOT / "tests" / "helpers"))  # the tests know how others write their files

__all__ = ["Sample", "make_samples", "word_lists"]

QUICK = (
    "lifter.options.units=8", "lifter.options.blocks=1", "priors.critic.units=8", "priors.critic.blocks=1",
    "priors.flow.steps=2", "priors.flow.units=8", "teacher.batch_size=8", "student.batch_size=8", "student.rounds=1",
    "student.refine.iterations=1", "trainer.max_time=null", "trainer.max_steps=2", "trainer.threads=1",
)  # fmt: skip
SHAPES = (
    "task=masks_demo", "data.family=chairs", "data.side=16", "shape.detail=12", "shape.crop=12", "shape.parts=1", "shape.splits=",
    "shape.resolution=12", "trainer.max_time=null", "trainer.max_steps=2", "trainer.threads=1", "teacher.batch_size=8",
)  # fmt: skip
_POSES = (".npz", ".csv", ".json", ".html", ".bvh", ".glb", ".trc", ".c3d", ".gif")
_MESHES = (".npz", ".html", ".glb", ".obj", ".stl", ".ply")


@dataclass(frozen=True)
class Sample:
    """A file or folder to damage, and commands in which ``{}`` stands for it."""

    name: str
    path: Path
    commands: tuple[tuple[str, ...], ...]
    inside: str = ""
    """What of the folder is damaged; all of it if empty."""


def _keypoint_commands() -> tuple[tuple[str, ...], ...]:
    found = [("predict", "run=RUN", "input={}", f"output=out{ending}") for ending in _POSES]
    found.append(("predict", "run=RUN", "input={}", "output=out.html", "page=gallery"))
    maps = ("skeleton", "map", "{}", "skeleton=h36m17")
    found += [maps, maps, ("skeleton", "map", "{}", "skeleton=coco17"), ("skeleton", "new", "new.yaml", "from={}")]
    return (
        *found,
        ("fit", "skeleton=h36m17", "data.train={}", *QUICK),
        ("data", "check", "skeleton=h36m17", "data.train={}"),
    )


def _keypoints(folder: Path) -> Iterator[Sample]:
    commands = _keypoint_commands()
    for cell in CELLS:
        path = folder / cell.file
        if not path.exists():
            cell.make(path, Walk(12 * cell.bodies, cell.joints, cell.bodies))
        yield Sample(cell.name, path, commands)
    from bodies import write_body

    truth = folder / "body.npz"
    if not truth.exists():
        write_body(truth, 20)
    evaluate = (
        ("evaluate", "poses={}", f"data.test={truth}"),
        ("evaluate", f"poses={truth}", "data.test={}"),
        ("evaluate", "run=RUN", "data.test={}"),
    )
    yield Sample("body", truth, (*commands, *evaluate, *evaluate))


def _masks(folder: Path) -> Iterator[Sample]:
    from mask_files import blob, coco_file, runs_of, save, text_of_counts

    from uplift.data.formats.masks_npz import write_masks_npz
    from uplift.data.synthetic.masks import simulate_masks

    commands = (*(("predict", "run=SHAPES", "input={}", f"output=out{ending}") for ending in _MESHES), ("fit", *SHAPES, "data.simulate=0", "data.train={}"),
                ("data", "check", "task=masks", "data.train={}"))  # fmt: skip
    evaluate = ("evaluate", "run=SHAPES", "data.test={}", "items=1")
    npz, pictures, coco = folder / "masks.npz", folder / "masks", folder / "masks.json"
    if not npz.exists():
        write_masks_npz(simulate_masks("chairs", 4, seed=0, side=16), npz)
        for number in range(2):
            save(pictures / f"cow/{number}.png", (255 * blob(seed=number)).astype(np.uint8))
        save(folder / "one.png", (255 * blob(seed=3)).astype(np.uint8))
        runs = runs_of(blob())
        rings = [[20.0, 10.0, 60.0, 10.0, 60.0, 50.0, 20.0, 50.0]]
        rle = {"size": [60, 80], "counts": text_of_counts(runs)}
        coco_file(coco, [{"size": [60, 80], "counts": runs}, rle, rings])
    yield Sample("masks npz", npz, (*commands, evaluate))
    yield Sample("masks folder", pictures, commands)
    yield Sample("masks picture", folder / "one.png", commands)
    yield Sample("masks coco", coco, commands)


def _yaml(folder: Path) -> Iterator[Sample]:
    body = folder / "body.npz"
    checks = (("skeleton", "check", "{}", "output=out.png"), ("skeleton", "map", str(body), "skeleton={}"),
              ("simulate", "skeleton={}", "output=out.npz", "frames=4"), ("fit", "skeleton={}", f"data.train={body}", *QUICK),
              ("evaluate", f"poses={body}", f"data.test={body}", "skeleton={}"))  # fmt: skip
    for name in ("h36m17", "hand21", "car12", "mediapipe33"):
        path = folder / f"{name}.yaml"
        if not path.exists():
            shutil.copy(ROOT / "skeletons" / path.name, path)
        yield Sample(f"skeleton {name}", path, checks)
    for name in ("default", "cmu", "semi_h36m", "kudo2018_code", "masks"):
        path = folder / f"task_{name}.yaml"
        if not path.exists():
            shutil.copy(ROOT / "tasks" / f"{name}.yaml", path)
        steps = ("trainer.max_time=null", "trainer.max_steps=2", "trainer.threads=1")
        more = (
            ("skeleton=h36m17", f"data.train={body}")
            if name not in ("masks",)
            else (f"data.train={folder / 'masks.npz'}", "shape.parts=1", "shape.splits=")
        )
        yield Sample(
            f"task {name}",
            path,
            (
                ("data", "check", "task={}"),
                ("data", "check", "task={}", *more),
                ("fit", "task={}", "data.name=", "data.use=null", *more, *steps),
            ),
        )


def _three_d(folder: Path) -> Iterator[Sample]:
    from gltf_files import animate, arm, plain
    from mocap_files import motion, write_amc, write_asf, write_bvh

    render = (("data", "render", "{}", "output=out.npz", "items=2", "side=16", "poses=2"),)
    texts = {
        "a.obj": "o a\nv 0 0 0\nv 1 0 0\nv 0 2 0.5\nv 0 0 1\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1 2 4\nf 1 3 4\nf 2 3 4\n",
        "a.off": "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n",
        "a.ply": "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 4\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n",
    }
    folder.joinpath("mesh").mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / "mesh" / name).write_text(text)
    import trimesh

    box = trimesh.creation.box()
    box.export(folder / "mesh" / "box.stl")
    box.export(folder / "mesh" / "box.ply")
    plain().write(folder / "mesh" / "plain.glb")
    animate(arm(), 2, "rotation", [0.0, 1.0], [[0, 0, 0, 1], [0, 0, 2**-0.5, 2**-0.5]]).write(
        folder / "mesh" / "arm.glb"
    )
    for path in sorted((folder / "mesh").iterdir()):
        yield Sample(f"mesh {path.name}", path, render)
    yield Sample("meshes", folder / "mesh", render)
    mocap = folder / "mocap"
    if not mocap.exists():
        mocap.mkdir()
        write_asf(mocap / "01.asf")
        for number in (1, 2):
            write_amc(mocap / f"01_{number:02}.amc", motion(24, number))
        write_bvh(mocap / "02_01.bvh", motion(24, 3))
    cmu = ("data", "cmu", "{}", "output=out", "cameras=1", "fps=60")
    yield Sample("motion capture", mocap, (cmu, cmu, (*cmu, "test=01")))
    yield Sample("bvh", mocap / "02_01.bvh", (cmu,))


def _sets(folder: Path) -> Iterator[Sample]:
    """Files of published data sets."""
    from h36m_files import world, write_cdf, write_martinez, write_pickles, write_videopose3d
    from mpi_inf_3dhp_files import write_test, write_train
    from tracker_files_json import coco_annotations, mpii, people, write_json

    poses = {subject: dict(list(of.items())[:1]) for subject, of in world(6).items()}
    makers: dict[str, tuple[str, str, Callable[[Path], object]]] = {
        "h36m videopose3d": ("h36m", "train", lambda place: write_videopose3d(place, poses=poses)),
        "h36m pickles": ("h36m", "train", lambda place: write_pickles(place, poses)),
        "h36m martinez": ("h36m", "train", lambda place: write_martinez(place, poses)),
        "h36m cdf": ("h36m", "train", lambda place: write_cdf(place, poses)),
        "3dhp": ("mpi_inf_3dhp", "train", lambda place: write_train(place, "S1", 6)),
        "3dhp modern": ("mpi_inf_3dhp", "train", lambda place: write_train(place, "S1", 6, modern=True)),
        "3dhp test": ("mpi_inf_3dhp", "test", lambda place: [write_test(place, number, 6) for number in range(1, 7)]),
        "mpii": ("mpii", "train", lambda place: write_json(place / "train.json", mpii(people(3, 16)))),
        "coco": (
            "coco",
            "train",
            lambda place: write_json(place / "person_keypoints_train2017.json", coco_annotations(people(3, 17))),
        ),
    }
    for name, (use, split, make) in makers.items():
        place = folder / "sets" / name.replace(" ", "_")
        if not place.exists():
            place.mkdir(parents=True)
            make(place)
        words = (f"data.use={use}", "data.root={}", f"data.train={split}")
        skeleton = {"mpii": "mpii16", "coco": "coco17", "mpi_inf_3dhp": "mpi_inf_3dhp17"}.get(use, "h36m17")
        check, fit = ("data", "check", f"skeleton={skeleton}", *words), ("fit", f"skeleton={skeleton}", *words, *QUICK)
        yield Sample(
            f"set {name}",
            place,
            (check, fit, ("predict", "run=RUN", f"input={use}:{split}", "data.root={}", "output=out.npz")),
        )


def _runs(folder: Path) -> Iterator[Sample]:
    """Run folders, and single files of theirs."""
    from uplift.cli.main import main

    body, masks = folder / "body.npz", folder / "masks.npz"
    words = {
        "run": ("fit", "skeleton=h36m17", f"data.train={body}", f"data.test={body}", *QUICK),
        "shapes": ("fit", *SHAPES, "data.simulate=0", f"data.train={masks}"),
    }
    for name, fit in words.items():
        if not (folder / name).exists():
            if main(list(fit)):
                raise RuntimeError(f"uplift {' '.join(fit)} failed")
            (made,) = (path.parent for path in Path("runs").rglob("last"))
            (made / "last").resolve().rename(folder / name)
            shutil.rmtree("runs")
    other = folder / "run"
    own = (("predict", "run={}", f"input={body}", "output=out.npz"), ("evaluate", "run={}", f"data.test={body}"),
           ("fit", "skeleton=h36m17", f"data.train={body}", "init={}", *QUICK))  # fmt: skip
    compare, resume = ("compare", "{}", str(other)), ("fit", "resume={}")
    yield Sample("lifter.pt", folder / "run", own, "lifter.pt")
    yield Sample("config.yaml", folder / "run", (*own, compare, resume, ("evaluate", "run={}")), "config.yaml")
    yield Sample("run.json", folder / "run", (*own, compare, resume), "run.json")
    yield Sample("evaluation.json", folder / "run", (compare, ("compare", str(other), "{}")), "evaluation.json")
    yield Sample("checkpoints", folder / "run", (resume,), "checkpoints")
    yield Sample("run", folder / "run", (*own, compare, resume))
    shapes = (
        ("predict", "run={}", f"input={masks}", "output=out.npz"),
        ("evaluate", "run={}", f"data.test={masks}", "items=1"),
    )
    yield Sample("lifter.pt of shapes", folder / "shapes", shapes, "lifter.pt")
    yield Sample("run of shapes", folder / "shapes", (*shapes, ("compare", "{}", str(folder / "shapes")), resume))


def make_samples(folder: Path, trained: bool = True) -> list[Sample]:
    """Write what is not there yet and return all samples; the current folder is one to work in.

    Without ``trained`` no run is made, and only commands that need none, and train nothing, are given.
    """
    makers = (_keypoints, _masks, _yaml, _three_d, *((_sets, _runs) if trained else ()))
    runs = {"RUN": str(folder / "run"), "SHAPES": str(folder / "shapes")}
    found = []
    for sample in (one for make in makers for one in make(folder)):
        given = [
            one
            for one in sample.commands
            if trained or (one[0] != "fit" and not any(w.startswith("run=") for w in one))
        ]
        commands = tuple(tuple(_with_runs(word, runs) for word in command) for command in given)
        found.append(replace(sample, commands=commands))
    return found


def _with_runs(word: str, runs: dict[str, str]) -> str:
    key, _, value = word.partition("=")
    return f"{key}={runs[value]}" if key == "run" and value in runs else word


def word_lists(folder: Path, trained: bool = True) -> list[tuple[str, ...]]:
    """Return valid commands, whose words are made wrong; without ``trained`` those that need no run and train nothing."""
    body, run = folder / "body.npz", folder / "run"
    found = [
        ("fit", "skeleton=h36m17", f"data.train={body}", *QUICK),
        ("fit", *SHAPES, "data.simulate=0", f"data.train={folder / 'masks.npz'}"),
        ("data", "check", "task=demo", f"data.train={body}"),
        ("data", "check", "task=cmu"),
        ("data", "cmu", str(folder / "mocap"), "output=out", "cameras=1", "fps=60", "test=01"),
        ("data", "render", "chairs", "output=out.npz", "items=2", "side=16"),
        ("data", "render", str(folder / "mesh" / "box.stl"), "output=out.npz", "items=2", "side=16"),
        ("predict", f"run={run}", f"input={body}", "output=out.npz"),
        ("predict", f"run={run}", f"input={folder / 'wide.csv'}", "output=out.html", "page=gallery", "frames=3"),
        ("predict", f"run={folder / 'shapes'}", f"input={folder / 'masks.npz'}", "output=out.glb"),
        ("evaluate", f"run={run}", f"data.test={body}"),
        ("evaluate", f"poses={body}", f"data.test={body}", "skeleton=h36m17"),
        ("simulate", "skeleton=h36m17", "output=out.csv", "frames=20"),
        ("compare", str(run), str(run)),
        ("skeleton", "check", "h36m17", "output=out.png"),
        ("skeleton", "new", "new.yaml", "from=" + str(folder / "wide.csv")),
        ("skeleton", "map", str(folder / "wide.csv"), "skeleton=coco17"),
        ("schema", "task", "output=a.json"),
        ("tasks",),
        ("skeletons",),
    ]
    return [words for words in found if trained or (words[0] not in ("fit", "compare") and f"run={run}" not in words)]
