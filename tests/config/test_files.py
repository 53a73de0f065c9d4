"""A file appears whole or not at all, whatever goes wrong on the way."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from bodies import write_body

from uplift.config.files import read_torch, replacing, save_torch
from uplift.data.formats.npz import write_keypoints
from uplift.data.load import load_file
from uplift.errors import UserError
from uplift.skeleton import load_skeleton


@contextmanager
def no_file_larger_than(size: int) -> Iterator[None]:
    """Make the system itself refuse to write more: a disk that is full after ``size`` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder on a disk of 64 kB; skips where none can be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    except OSError as error:
        pytest.skip(f"no mount: {error}")
    if done.returncode:
        pytest.skip(f"cannot mount a tmpfs: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True, timeout=20)


def test_a_file_appears_whole(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.bin") as file:
        file.write(b"new")
        assert not (tmp_path / "a.bin").exists()
    assert (tmp_path / "a.bin").read_bytes() == b"new"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt(), ValueError()])
def test_what_goes_wrong_leaves_the_old_file(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "a.bin").write_bytes(b"old")
    with pytest.raises(type(error)), replacing(tmp_path / "a.bin") as file:
        file.write(b"half")
        raise error
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_disk_that_fills_at_the_last_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a.bin").write_bytes(b"old")
    monkeypatch.setattr("uplift.config.files.os.fsync", full)
    with pytest.raises(OSError, match="No space left"), replacing(tmp_path / "a.bin") as file:
        file.write(b"new")
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_tensors_on_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    save_torch({"weights": torch.ones(3)}, path)
    before = path.read_bytes()
    with pytest.raises(OSError, match="File too large"), no_file_larger_than(30_000):
        save_torch({"weights": torch.rand(100_000)}, path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1
    assert torch.equal(read_torch(path, "checkpoint")["weights"], torch.ones(3))


def test_keypoints_on_a_full_disk(tmp_path: Path) -> None:
    data = load_file(write_body(tmp_path / "a.npz", 200), load_skeleton("h36m17"))
    with pytest.raises(OSError, match="File too large"), no_file_larger_than(20_000):
        write_keypoints(data, tmp_path / "b.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_disk_that_is_really_full(small_disk: Path) -> None:
    path = small_disk / "a.ckpt"
    save_torch({"weights": torch.ones(3)}, path)
    before = path.read_bytes()
    with pytest.raises(OSError, match="No space left on device"):
        save_torch({"weights": torch.rand(100_000)}, path)
    assert path.read_bytes() == before
    assert [found.name for found in small_disk.iterdir()] == ["a.ckpt"]


def test_places_where_no_file_can_be(tmp_path: Path) -> None:
    for path, says in ((tmp_path / "none" / "a.bin", "does not exist"), (tmp_path, "not an ordinary file")):
        with pytest.raises(UserError, match=says), replacing(path):
            pytest.fail("opened")
    assert not list(tmp_path.iterdir())


def test_a_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "real.bin").write_bytes(b"old")
    (tmp_path / "link.bin").symlink_to("real.bin")
    with replacing(tmp_path / "link.bin") as file:
        file.write(b"new")
    assert (tmp_path / "link.bin").is_symlink()
    assert (tmp_path / "real.bin").read_bytes() == b"new"
