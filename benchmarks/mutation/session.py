"""A pytest plug-in: which tests run which lines, and whether they notice a mutant; each question in a fork of its own.

The parent collects all tests and runs none, so that every fork starts from the same clean state, without the seconds that
the imports take. A fork swaps the code of the functions that are mutated, and runs the tests that reach the line.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

from benchmarks.mutation.mutants import Mutant, code_of

__all__ = ["ROOT", "Budget", "Coverage", "Judge"]

ROOT = Path(__file__).resolve().parent.parent.parent

_SURVIVED, _KILLED, _INVALID = 10, 11, 12
_MEMORY = 16 << 30

Lines = set[tuple[str, int]]


@dataclass
class Budget:
    """Seconds of tests that a mutant is given: those that are too slow are left out."""

    a_test: float = 4.0
    a_mutant: float = 15.0


@dataclass
class Coverage:
    """Which tests reach which line, and how long each takes."""

    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))

    def add(self, test: str, seconds: float, lines: Lines) -> None:
        self.seconds[test] = seconds
        for line in lines:
            self.tests[line].add(test)

    def of(self, mutant: Mutant) -> set[str]:
        """Return the tests that reach the mutant's line or, where Python gives it none of its own, its statement."""
        if mutant.kind == "constant":  # whoever runs the module
            return set().union(*(tests for (path, _), tests in self.tests.items() if path == mutant.path))
        here = self.tests.get((mutant.path, mutant.line))
        return here or self.tests.get((mutant.path, mutant.statement_line), set())


class Judge:
    """Collects the tests, learns what they cover, and says of each mutant whether they notice it."""

    def __init__(self, files: Sequence[str], work: Callable[[Judge, Coverage], None], budget: Budget, traced: Path):
        self.files, self.work, self.budget, self.traced = files, work, budget, traced
        self.screen = os.fdopen(os.dup(sys.stdout.fileno()), "w")  # pytest captures the other one

    def say(self, text: str) -> None:
        """Write a line to the terminal."""
        print(text, file=self.screen, flush=True)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Do the work in place of the tests."""
        for file in self.files:
            importlib.import_module(file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"))
        self.items = {item.nodeid: item for item in session.items}
        coverage = self._covered()
        self.functions = _functions()
        gc.collect()
        gc.freeze()  # or every fork would copy what its collector looks at
        self.work(self, coverage)
        return True

    # Which lines a test runs.

    def _covered(self) -> Coverage:
        """Return the coverage of all tests; those that are in the file of traces already are not run again."""
        known = {one[0] for one in self._traces()}
        new = [item for test, item in self.items.items() if test not in known]
        if new:
            _in_fork(lambda: self._trace(new), 3600)
        coverage, setups = Coverage(), defaultdict(set)
        for test, seconds, setup, call in self._traces():
            if test in self.items:
                setups[test.partition("::")[0]] |= {tuple(one) for one in setup}
                coverage.add(test, seconds, {tuple(one) for one in call})
        for test in coverage.seconds:  # a fixture of the module runs once, for all of its tests
            coverage.add(test, coverage.seconds[test], setups[test.partition("::")[0]])
        return coverage

    def _traces(self) -> list[list[Any]]:
        """Return (test, seconds, lines of shared fixtures, lines) of the tests that passed."""
        return [json.loads(line) for line in self.traced.read_text().splitlines()] if self.traced.exists() else []

    def _trace(self, items: Sequence[Any]) -> int:
        tracer = _Tracer()
        with self.traced.open("a") as out:
            for item, after in zip(items, [*items[1:], None], strict=True):
                start, tracer.lines = time.perf_counter(), set()
                tracer.start()
                reports = runtestprotocol(item, log=False, nextitem=after)
                tracer.stop()
                seconds = round(time.perf_counter() - start, 3)
                if all(report.passed for report in reports):
                    setup = tracer.lines if _has_shared_fixtures(item) else set()
                    out.write(json.dumps([item.nodeid, seconds, sorted(setup), sorted(tracer.lines)]) + "\n")
                    out.flush()
        return _SURVIVED

    # Whether the tests notice a mutant.

    def tests_for(self, mutant: Mutant, coverage: Coverage) -> list[str]:
        """Return the tests to run: those of the module's own folder first, quick ones first, within the budget."""
        _, folder, name = mutant.path.removesuffix(".py").rsplit("/", 2) if mutant.path.count("/") > 1 else ("", "", "")

        def order(test: str) -> tuple[bool, bool, float]:
            file = test.partition("::")[0]
            return name not in file, f"/{folder}/" not in file, coverage.seconds[test]

        left, chosen = self.budget.a_mutant, []
        for test in sorted(coverage.of(mutant), key=order):
            seconds = coverage.seconds[test]
            if seconds <= min(self.budget.a_test, left):
                chosen.append(test)
                left -= seconds
        return chosen

    def outcome(self, mutant: Mutant, tests: Sequence[str]) -> str:
        """Return killed, timeout, survived, or invalid: such code cannot be put in; `killer` is the test that failed."""
        self.killer, told = "", self.traced.with_suffix(".killer")

        def run() -> int:
            if not _put_in(mutant, self.functions):
                return _INVALID
            chosen = [self.items[test] for test in tests]
            for item, after in zip(chosen, [*chosen[1:], None], strict=True):
                if any(report.failed for report in runtestprotocol(item, log=False, nextitem=after)):
                    told.write_text(item.nodeid)
                    return _KILLED
            return _SURVIVED

        status = _in_fork(run, int(10 + 4 * self.budget.a_mutant))
        if told.exists():
            self.killer = told.read_text()
            told.unlink()
        if os.WIFSIGNALED(status):
            return "timeout"
        return {_SURVIVED: "survived", _INVALID: "invalid"}.get(os.WEXITSTATUS(status), "killed")


