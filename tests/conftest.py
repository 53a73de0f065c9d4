"""Fixtures that several test files share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # a thread a core: more only wait for each other

# The same examples every time: a suite that fails says why twice in a row.
settings.register_profile("steady", derandomize=True, deadline=None)
settings.load_profile("steady")


@pytest.fixture
def benchmark_data() -> Callable[[str], Path]:
    """Return a function from a name such as ``cmu/test.npz`` to its path; it skips where the data is absent."""

    def find(name: str) -> Path:
        root = os.environ.get("UPLIFT_DATA")
        if not root:
            pytest.skip("UPLIFT_DATA is not set: no benchmark data")
        path = Path(root) / name
        if not path.exists():
            pytest.skip(f"no {name} in UPLIFT_DATA={root}")
        return path

    return find


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the empty folder that the test runs in, without benchmark data."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    return tmp_path
