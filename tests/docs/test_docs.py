"""The documentation: all names are covered; links, commands and examples work."""

from __future__ import annotations

import re
import shlex
from dataclasses import fields
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
import yaml
from bodies import QUICK, last_words, status_of

import uplift
from uplift.cli.help import help_text
from uplift.cli.main import _RUN
from uplift.cli.verbs import VERBS, sub_verbs
from uplift.config.files import shipped_names
from uplift.config.loading import load_settings, put_override, setting_names
from uplift.config.plugins import find_class, options_of
from uplift.config.settings import TRAINER_FLAGS, Settings
from uplift.data.formats import read, read_masks
from uplift.data.formats.base import ReadOptions
from uplift.data.mask_tensors import MaskSet
from uplift.data.masks import MaskData
from uplift.data.tensors import TrainingSet
from uplift.metrics.protocols import PROTOCOLS
from uplift.priors import PRIORS
from uplift.priors.flow import Flow
from uplift.skeleton import load_skeleton

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SMALL = (*QUICK, "data.simulate=200")
SMALL_MASKS = (
    "data.simulate=20", "data.side=32", "shape.coarse=8", "shape.detail=12", "shape.crop=12", "shape.pixels=12",
    "shape.code=4", "shape.hidden=16", "shape.rounds=0", "shape.refine=1", "shape.resolution=12",
    "trainer.max_time=null", "trainer.max_steps=10", "trainer.log_every=1", "trainer.threads=1", "teacher.batch_size=16",
)  # fmt: skip

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)


def _blocks(page: Path, language: str) -> list[str]:
    return [text for kind, text in _FENCE.findall(page.read_text()) if kind == language]


def _prose(page: Path) -> str:
    return _FENCE.sub("", page.read_text())


def _commands(page: Path) -> list[str]:
    """Return the `uplift ...` commands of the page's plain blocks and of its code spans."""
    lines = [line for block in _blocks(page, "") for line in block.splitlines()]
    lines += [span for span in re.findall(r"`([^`\n]+)`", _prose(page)) if "..." not in span]
    found = [re.sub(r"\s+#.*", "", line).strip() for line in lines]
    found = [re.sub(r"^(\w+=\S+\s+|\S*/)(?=\S*uplift)", "", line) for line in found]
    return [line for line in found if re.match(r"uplift \w", line)]


def _files(page: Path, language: str) -> dict[str, str]:
    """Return the page's blocks that are complete files: those that begin with ``# NAME.ending``."""
    named = [(re.match(r"# (\w+\.\w+)\n", block), block) for block in _blocks(page, language)]
    return {match[1]: block for match, block in named if match}


ALL_TEXT = "\n".join(page.read_text() for page in PAGES)
COMMANDS = [(page.name, command) for page in PAGES for command in _commands(page)]
LINKS = [
    (page, link)
    for page in PAGES
    for link in re.findall(r"\]\(([^)\s]+)\)", _prose(page))
    if not link.startswith(("http:", "https:"))
]


@pytest.mark.parametrize(
    "name",
    [
        *setting_names(),
        *(f"{name}" for name in shipped_names("tasks")),
        *shipped_names("skeletons"),
        *PRIORS,
        *PROTOCOLS,
    ],
)
def test_every_name_is_documented(name: str) -> None:
    assert f"`{name}`" in ALL_TEXT


def test_documented_settings_exist() -> None:
    groups = {name.split(".")[0] for name in setting_names() if "." in name} - {"priors"}
    spans = re.findall(rf"`((?:{'|'.join(groups)})\.[\w.]+)[`=]", ALL_TEXT)
    known = set(setting_names())
    known |= {name.rpartition(".")[0] for name in known}
    known |= {f"trainer.{name}" for name in TRAINER_FLAGS}
    known |= {f"data.{field.name}" for field in fields(TrainingSet)}  # what `prepare(data)` is given
    known |= {f"data.{field.name}" for kind in (MaskData, MaskSet) for field in fields(kind)}
    ours = {
        name
        for name in spans
        if not name.startswith(("lifter.options.", "lifter.pt", "student.options.", "data.options.", "sweep.options."))
        and not name.endswith((".NAME", ".py", ".csv", ".md"))
    }
    assert len(ours) > 50
    assert ours <= known


