"""The networks of MediaPipe: where their files are found on this machine, and how they are fetched once."""

from __future__ import annotations

import hashlib
import importlib.util
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from uplift.config.files import cache_folder, replacing
from uplift.errors import UserError

__all__ = ["FETCHED", "fetch_networks", "find_network", "has_networks"]

FETCHED = {
    "pose_detection": "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    "pose_landmark_full": "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    "palm_detection_full": "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
    "palm_detection_lite": "e9a4aaddf90dda56a87235303cf00e4c2d3fb28725f68fd88772997dac905c18",
    "hand_landmark_full": "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
    "hand_landmark_lite": "048edd3645c9bf7397d19a9f6e3a42957d6e414c9bea6598030a2e9b624156e6",
}
"""What the wheel has, with the SHA-256 of each file."""
_WHEEL = ("mediapipe==0.10.14", "3.12", "manylinux2014_x86_64")
"""The last whose wheel holds networks of body and hands and runs with numpy 2; its files are the same for every system."""
_IN_TASKS = {
    "pose_detection": "pose_detector",
    "pose_landmark": "pose_landmarks_detector",
    "palm_detection": "hand_detector",
    "hand_landmark": "hand_landmarks_detector",
}
"""Networks by the names that they have in .task files."""
_LARGEST = 200 * 2**20


def find_network(name: str, weights: str | None = None) -> bytes:
    """Return the .tflite file of a network: from ``weights`` (folder or .task file), else an installed MediaPipe, else the cache.

    Raises:
        UserError: it is in none of them, or the file cannot be read.
    """
    given = _given(name, Path(weights).expanduser()) if weights else None
    if given is not None:
        return given
    for folder in _folders():
        for path in folder.glob(f"**/{name}.tflite"):
            return path.read_bytes()
    ways = [f"a folder or .task file that has it: detector.options.weights={weights or 'PATH'}"]
    if name in FETCHED:
        ways = ["uplift detectors get mediapipe", "pip install mediapipe==0.10.14", *ways]
    raise UserError(
        f"MediaPipe's network {name} is not{' there, nor' if weights else ''} on this machine. Give it once: {', or '.join(ways)}"
        + ("." if name in FETCHED else " (Google's pose_landmarker_heavy.task, or the npm package @mediapipe/pose).")
    )


def has_networks(names: Iterable[str]) -> bool:
    """Return whether all of these networks are found without ``weights``."""
    return all(any(True for folder in _folders() for _ in folder.glob(f"**/{name}.tflite")) for name in names)


def _folders() -> list[Path]:
    """Return the folders to look in: the modules of an installed MediaPipe, which is not imported, and the cache."""
    found = importlib.util.find_spec("mediapipe")
    places = list(found.submodule_search_locations or []) if found else []
    return [*(Path(place) / "modules" for place in places), cache_folder("mediapipe")]


def _given(name: str, path: Path) -> bytes | None:
    """Return a network from a folder or .task file that the user names; None where it is not in it."""
    where = f"detector.options.weights={path}"
    names = [name, *(there for ours, there in _IN_TASKS.items() if name.startswith(ours))]
    if path.is_dir():
        files = (file for one in names for file in sorted(path.glob(f"**/{one}.tflite")))
        return next((file.read_bytes() for file in files), None)
    if not path.is_file():
        raise UserError(f"{where}: no such folder or file.")
    try:
        with zipfile.ZipFile(path) as task:
            inside = {Path(one.filename).stem: one for one in task.infolist()}
            found = next((inside[one] for one in names if one in inside), None)
            if found is not None and found.file_size > _LARGEST:
                raise UserError(f"{where}: {found.filename} is too large for a network.")
            return None if found is None else task.read(found)
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise UserError(
            f"{where} cannot be read ({error}): expected a folder of .tflite files, or a .task file."
        ) from None


def fetch_networks() -> Path:
    """Put the networks of MediaPipe's wheel (Apache-2.0) into the cache by ``pip download``, and return its folder.

    Nothing of the wheel is installed or run. What is there already and as it should be is not fetched again.

    Raises:
        UserError: pip fails, such as without a network, or a file is not the one that is expected.
    """
    folder = cache_folder("mediapipe")
    if all(_digest(folder / f"{name}.tflite") == digest for name, digest in FETCHED.items()):
        return folder
    package, python, platform = _WHEEL
    words = ["--no-deps", "--only-binary=:all:", "--python-version", python, "--platform", platform, package]
    with tempfile.TemporaryDirectory() as there:
        done = subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--dest", there, *words],
            capture_output=True,
            text=True,
        )
        wheels = list(Path(there).glob("*.whl"))
        if done.returncode or not wheels:
            lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR") or "No module" in line]
            raise UserError(
                f"pip cannot download {package} ({(lines or ['no reason given'])[-1][:200]}). On another machine: pip "
                f"download {' '.join(words)}; then unpack the .whl and give detector.options.weights=FOLDER."
            )
        _unpack(wheels[0], folder)
    return folder


def _unpack(wheel: Path, folder: Path) -> None:
    """Put the networks of a wheel into a folder; raises UserError where one is missing or another than expected."""
    folder.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        inside = {Path(one).stem: one for one in archive.namelist() if one.endswith(".tflite")}
        for name, digest in FETCHED.items():
            content = archive.read(inside[name]) if name in inside else b""
            if hashlib.sha256(content).hexdigest() != digest:
                raise UserError(f"{wheel.name}: {name}.tflite is not the file that is expected (SHA-256): not used.")
            with replacing(folder / f"{name}.tflite") as file:
                file.write(content)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