def _has_shared_fixtures(item: Any) -> bool:
    """Return whether a fixture of the test is made once for several tests."""
    fixtures = getattr(item, "_fixtureinfo", None)
    found = fixtures.name2fixturedefs.values() if fixtures else []
    return any(
        one.scope in ("module", "session", "class") and "tests" in str(one.baseid or "")
        for defs in found
        for one in defs
    )


def _in_fork(run: Callable[[], int], seconds: int) -> int:
    """Return the wait status of a fork that runs ``run``; it is killed after some seconds."""
    child = os.fork()
    if child == 0:
        status = _INVALID
        try:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(seconds)
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
            status = run()
        finally:
            os._exit(status)
    return os.waitpid(child, 0)[1]


class _Tracer:
    """Notes the lines of the package that are run."""

    def __init__(self) -> None:
        self.names: dict[str, str | None] = {}
        self.lines: Lines = set()

    def start(self) -> None:
        sys.settrace(self._call)

    def stop(self) -> None:
        sys.settrace(None)

    def _call(self, frame: Any, event: str, argument: Any) -> Any:
        file = frame.f_code.co_filename
        if file not in self.names:
            self.names[file] = file.removeprefix(f"{ROOT}/") if file.startswith(f"{ROOT}/uplift/") else None
        name = self.names[file]
        if name is None:
            return None
        self.lines.add((name, frame.f_lineno))

        def line(frame: Any, event: str, argument: Any) -> Any:
            self.lines.add((name, frame.f_lineno))
            return line

        return line


# Put a mutant into the modules of this process.

Functions = dict[tuple[str, str], list[FunctionType]]
"""By file and qualified name: a decorated one hides in what decorates it."""


def _functions() -> Functions:
    found: Functions = defaultdict(list)
    for one in gc.get_objects():
        if type(one) is FunctionType and one.__code__.co_filename.startswith(f"{ROOT}/uplift/"):
            found[one.__code__.co_filename.removeprefix(f"{ROOT}/"), one.__code__.co_qualname].append(one)
    return found


def _put_in(mutant: Mutant, known: Functions) -> bool:
    """Return whether the mutant could be put in the place of the original."""
    assert mutant.code is not None
    module = sys.modules[mutant.path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")]
    if mutant.kind == "constant":
        return _put_constant(mutant.function, vars(module)[mutant.function], eval(mutant.code, vars(module)))
    functions = known.get((mutant.path, mutant.function), [])
    if mutant.kind == "default":
        value = eval(mutant.code, vars(module))
        return bool([_put_default(function, mutant.place, value) for function in functions])
    code = code_of(mutant.code, mutant.function)
    if code is None or any(len(one.__code__.co_freevars) != len(code.co_freevars) for one in functions):
        return False
    for function in functions:
        function.__code__ = code
    return bool(functions)


def _put_constant(name: str, old: Any, new: Any) -> bool:
    for other in list(sys.modules.values()):
        if getattr(other, "__name__", "").startswith(("uplift", "tests", "test_")) and vars(other).get(name) is old:
            setattr(other, name, new)
    return True


def _put_default(function: FunctionType, place: int, value: Any) -> None:
    plain = function.__defaults__ or ()
    if place < len(plain):
        function.__defaults__ = (*plain[:place], value, *plain[place + 1 :])
    else:
        count = function.__code__.co_argcount
        keyword = function.__code__.co_varnames[count : count + function.__code__.co_kwonlyargcount][place - len(plain)]
        function.__kwdefaults__ = {**(function.__kwdefaults__ or {}), keyword: value}
