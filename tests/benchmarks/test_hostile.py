"""A sample of the hostile inputs of `benchmarks.hostile`: each is done, or refused in one line, within its limits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import uplift.cli.main  # noqa: F401
from benchmarks.hostile.cases import run_case
from uplift.errors import UserError

main_module = sys.modules["uplift.cli.main"]
ROOT = Path(__file__).resolve().parents[2]


def test_a_sample_of_hostile_inputs(here: Path) -> None:
    """In a process without the checks of shapes, which would take most of the time of each case."""
    words = ["-m", "benchmarks.hostile", "--quick", "--cases", "40", "--seed", "16", "--out", str(here / "found.json")]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, *words], cwd=here, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((here / "found.json").read_text())
    assert found["verdicts"].keys() == {"done", "refused"}
    assert len(found["samples"]) > 20


@pytest.mark.parametrize(
    ("fault", "verdict"),
    [
        (lambda: [][1], "traceback IndexError in "),
        (lambda: sys.exit(1), "status 1"),
        (lambda: len(b"x" * 300_000_000) and 0, "memory"),
        (lambda: print("uplift: a\nb", file=sys.stderr) or 2, "not one line"),
        (lambda: 2, "silent"),
        (lambda: (_ for _ in ()).throw(UserError("wrong")), "refused"),
        (lambda: 0, "done"),
    ],
)
def test_faults_are_seen(fault, verdict: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge is not blind: each kind of fault, put in place of a command, is called by its name."""
    monkeypatch.setitem(main_module._RUN, "tasks", lambda words: fault())
    monkeypatch.setattr("benchmarks.hostile.cases._BYTES", 100_000_000)
    monkeypatch.setattr("benchmarks.hostile.cases._case", lambda *_: ("tasks", "nothing", ["tasks"]))
    assert run_case(0, 0, [], [("tasks",)], here / "cases").verdict.startswith(verdict)
