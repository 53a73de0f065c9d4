"""One hostile case: what is damaged, the command, and what a process of its own makes of it."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import random
import re
import resource
import shutil
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import uplift
from benchmarks.hostile.mutations import WORDS, mutate
from benchmarks.hostile.samples import Sample

__all__ = ["SECONDS", "Outcome", "import_all", "run_case"]

SECONDS, _BYTES = 10, 1_000_000_000
_WAIT = 20 * SECONDS
_ROOM = 3 * _BYTES
"""Address space, beyond what the process has, that a case may ask for before it ends itself."""
_KEPT = (
    "trainer.max_steps=",
    "trainer.max_time=",
    "trainer.threads=",
    "items=",
    "frames=",
    "cameras=",
    "task=masks_demo",
)
"""Words that keep a valid command short: work that was asked for is not hostile."""
_OUTPUT, _MADE = ("stdout", "stderr"), "case.json"


@dataclass(frozen=True)
class Outcome:
    """What came of a case."""

    number: int
    sample: str
    done: str
    """What was damaged."""
    words: list[str]
    verdict: str
    """"done", "refused", or the fault."""
    seconds: float
    megabytes: float
    said: str
    """The end of the output, of a fault."""


def run_case(
    seed: int, number: int, samples: Sequence[Sample], commands: Sequence[tuple[str, ...]], folder: Path
) -> Outcome:
    """Make case ``number`` of a seed in a new folder below ``folder``, run it, and judge it."""
    place = folder / f"case{number}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    child = os.fork()
    if not child:
        _child(random.Random(f"{seed} {number}"), samples, commands, place)
    _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    name, done, words, before = (
        json.loads((place / _MADE).read_text()) if (place / _MADE).exists() else ("?", "?", [], 0)
    )
    extra = used.ru_maxrss * 1024 - before
    out, err = ((place / one).read_text(errors="replace") if (place / one).exists() else "" for one in _OUTPUT)
    verdict = _verdict(status, out, err, seconds, extra)
    held = verdict in ("done", "refused")
    if held:
        shutil.rmtree(place, ignore_errors=True)
    said = "" if held else (err or out)[-3000:]
    return Outcome(number, name, done, words, verdict, round(seconds, 2), round(extra / 1e6), said)


def _case(
    rng: random.Random, samples: Sequence[Sample], commands: Sequence[tuple[str, ...]], place: Path
) -> tuple[str, str, list[str]]:
    """Return the sample's name, what was damaged, and the command."""
    if rng.random() < 0.2:
        words = list(rng.choice(commands))
        return "words", "words", _wrong_words(words, rng)
    sample = rng.choice(samples)
    words = list(rng.choice(sample.commands))
    copy = place / sample.path.name
    if sample.path.is_dir():
        shutil.copytree(sample.path, copy)
    else:
        shutil.copy(sample.path, copy)
    done = mutate(copy / sample.inside, rng)
    words = [word.replace("{}", str(copy)) for word in words]
    if rng.random() < 0.1:
        words = _wrong_words(words, rng)
        done += ", words"
    return sample.name, done, words


def _wrong_words(words: list[str], rng: random.Random) -> list[str]:
    """Return a command with one or two words made wrong."""
    from uplift.cli.verbs import VERBS

    verb = words[0] if words[0] in VERBS else " ".join(words[:2])
    for _ in range(rng.choice((1, 1, 2))):
        what = rng.choice(("value",) * 4 + ("setting",) * 5 + ("gone", "twice", "key", "word", "swapped"))
        at = rng.randrange(len(words))
        if words[at].startswith(_KEPT):
            continue
        key, equals, value = words[at].partition("=")
        if what == "value":
            words[at] = f"{key}={rng.choice(WORDS)}" if equals else rng.choice(WORDS)
        elif what == "setting" and verb in VERBS and VERBS[verb].settings:
            one = rng.choice(list(VERBS[verb].settings))
            if not f"{one}=".startswith(_KEPT):
                words = [word for word in words if not word.startswith(f"{one}=")]
                words.append(
                    f"{one}={rng.choice(WORDS)}"
                    if rng.random() < 0.7
                    else f"{one}.{rng.choice(('x', 'use', 'a.b', ''))}={rng.choice(WORDS)}"
                )
        elif what == "gone" and len(words) > 1:
            del words[at]
        elif what == "twice":
            words.append(words[at])
        elif what == "key" and equals:
            words[at] = f"{rng.choice((key[:-1], key + 'x', key.upper(), '', '.' + key, key + '.', 'é'))}={value}"
        elif what == "word":
            words.insert(at, rng.choice(WORDS))
        elif what == "swapped":
            other = rng.randrange(len(words))
            words[at], words[other] = words[other], words[at]
    return words or [""]


# The process of a case.


def import_all() -> None:
    """Import the package and what its readers use, once for the processes of all cases."""
    import h5py  # noqa: F401
    import torch

    for module in pkgutil.walk_packages(uplift.__path__, "uplift."):
        importlib.import_module(module.name)
    torch.set_num_threads(1)


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _child(rng: random.Random, samples: Sequence[Sample], commands: Sequence[tuple[str, ...]], place: Path) -> NoReturn:
    """Make the case, run its command with limits and its output in files, and end the process."""
    status = 99
    try:
        os.chdir(place)
        for number, name in enumerate(_OUTPUT, 1):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
        with warnings.catch_warnings(action="ignore"):
            made = _case(rng, samples, commands, place)
        (place / _MADE).write_text(json.dumps([*made, _resident()]))
        words = made[2]
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        os.environ |= {"UPLIFT_DEBUG": "1", "UPLIFT_CACHE": str(place / "cache")}
        sys.argv = ["uplift", *words]
        address = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (address + _ROOM, address + _ROOM))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (2 * SECONDS, 2 * SECONDS))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_WAIT)  # it waits for something: a pipe, or an answer
        status = _status(words)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _status(words: list[str]) -> int:
    from uplift.cli.main import main

    try:
        return main(words)
    except SystemExit as stop:
        return int(stop.code or 0)
    except BaseException:
        traceback.print_exc()
        return 98


def _verdict(status: int, out: str, err: str, seconds: float, extra: float) -> str:
    """Return "done", "refused", or what is wrong."""
    if os.WIFSIGNALED(status):
        return f"killed by {signal.Signals(os.WTERMSIG(status)).name}"
    code, lines = os.WEXITSTATUS(status), err.splitlines()
    if "Traceback (most recent call last)" in err:
        return f"traceback {_fingerprint(err)}"
    if seconds > SECONDS:
        return "slow"
    if extra > _BYTES:
        return "memory"
    if code == 0:
        return "done" if not [line for line in lines if "Warning" in line] else "done, with warnings"
    if code != 2:
        return f"status {code}"
    if not lines:
        return "refused" if out else "silent"
    lines = [line for line in lines if "steps/s" not in line]  # progress
    if not lines or not lines[0].startswith("uplift: "):
        return "not one line"
    guided = any(line.startswith("Without: ") for line in lines)  # how to get the files of a data set
    return "refused" if len(lines) == 1 or guided else "not one line"


def _fingerprint(err: str) -> str:
    """Return the kind of an exception, and the last line of the package that it went through."""
    kinds = re.findall(r"^([\w.]+(?:Error|Exception|Interrupt|Exit|Refused|\w+))(?::|$)", err, re.M)
    ours = re.findall(r'File ".*?/uplift/([\w/]+\.py)", line \d+, in (\w+)', err)
    return f"{kinds[-1] if kinds else '?'} in {':'.join(ours[-1]) if ours else '?'}"
