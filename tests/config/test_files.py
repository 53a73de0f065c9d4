"""A file appears whole or not at all, whatever goes wrong on the way."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from bodies import write_body

from uplift.config.files import Existing, building, clear_parts, read_torch, refuse_existing, replacing, save_torch
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


# Several commands, and commands that were killed.


def test_of_two_commands_the_second_is_refused(tmp_path: Path) -> None:
    """Both find nothing at first, and both write; what is first stays, and a third overwrites what nobody asked about."""
    path = tmp_path / "a.csv"
    refuse_existing(path)
    with pytest.raises(Existing, match=r"a\.csv: another command has made it meanwhile"), replacing(path) as late:
        late.write(b"second")
        path.write_bytes(b"first")  # as another process would, which this one's check came before
    assert path.read_bytes() == b"first" and os.listdir(tmp_path) == ["a.csv"]
    with pytest.raises(Existing, match="exists already and is not overwritten"):
        refuse_existing(path)
    with replacing(path) as file:
        file.write(b"newest")
    assert path.read_bytes() == b"newest"


def test_of_two_folders_the_second_is_refused(tmp_path: Path) -> None:
    made = tmp_path / "out"
    with pytest.raises(Existing, match="another command has made it meanwhile"), building(made) as second:
        (second / "a.txt").write_text("second")
        with building(made) as first:
            (first / "a.txt").write_text("first")
    assert (made / "a.txt").read_text() == "first" and os.listdir(tmp_path) == ["out"]
    (tmp_path / "empty").mkdir()
    with building(tmp_path / "empty") as folder:
        (folder / "b.txt").write_text("taken")
    assert os.listdir(tmp_path / "empty") == ["b.txt"]
    with pytest.raises(KeyboardInterrupt), building(tmp_path / "never") as folder:
        (folder / "b.txt").write_text("half")
        raise KeyboardInterrupt
    assert sorted(os.listdir(tmp_path)) == ["empty", "out"]


_KILLED = """
import os, signal, sys
from uplift.config.files import building, replacing
with replacing(sys.argv[1]) as file, building(sys.argv[2]) as folder:
    file.write(b"half")
    (folder / "half").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_command_left_is_cleared_by_the_next(tmp_path: Path) -> None:
    """The temporary files of the same target alone, never those of a process that lives, nor of another machine."""
    done = subprocess.run([sys.executable, "-c", _KILLED, tmp_path / "a.bin", tmp_path / "runs"], timeout=60)
    (left,) = tmp_path.glob(".a.bin.*.part")
    (folder,) = tmp_path.glob(".runs.*.part")
    assert done.returncode == -9
    dead = left.name.rpartition("-")[0].rpartition("-")[2]
    others = [left.name.replace(f"-{dead}-", f"x-{dead}-"), left.name.replace(f"-{dead}-", "-1-"), ".a.bin.mine.part"]
    for name in others:
        (tmp_path / name).write_bytes(b"another's")
    with replacing(tmp_path / "b.bin") as file:
        file.write(b"else")
    assert left.exists() and folder.is_dir()
    with replacing(tmp_path / "a.bin") as file:
        file.write(b"whole")
        with replacing(tmp_path / "a.bin") as again:  # the one around it lives
            again.write(b"inner")
    assert (tmp_path / "a.bin").read_bytes() == b"whole" and not left.exists() and folder.is_dir()
    clear_parts(tmp_path)
    assert sorted(os.listdir(tmp_path)) == sorted(["a.bin", "b.bin", *others])
