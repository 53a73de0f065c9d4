"""Network families: shapes, the 2018 skip connection, and errors that name the setting."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uplift.errors import UserError
from uplift.models.networks import build_network

pytestmark = pytest.mark.usefixtures("trusting")


def _leaky(x: np.ndarray, slope: float) -> np.ndarray:
    return np.maximum(x, slope * x)


def test_kudo_network_is_four_layers_with_one_skip():
    torch.manual_seed(0)
    network = build_network("kudo", 6, 3, {"units": 10, "slope": 0.2, "std": 0.5}).double()
    w1, b1, w2, b2, w3, b3, w4, b4 = (p.detach().numpy() for p in network.parameters())
    x = np.random.default_rng(0).normal(size=(5, 6))
    h1 = _leaky(x @ w1.T + b1, 0.2)
    h2 = _leaky(h1 @ w2.T + b2, 0.2)
    h3 = _leaky(h2 @ w3.T + b3 + h1, 0.2)
    found = network(torch.from_numpy(x)).detach().numpy()
    np.testing.assert_allclose(found, h3 @ w4.T + b4, atol=1e-12)


@pytest.mark.parametrize(("std", "given"), [(0.02, {}), (0.14, {"std": 0.14})])
def test_kudo_initial_weights(std, given):
    torch.manual_seed(0)
    for parameter in build_network("kudo", 34, 17, given).parameters():
        if parameter.ndim == 2:
            assert float(parameter.detach().std()) == pytest.approx(std, rel=0.05)
            assert abs(float(parameter.detach().mean())) < 0.02 * std * 5
        else:
            assert not parameter.any()


@pytest.mark.parametrize("use", ["kudo", "residual"])
def test_every_parameter_has_a_part(use):
    network = build_network(use, 6, 3, {"units": 8})
    network(torch.randn(64, 6)).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())
    assert network(torch.randn(1, 6)).shape == (1, 3)


def test_residual_depth():
    count = {
        b: sum(p.numel() for p in build_network("residual", 6, 3, {"units": 8, "blocks": b}).parameters())
        for b in (1, 3)
    }
    assert count[3] - count[1] == 2 * 2 * (8 * 8 + 8)


def test_own_network_from_a_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from torch import nn\n\n\nclass Flat(nn.Linear):\n"
        "    def __init__(self, inputs, outputs, *, units=3):\n        super().__init__(inputs, outputs)\n"
    )
    assert build_network(f"{file}:Flat", 6, 3, {"units": 4})(torch.randn(2, 6)).shape == (2, 3)


@pytest.mark.parametrize(
    ("use", "options", "message"),
    [
        ("residul", {}, r"lifter\.network='residul'.*Did you mean 'residual'"),
        ("residual", {"unit": 3}, r"lifter\.options\.unit: .*Did you mean 'units'"),
        ("residual", {"units": "many"}, r"lifter\.options\.units='many'"),
        ("residual", {"units": 0}, r"lifter\.options\.units=0: expected a whole number from 1 to"),
        ("residual", {"blocks": 10**6}, r"lifter\.options\.blocks=1000000: expected a whole number from 1 to 256"),
        ("residual", {"units": 10**6}, r"lifter\.options\.units=1000000: expected a whole number from 1 to 16,384"),
        (
            "residual",
            {"units": 8000, "blocks": 9},
            r"1,152,000,000 weights, expected at most 200,000,000.*file\.py:Class",
        ),
        ("kudo", {"units": 16_000}, r"512,000,000 weights"),
        ("residual", {"blocks": 1.5}, r"lifter\.options\.blocks=1\.5"),
        ("kudo", {"slope": "steep"}, r"lifter\.options\.slope='steep': expected a number"),
        ("uplift.errors:UserError", {}, r"not a subclass of torch\.nn\.Module"),
    ],
)
def test_wrong_settings_are_named(use, options, message):
    with pytest.raises(UserError, match=message):
        build_network(use, 6, 3, options)
