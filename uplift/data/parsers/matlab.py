"""Read arrays and cell arrays of numbers from a MATLAB file of either generation, v5/v7 or v7.3 (HDF5)."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.parsers.files import HDF5_START, check_claim, check_memory, damage_as_error, existing_file
from uplift.errors import UserError

__all__ = ["load_mat", "load_mat5"]


def load_mat(
    path: Path, names: Collection[str], cells: Collection[int] | None = None
) -> dict[str, np.ndarray | list[np.ndarray]]:
    """Return those of ``names`` that the file has, arrays in MATLAB's order of axes, cell arrays as lists.

    With ``cells`` only those places of a cell array need to be read; others may come out empty.

    Raises:
        UserError: not a MATLAB file, damaged, or a variable that is not made of numbers.
    """
    if not _is_hdf5(path):
        return {
            name: [_numbers(path, name, np.asarray(cell)) for cell in value.ravel("F")]
            if value.dtype.kind == "O"
            else _numbers(path, name, value)
            for name, value in load_mat5(path, names).items()
        }
    try:
        import h5py
    except ImportError:
        raise UserError(f'{path} is a MATLAB v7.3 file; reading it needs h5py: pip install "uplift3d[mat]".') from None
    with damage_as_error(path, "a MATLAB file"), h5py.File(path, "r") as file:
        return {name: _from_hdf5(path, file, name, cells) for name in names if name in file}


def _is_hdf5(path: Path) -> bool:
    with existing_file(path, "a MATLAB .mat file").open("rb") as file:
        start = file.read(520)
    return HDF5_START in (start[:8], start[512:])


def load_mat5(path: Path, names: Collection[str]) -> dict[str, Any]:
    """Return those of ``names`` that a v5/v7 file has, as scipy reads them.

    Raises:
        UserError: not a MATLAB file of that generation, or damaged.
    """
    try:
        from scipy.io import loadmat, whosmat
    except ImportError:
        raise UserError(f'{path}: reading MATLAB files needs scipy: pip install "uplift3d[mat]".') from None
    if _is_hdf5(path):
        raise UserError(f"{path} is a MATLAB v7.3 file, expected one of an older generation: save it with '-v7'.")
    with damage_as_error(path, "a MATLAB file"):
        shapes = {name: shape for name, shape, _ in whosmat(path)}
        for name, shape in shapes.items():
            size = check_claim(f"{path}: '{name}'", shape, np.dtype(float))
            check_memory(path, f"'{name}'", size, path.stat().st_size)
        wanted = [name for name in names if name in shapes]
        found = loadmat(path, variable_names=wanted, verify_compressed_data_integrity=True) if wanted else {}
    return {name: found[name] for name in wanted if name in found}


def _numbers(path: Path, name: str, value: np.ndarray) -> np.ndarray:
    if value.dtype.kind not in "fiub":
        raise UserError(f"{path}: '{name}' is not an array of numbers (found {value.dtype.name}).")
    return value


def _from_hdf5(path: Path, file: Any, name: str, cells: Collection[int] | None) -> np.ndarray | list[np.ndarray]:
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise UserError(f"{path}: '{name}' is a link, expected an array.")
    item = file[name]
    if not isinstance(item, h5py.Dataset):
        raise UserError(f"{path}: '{name}' is a struct, expected an array or a cell array.")
    if h5py.check_ref_dtype(item.dtype) is None:
        return _array(path, name, item)
    size = check_claim(f"{path}: '{name}'", item.shape, np.dtype(float))
    check_memory(path, f"'{name}'", size, path.stat().st_size)
    places = item[()].T.ravel("F")
    return [
        _array(path, name, file[place]) if cells is None or number in cells else np.empty((0, 0))
        for number, place in enumerate(places)
    ]


def _array(path: Path, name: str, item: Any) -> np.ndarray:
    """Return a dataset of numbers with MATLAB's order of axes, which HDF5 stores the other way round."""
    if item.dtype.kind not in "fiub" or item.external or item.is_virtual:
        raise UserError(f"{path}: '{name}' is not a plain array of numbers (found {item.dtype}).")
    size = check_claim(f"{path}: '{name}'", item.shape, item.dtype)
    check_memory(path, f"'{name}'", size, path.stat().st_size)
    if item.attrs.get("MATLAB_empty", 0):
        return np.empty((0, 0))
    return item[()].T
