"""uplift's own npz of masks: crops that are clean already, with whatever else is known of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.masks.base import Look, MaskFormat, shuffled, wanted
from uplift.masks.container import MaskData
from uplift.masks.joining import join, resized
from uplift.masks.options import MaskOptions

__all__ = ["FORMAT"]


def _fits(look: Look) -> bool:
    return look.peek is not None and "masks" in look.peek.npz_names


def _read(paths: list[Path], options: MaskOptions) -> MaskData:
    from uplift.masks.npz import read_masks

    data = join([read_masks(path) for path in paths])
    where = Look(paths).where
    notes: list[str] = []
    if options.images is not None:
        raise UserError(f"images={options.images}: {where} names its photos itself; leave images= out.")
    if options.category:
        names = np.full(len(data), "") if data.category is None else data.category
        taken = wanted(options, set(names.tolist()), where)
        data = data.select(np.isin(names, list(taken)))
    if options.most is not None and options.most < len(data):
        rows = sorted(place for place, _ in shuffled(list(range(len(data))), options)[: options.most])
        notes.append(f"{options.most:,} of {len(data):,} masks are taken (most={options.most})")
        data = data.select(np.array(rows))
    if len(data) == 0:
        raise UserError(f"{where} has no masks.")
    if data.side != options.side:
        notes.append(f"crops of {data.side} px are resampled to {options.side} px")
        data = resized(data, options.side)
    return replace(data, notes=(*data.notes, *notes))


FORMAT = MaskFormat("npz", "uplift's own npz of masks", _fits, _read)
