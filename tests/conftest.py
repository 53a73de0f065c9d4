"""Fixtures that several test files share."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from page_browser import BROWSER, Browser

from uplift.config.files import cache_folder

if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread per process: more would only compete for the cores

# Deterministic examples: a failure can be reproduced.
settings.register_profile("steady", derandomize=True, deadline=None)
settings.load_profile("steady")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what tests make again and again in a cache of their own: the user's may hold anything, but has the networks."""
    cache, networks = tmp_path_factory.mktemp("cache"), cache_folder("mediapipe")
    if networks.is_dir():
        (cache / "mediapipe").symlink_to(networks, target_is_directory=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UPLIFT_CACHE", str(cache))
        yield


def pytest_collection_finish() -> None:
    """Keep what imports and collection made out of every later garbage collection; each fit collects several times."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def benchmark_data() -> Callable[[str], Path]:
    """Return a function from a name such as ``cmu/test.npz`` to its path; it skips the test if there is no such data."""

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
    """Run the test in an empty folder, which is returned, without benchmark data."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    return tmp_path


@pytest.fixture
def trusting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let any class be loaded that a test names: tests/cli/test_trust.py is about which may be."""
    monkeypatch.setattr("uplift.config.plugins.require", lambda asked: None)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Yield a headless browser for the tests of a module; they are skipped without Chromium."""
    if BROWSER is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()