def test_the_defaults_in_the_tables_are_those_of_the_code() -> None:
    rows = re.findall(
        r"^\| ((?:`[\w.]+` ?)+) \| ((?:`[^`]+` ?)+) \|", (ROOT / "docs/tasks-and-settings.md").read_text(), re.M
    )
    documented: dict[str, str] = {}
    for names, values in rows:
        names, values = re.findall("`([^`]+)`", names), re.findall("`([^`]+)`", values)
        if names[0] in setting_names():
            assert len(names) == len(values), names
            documented |= dict(zip(names, values, strict=True))
    assert set(documented) == set(setting_names())
    for name, text in documented.items():
        value: object = Settings()
        for key in name.split("."):
            value = getattr(value, key)
        expected = list(value) if isinstance(value, tuple) else value
        found = text if isinstance(value, str) and value else yaml.safe_load(text)
        assert found == expected, name


@pytest.mark.parametrize(("page", "link"), LINKS, ids=[f"{page.name}:{link}" for page, link in LINKS])
def test_links_are_valid(page: Path, link: str) -> None:
    if link == "docs/pictures/page.png":
        pytest.skip("the picture is made from a run")
    file, _, anchor = link.partition("#")
    target = page.parent / file if file else page
    assert target.is_file()
    if anchor:
        titles = re.findall(r"^#+ (.+)$", _prose(target), re.M)
        assert anchor in {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(("page", "command"), COMMANDS, ids=[f"{page}:{command}"[:90] for page, command in COMMANDS])
def test_commands_parse(page: str, command: str) -> None:
    verb, *words = shlex.split(command)[1:]
    if "--help" in words:
        assert words[-1] in ("my_priors.py:MyPrior", "ground.py:FlatGround") or help_text([verb, *words])
        return
    assert verb in _RUN
    if verb == "skeleton":
        assert words[0] in sub_verbs("skeleton")
    elif verb == "data":
        assert words[0] in sub_verbs("data")
        if words[0] == "render":
            assert {word.partition("=")[0] for word in words if "=" in word} <= set(VERBS["data render"].settings)
        for word in words[1:] if words[0] == "check" else ():
            _check_fit_word(word)
    elif verb == "schema":
        assert words[0] in sub_verbs("schema")
    elif verb in ("detect", "evaluate", "predict", "simulate"):
        keys = {re.sub(r"(\.options)\..*", r"\1", word.partition("=")[0]) for word in words}
        assert keys <= set(VERBS[verb].settings)
    elif verb == "fit":
        for word in words:
            _check_fit_word(word)
    elif verb == "detectors":
        assert words in ([], ["get", "mediapipe"])
    elif verb == "lifters":
        assert set(words) <= set(shipped_names("lifters"))
    else:
        assert verb == "compare" or not words


def _check_fit_word(word: str) -> None:
    key, _, value = word.partition("=")
    if key == "task":
        assert value in (*shipped_names("tasks"), "NAME") or value.endswith(".yaml")
    elif key not in ("resume", "seed", "trust"):
        put_override({}, word)
    path = key.split(".")
    known = PRIORS
    if path[0] == "priors" and path[1] in known and path[2] not in ("use", "weight", "if_possible"):
        allowed = options_of(find_class(path[1], known, ""))
        assert allowed is None or path[2] in allowed


def test_every_verb_and_its_keys_are_documented() -> None:
    page = (ROOT / "docs/tasks-and-settings.md").read_text()
    for verb in _RUN:
        assert f"`{verb}`" in page or f"uplift {verb}" in page
    for verb, one in VERBS.items():
        for key in one.settings if verb not in ("fit", "data check") else ():
            assert f"| `{key}=` |" in ALL_TEXT


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_and_yaml_parse(page: Path) -> None:
    for block in _blocks(page, "python"):
        compile(block, page.name, "exec")
        for name in re.findall(r"\buplift\.(\w+)", block):
            assert name in uplift.__all__ or f"from uplift.{name}." in block
    for block in _blocks(page, "yaml"):
        assert isinstance(yaml.safe_load(block), dict)


def test_every_public_name_is_documented() -> None:
    page = (ROOT / "docs/python-api.md").read_text()
    assert [name for name in uplift.__all__ if f"uplift.{name}" not in page] == []


def test_the_beetle_of_the_skeleton_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = ROOT / "docs/skeletons.md"
    monkeypatch.chdir(tmp_path)
    Path("beetle.yaml").write_text(_files(page, "yaml")["beetle.yaml"])
    assert set(load_skeleton("beetle.yaml").facing) == {"front", "left", "up"}
    # The page's other blocks are parts of the same file.
    of_beetle = [b for b in _blocks(page, "yaml") if "head:" in b]
    Path("whole.yaml").write_text("".join([_files(page, "yaml")["beetle.yaml"], *of_beetle]))
    beetle = load_skeleton("whole.yaml")
    assert set(beetle.body) == {"rest", "proportions", "limits"}
    assert "my_tracker" not in beetle.sources or beetle.sources["my_tracker"]["head"] == ("Head",)
    assert len(uplift.simulate(beetle, frames=20)) == 20


def test_every_key_of_a_skeleton_is_documented() -> None:
    page = (ROOT / "docs/skeletons.md").read_text()
    for key in load_skeleton("h36m17").to_dict():
        assert f"| `{key}`" in page or f"`{key}`, " in page or f", `{key}`" in page


def test_every_joint_angle_is_documented() -> None:
    page = (ROOT / "docs/angles.md").read_text()
    of_skeletons = {name: load_skeleton(name).angles for name in shipped_names("skeletons")}
    plain = {re.sub(r"^(right|left)_", "", angle): name for name, angles in of_skeletons.items() for angle in angles}
    assert [f"{name}: {angle}" for angle, name in plain.items() if f"`{angle}`" not in page] == []
    listed = re.findall(r"^\| ((?:`[a-z_]+`(?:, )?)+) \| ", page.split("## For your skeleton")[0], re.M)
    named = {angle for row in listed for angle in re.findall("`([a-z_]+)`", row)}
    assert {angle for angle in named if not any(angle == known or known.endswith(angle) for known in plain)} == set()


def test_the_arrays_of_the_data_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uplift.data.formats.npz import KNOWN

    page = ROOT / "docs/your-data.md"
    monkeypatch.chdir(tmp_path)
    exec(_files(page, "python")["write_beetle.py"], {})
    assert read("beetle.npz").joint_names == ("head", "thorax", "abdomen_tip")
    text = page.read_text()
    assert all(f"`{name}`" in text for name in KNOWN)


def test_the_format_of_the_trackers_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    page = ROOT / "docs/trackers.md"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # a user's code may give lists
    Path("my_reader.py").write_text(_files(page, "python")["my_reader.py"])
    printed = next(block for block in _blocks(page, "") if block.startswith("frame head thorax"))
    first, *lines = printed.splitlines()
    bent = [" ".join([str(frame), *lines[0].split()[1:-2], f"{332 + frame} 0.9"]) for frame in range(2, 30)]
    Path("tracks").mkdir()
    for path in ("tracks/a.trk", "new.trk"):
        Path(path).write_text("\n".join([first, *lines, *bent]) + "\n")
    found = read("tracks", ReadOptions(format="my_reader.py:MyFormat"))
    assert found.keypoints[:2].tolist()[0][0] == pytest.approx([412.4, 300.1])
    assert found.confidence[1].tolist() == pytest.approx([0.98, 0.91, 0])
    assert found.identity["frame"].tolist() == list(range(30))
    commands = [command for command in _commands(page) if "tracks" in command or "new.trk" in command]
    assert [command.split()[1] for command in commands] == ["skeleton", "skeleton", "data", "fit", "predict"]
    for command in commands:
        words = shlex.split(command)[1:]
        assert status_of(words[0], *(QUICK if words[0] == "fit" else ()), *words[1:]) == 0, command
    assert "it can be lifted: 29 of 30 frames" in capsys.readouterr().out
    assert Path("poses.html").is_file()


def test_the_format_of_the_masks_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my_masks.py").write_text(_files(ROOT / "docs/masks-input.md", "python")["my_masks.py"])
    labels = np.zeros((60, 80), np.int64)
    labels[10:30, 10:40], labels[40:55, 30:70] = 2, 5
    np.save("new.npy", labels)
    found = read_masks("new.npy", format="my_masks.py:MyMasks")
    assert found.names == ["new:2", "new:5"]
    assert found.centre_px.tolist() == [[25, 20], [50, 47.5]]


def test_the_task_of_the_settings_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files = _files(ROOT / "docs/tasks-and-settings.md", "yaml")
    Path("beetle_task.yaml").write_text(files["beetle_task.yaml"])
    settings = load_settings("beetle_task.yaml")
    assert settings.skeleton == str(tmp_path / "beetle.yaml")
    assert settings.data.hold_out.subjects == ["S4"]
    assert settings.priors["flow"]["weight"] == 1
    assert settings.student.share > 0


EXAMPLES = [
    (page, name, command)
    for page in (ROOT / "README.md", ROOT / "docs/priors.md")
    for name in _files(page, "python")
    for command in _commands(page)
    if f".use={name}:" in command
]


def test_every_example_of_a_prior_has_its_command() -> None:
    assert {name for _, name, _ in EXAMPLES} == {"my_priors.py", "ground.py", "subspace.py", "limbs.py", "light.py"}


@pytest.mark.parametrize(("page", "name", "command"), EXAMPLES, ids=[name for _, name, _ in EXAMPLES])
def test_priors_run_as_they_are_printed(
    page: Path, name: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(_files(page, "python")[name])
    words = [word for word in shlex.split(command)[1:] if not word.startswith("task=")]
    quick = ["task=demo", *SMALL, "student.share=0", "trainer.log_every=1"]
    if "task=masks_demo" in command:
        quick = ["task=masks_demo", *SMALL_MASKS]
    assert status_of(words[0], *quick, *words[1:]) == 0
    prior = command.split("priors.")[1].split(".")[0]
    rows = [
        line.split(",") for line in (next(Path("runs").glob("*/last")) / "metrics.csv").read_text().splitlines()[1:]
    ]
    values = [float(row[3]) for row in rows if row[2] == prior]
    # Shapes are judged once there are some, in every other step.
    assert len(values) in ((2, 3) if "task=masks_demo" in command else (10,))
    assert max(values) > 0
    if name == "limbs.py":
        assert {"limbs_own", "limbs_accuracy"} <= {row[2] for row in rows}


def test_the_python_page_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    fit = uplift.fit
    monkeypatch.setattr(uplift, "fit", lambda task, *words, **more: fit(task, *last_words(*words, *SMALL), **more))
    session: dict[str, object] = {}
    for block in _blocks(ROOT / "docs/python-api.md", "python"):
        exec(block, session)
    assert session["pose"].shape == (300, 17, 3)  # type: ignore[attr-defined]
    assert session["one"].shape == (17, 3)  # type: ignore[attr-defined]
    assert "Did you mean 'h36m17'" in capsys.readouterr().out
    assert Path("poses.npz").is_file()


def test_the_lightning_page_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Blocks that are files are written, all others run, and its commands with a few steps."""
    pytest.importorskip("optuna")
    page = ROOT / "docs/lightning.md"
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    make = Flow.__init__
    monkeypatch.setattr(Flow, "__init__", lambda *given, steps=0, **more: make(*given, steps=20, **more))
    files = _files(page, "python")
    for name, text in files.items():
        Path(name).write_text(text)
    session: dict[str, object] = {}
    for block in _blocks(page, "python"):
        if block not in files.values():
            exec(block, session)
    assert session["poses"].pose.shape == (1000, 17, 3)  # type: ignore[attr-defined]
    assert "step 9: train/bones" in capsys.readouterr().out
    for name in ("walker.pt", "student.pt", "chairs.pt"):
        assert uplift.load(name)
    commands = [shlex.split(command)[1:] for command in _commands(page) if command.startswith("uplift fit task=demo ")]
    assert len(commands) == 5
    for verb, *words in commands:
        own = any(word.startswith("lifter.network") for word in words)
        small = [word for word in SMALL if not (own and word.startswith("lifter.options"))]
        assert status_of(verb, *(word for word in words if "tensorboard" not in word), *small) == 0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_are_plain(page: Path) -> None:
    text = page.read_text()
    assert text.startswith("# ")
    assert text.endswith("\n")
    assert not re.search(r"[\U0001F000-\U0001FAFF✅❌⚠]|/work/|/tmp/", text)
    assert page.name in ("README.md", "index.md") or f"({page.name})" in (ROOT / "docs/index.md").read_text()


def test_every_format_is_documented() -> None:
    from uplift.data.formats import KEYPOINT_FORMATS
    from uplift.export import WRITERS

    trackers, output = ((ROOT / "docs" / name).read_text() for name in ("trackers.md", "output.md"))
    assert [name for name in KEYPOINT_FORMATS if f"| `{name}` |" not in trackers] == []
    assert [ending for ending in WRITERS["poses"] if f"`{ending}`" not in output] == []


def test_mask_formats_shape_writers_and_metrics_are_documented() -> None:
    from uplift.data.formats import MASK_FORMATS
    from uplift.export import WRITERS
    from uplift.metrics.protocols import SHAPE_METRICS

    masks, output, metrics = (
        (ROOT / f"docs/{name}.md").read_text() for name in ("masks-input", "shapes-output", "shape-metrics")
    )
    assert [name for name in MASK_FORMATS if f"| `{name}` |" not in masks] == []
    assert [ending for ending in WRITERS["shapes"] if f"| `{ending}` |" not in output] == []
    assert [name for name in SHAPE_METRICS if f"| `{name}` |" not in metrics] == []
    page = (ROOT / "docs/masks-data.md").read_text()
    assert [key for key in VERBS["data render"].settings if f"| `{key}=` |" not in page] == []
