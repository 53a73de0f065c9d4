"""Mutants: which there are of a line, and that one changes what its function returns and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutation.__main__ import _scores
from benchmarks.mutation.mutants import Mutant, code_of, mutants_of

SOURCE = '''"""Words 1 < 2."""
from __future__ import annotations

import math

_MOST = 5


class Box:
    side: float = 2.0

    def size(self, other: float = 1.5, *, deep: bool = False) -> float:
        """Return 1 + 1."""
        if other < 0:
            raise ValueError(f"other is {other + 1}")
        total = math.sin(other) + self.side
        total += 2
        return -total if deep else total
'''


@pytest.fixture
def mutants(tmp_path: Path) -> list[Mutant]:
    (tmp_path / "box.py").write_text(SOURCE)
    return list(mutants_of(tmp_path / "box.py", tmp_path))


def test_a_few_lines_have_these_mutants(mutants: list[Mutant]) -> None:
    found = {(one.kind, one.function, one.change.partition("  in  ")[0]) for one in mutants}
    expected = {
        ("constant", "_MOST", "5  ->  6"), ("constant", "_MOST", "5  ->  4"),
        ("default", "Box.size", "1.5  ->  2.25"), ("default", "Box.size", "1.5  ->  -1.5"),
        ("default", "Box.size", "False  ->  True"), ("body", "Box.size", "0  ->  1"),
        ("body", "Box.size", "other < 0  ->  not other < 0"), ("body", "Box.size", "other < 0  ->  other <= 0"),
        ("body", "Box.size", "other < 0  ->  other > 0"), ("body", "Box.size", "total += 2  ->  pass"),
        ("body", "Box.size", "math.sin(other) + self.side  ->  math.sin(other) - self.side"),
        ("body", "Box.size", "math.sin(other) + self.side  ->  math.sin(other)"),
        ("body", "Box.size", "math.sin(other)  ->  math.cos(other)"),
        ("body", "Box.size", "total += 2  ->  total -= 2"), ("body", "Box.size", "2  ->  3"),
        ("body", "Box.size", "2  ->  1"), ("body", "Box.size", "-total  ->  total"),
        ("body", "Box.size", "-total if deep else total  ->  total if deep else -total"),
    }  # fmt: skip
    assert found == expected and len(mutants) == len(expected)


def test_the_code_of_a_mutant_has_that_change_alone(mutants: list[Mutant]) -> None:
    spaces: dict[str, object] = {}
    exec(compile(SOURCE, "box.py", "exec"), spaces)
    box = spaces["Box"]
    before = box().size(0.0)  # type: ignore[operator]
    for mutant in mutants:
        if mutant.kind != "body":
            continue
        assert mutant.code is not None
        code = code_of(mutant.code, "Box.size")
        assert code is not None and code.co_filename.endswith("box.py")
        box.size.__code__ = code  # type: ignore[union-attr]
        if "+=" in mutant.change or "2  ->" in mutant.change:
            assert box().size(0.0) != before  # type: ignore[operator]


def test_scores_leave_out_what_is_no_bug_and_have_an_interval() -> None:
    """Wilson's interval of 9 of 10, from tables: 0.596 to 0.982."""
    found = [{"outcome": name} for name in ("killed",) * 8 + ("timeout", "survived", "equivalent", "invalid")]
    scores = _scores(found)
    assert scores["score"] == 0.9 and scores["interval"] == pytest.approx([0.596, 0.982], abs=1e-3)
    assert scores["equivalent"] == 1
