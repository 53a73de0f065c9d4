"""The number of threads follows what is faster, and is given back."""

from __future__ import annotations

import time

import pytest
import torch

from uplift.training.callbacks import Threads


@pytest.mark.parametrize("faster", [1, 4])
def test_the_faster_number_is_kept(faster: int):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(4)
        callback = Threads()
        for _ in range(12):
            callback.on_train_batch_start(None, None, 0, 0)
            time.sleep(0.001 if torch.get_num_threads() == faster else 0.02)
            callback.on_train_batch_end()
        assert torch.get_num_threads() == faster
        callback.on_train_end()
        assert torch.get_num_threads() == 4
    finally:
        torch.set_num_threads(before)
