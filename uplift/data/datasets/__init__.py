"""Published data sets, read from the files people have: one set per file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uplift.config.plugins import build
from uplift.data.datasets.base import DataSet, WantedFile, read_cached

__all__ = ["DATA_SETS", "DataSet", "WantedFile", "data_set", "read_cached"]

DATA_SETS = {
    "coco": "uplift.data.datasets.coco:Coco",
    "h36m": "uplift.data.datasets.h36m:Human36M",
    "mpi_inf_3dhp": "uplift.data.datasets.mpi_inf_3dhp:MpiInf3dhp",
    "mpii": "uplift.data.datasets.mpii:Mpii",
}


def data_set(use: str, folder: Path, options: Mapping[str, Any]) -> DataSet:
    """Return the data set ``use`` (a built-in or ``file.py:Class``) in ``folder``.

    Raises:
        UserError: no such data set, or an option that it does not take.
    """
    return build(use, DATA_SETS, options, "data.options", DataSet, setting="data.use", folder=folder)
