"""Weights as .safetensors: what is written is read, in float16 nearly so, and damaged files are refused in one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file

from uplift.config.safe_weights import describe_safe, read_safe, save_safe
from uplift.errors import UserError

PLAIN = {"uplift_format": 3, "skeleton": {"joints": ["a", "b"]}, "usual": [[0.0, 0.5], [0.0, 1.0]], "name": "größe"}
STATE = {
    "network.weight": torch.linspace(-3, 3, 35).reshape(5, 7).T,  # not contiguous
    "network.bias": torch.linspace(0.1, 0.2, 5),
    "count": torch.tensor([3, 4]),
}


def written(tmp_path: Path, name: str = "a.safetensors", half: bool = False) -> Path:
    save_safe({**PLAIN, "state": STATE}, tmp_path / name, half=half)
    return tmp_path / name


def test_what_is_written_is_read(tmp_path: Path) -> None:
    found = read_safe(written(tmp_path), "lifter")
    state = found.pop("state")
    assert found == PLAIN
    assert describe_safe(tmp_path / "a.safetensors") == PLAIN
    assert state.keys() == STATE.keys()
    for name, value in STATE.items():
        assert state[name].dtype == value.dtype
        assert torch.equal(state[name], value)


def test_half_loses_a_thousandth_of_matrices_alone(tmp_path: Path) -> None:
    state = read_safe(written(tmp_path, half=True), "lifter")["state"]
    assert {one.dtype for one in state.values()} == {torch.float32, torch.int64}
    assert torch.equal(state["network.bias"], STATE["network.bias"])
    off = (state["network.weight"] - STATE["network.weight"]).abs() / STATE["network.weight"].abs().clamp_min(1e-3)
    assert 0 < off.max() < 1e-3
    with pytest.raises(UserError, match="network.weight has weights up to 3e\\+05, float16 ends at 65,504"):
        save_safe({"state": {"network.weight": torch.full((2, 2), 3e5)}}, tmp_path / "b.safetensors", half=True)
    assert not (tmp_path / "b.safetensors").exists()


def test_the_same_weights_make_the_same_file_that_others_read(tmp_path: Path) -> None:
    one, other = written(tmp_path), written(tmp_path, "b.safetensors")
    assert one.read_bytes() == other.read_bytes()
    theirs = load_file(one)
    np.testing.assert_array_equal(theirs["network.weight"], STATE["network.weight"].numpy())


@given(st.data())
def test_a_damaged_file_is_refused_in_one_line_or_holds_all(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = written(tmp_path_factory.mktemp("damaged"))
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans(), "cut"):
        content = content[: data.draw(st.integers(0, len(content) - 1), "length")]
    else:
        for _ in range(data.draw(st.integers(1, 4), "flips")):
            content[data.draw(st.integers(0, len(content) - 1), "at")] ^= data.draw(st.integers(1, 255), "bits")
    path.write_bytes(content)
    try:
        state = read_safe(path, "lifter")["state"]
    except UserError as error:
        assert "\n" not in str(error)
        assert str(path) in str(error)
    else:
        assert all(isinstance(one, torch.Tensor) for one in state.values())


def test_other_files_are_refused(tmp_path: Path) -> None:
    save_file({"weight": np.ones((2, 2), np.float32)}, tmp_path / "others.safetensors")
    with pytest.raises(UserError, match="no 'uplift' in its header: it holds weights, but not what they are of"):
        read_safe(tmp_path / "others.safetensors", "lifter")
    save_file({"weight": np.ones(2)}, tmp_path / "deep.safetensors", {"uplift": "[" * 100_000})
    with pytest.raises(UserError, match="cannot be read as a lifter"):
        read_safe(tmp_path / "deep.safetensors", "lifter")
    with pytest.raises(UserError, match="No lifter .*none.safetensors"):
        read_safe(tmp_path / "none.safetensors", "lifter")
    huge = json.dumps({"weight": {"dtype": "F32", "shape": [10**9, 10**3], "data_offsets": [0, 4 * 10**12]}}).encode()
    (tmp_path / "huge.safetensors").write_bytes(len(huge).to_bytes(8, "little") + huge)
    with pytest.raises(UserError, match="damaged, or another kind of file"):
        read_safe(tmp_path / "huge.safetensors", "lifter")


def test_a_description_needs_no_torch(tmp_path: Path) -> None:
    path = written(tmp_path)
    code = f"import sys; from pathlib import Path; from uplift.config.safe_weights import describe_safe; describe_safe(Path({str(path)!r})); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
