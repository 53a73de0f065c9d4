"""Make the ready lifters: fit, convert to float16, measure, and write the weights and the model card of each.

``python -m benchmarks.lifters [NAME ...]`` with the data of UPLIFT_DATA. A fit that is complete in --work is used again.
"""

from __future__ import annotations

import argparse
import hashlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from benchmarks.common import ROOT, BenchmarkError, data_folder, run_python
from benchmarks.lifters.card import card
from benchmarks.lifters.measure import Figures, measure
from uplift.cli.lifters import layouts_of
from uplift.config.files import replacing
from uplift.config.run import RunFolder
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.models.known_body import usual_errors
from uplift.models.model import Model, load_poses
from uplift.skeleton import load_skeleton

LIFTERS: dict[str, dict[str, Any]] = yaml.safe_load((Path(__file__).parent / "lifters.yaml").read_text())


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the lifters that are named, by default all; 1 if one failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lifters", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(LIFTERS)}; default: all")
    parser.add_argument("--work", type=Path, default=Path("runs/lifters"), help="folder of the fits (runs/lifters)")
    parser.add_argument("--output", type=Path, default=ROOT / "lifters", help="folder of weights and cards (lifters/)")
    parser.add_argument("--steps", type=int, help="so many steps in place of the usual ones, to try it out")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(LIFTERS):
        parser.error(f"no lifter {', '.join(sorted(unknown))}; expected any of {', '.join(LIFTERS)}")
    failed = 0
    for name in given.names or LIFTERS:
        try:
            make(name, given.work, given.output, given.steps)
        except (BenchmarkError, UserError) as error:
            failed += 1
            print(f"\n{name}: {error}\n", file=sys.stderr, flush=True)
    return 1 if failed else 0


def make(name: str, work: Path, output: Path, steps: int | None = None) -> None:
    """Write ``NAME.safetensors`` and ``NAME.md`` into ``output``."""
    wanted, path = LIFTERS[name], output / f"{name}.safetensors"
    words = [*wanted["fit"].split(), "trainer.max_time=null", "trainer.threads=1"]
    words += [] if steps is None else [f"trainer.max_steps={steps}"]
    words = list({word.partition("=")[0]: word for word in words}.values())  # a word given twice: the last
    task = words[0].partition("=")[2]
    run = _fitted(words, work / name, task)
    output.mkdir(parents=True, exist_ok=True)
    print(f"{name}: measure", flush=True)
    model = _complete(load_poses(run.weights), data_folder() / task / "train.npz")
    model.save(path, half=True)  # what is measured is what is shipped
    found = measure(load_poses(path), wanted, task, data_folder(), run.settings().data.unit)
    facts = _facts(name, words, run, path)
    about = {
        "title": wanted["title"],
        "figures": _headline(found, task),
        "licence": wanted["licence"],
        "origin": wanted["origin"],
    }
    model.save(path, half=True, about=about | facts)
    facts |= {"file": f"`{path.name}`, {path.stat().st_size / 1e6:.1f} MB, float16", "takes": _takes(model)}
    text = card(name, wanted, facts | {"licence": wanted["licence"]}, found)
    with replacing(path.with_suffix(".md")) as file:
        file.write(text.encode())
    print(f"{name}: {_headline(found, task)}", flush=True)


def _fitted(words: Sequence[str], folder: Path, task: str) -> RunFolder:
    """Return the complete run of these words in ``folder``, fitted now if there is none."""
    last = folder / "runs" / task / "last"
    if not _is_of(words, last):
        print(f"uplift fit {shlex.join(words)}", flush=True)
        folder.mkdir(parents=True, exist_ok=True)
        run_python(["-m", "uplift.cli.main", "fit", *words], folder, env={"OMP_NUM_THREADS": "1"})
    return RunFolder.open(last)


def _is_of(words: Sequence[str], run: Path) -> bool:
    if not (run / "lifter.pt").is_file():
        return False
    return set(shlex.split(RunFolder.open(run).facts()["command"])[2:]) == set(words)


def _complete(model: Model, train: Path) -> Model:
    """Return the model with the skeleton as it is included now, and with what tells other bodies where the fit did not keep that."""
    skeleton = load_skeleton(model.skeleton.name)
    if (skeleton.joints, skeleton.bones, skeleton.root) != (
        model.skeleton.joints,
        model.skeleton.bones,
        model.skeleton.root,
    ):
        raise BenchmarkError(
            f"the fit is of another skeleton '{skeleton.name}' than the one that is included now: fit again"
        )
    model = replace(model, skeleton=skeleton)  # other layouts may have come to it since
    return model if model.usual else replace(model, usual=usual_errors(model, load_file(train, model.skeleton)))


def _facts(name: str, words: Sequence[str], run: RunFolder, path: Path) -> dict[str, str]:
    facts = run.facts()
    return {
        "skeleton": run.settings().skeleton,
        "command": f"`uplift fit {' '.join(words)}`",
        "seed": str(facts["seed"]),
        "steps": f"{sum(facts['steps'].values()):,}",
        "commit": (facts.get("git") or {}).get("commit", "unknown")[:12],
        "torch": facts["versions"]["torch"],
        "sha256 of the weights": hashlib.sha256(_weights_in(path)).hexdigest(),
    }


def _weights_in(path: Path) -> bytes:
    """Return the bytes of the tensors of a .safetensors file, which do not hold what is said of them."""
    content = path.read_bytes()
    return content[8 + int.from_bytes(content[:8], "little") :]


def _takes(model: Model) -> str:
    return ", ".join(f"`{one}`" for one in layouts_of(model.skeleton))


def _headline(found: Figures, task: str) -> Mapping[str, str]:
    unit = "thousandths of body size" if found.unit == "relative" else found.unit
    return {"p_mpjpe": f"{found.headline['p_mpjpe']:.1f} {unit} on {task}/test ({found.frames:,} frames)"}


if __name__ == "__main__":
    sys.exit(main())
