"""Published data sets, read from the files people have: one set per file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uplift.datasets.base import DataSet, WantedFile
from uplift.datasets.cache import read_cached
from uplift.plugins import build

__all__ = ["DATA_SETS", "DataSet", "WantedFile", "data_set", "read_cached"]

DATA_SETS = {
    "coco": "uplift.datasets.coco:Coco",
    "h36m": "uplift.datasets.h36m:Human36M",
    "mpi_inf_3dhp": "uplift.datasets.mpi_inf_3dhp:MpiInf3dhp",
    "mpii": "uplift.datasets.mpii:Mpii",
}


def data_set(use: str, folder: Path, options: Mapping[str, Any]) -> DataSet:
    """Return the data set ``use`` (a built-in or ``file.py:Class``) in ``folder``.

    Raises:
        UserError: no such data set, or an option that it does not take.
    """
    return build(use, DATA_SETS, options, "data.options", DataSet, folder=folder)
