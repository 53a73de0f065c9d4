"""Names and files turned into objects: found, checked, and never half made."""

from __future__ import annotations

from pathlib import Path

import pytest
from torch import nn

from uplift.config.plugins import build, find_class, options_of
from uplift.errors import UserError

pytestmark = pytest.mark.usefixtures("trusting")

OWN = """
from torch import nn

class Own(nn.Module):
    made = []

    def __init__(self, inputs, *, units: int = 3, slope: float = 0.5, name: str = "x", open: bool = True, free=None):
        super().__init__()
        self.given = (inputs, units, slope, name, open, free)

class Any(nn.Module):
    def __init__(self, **options):
        super().__init__()
        self.options = options

class Needy(nn.Module):
    def __init__(self, inputs, joints):
        super().__init__()

class Other:
    def __init__(self, inputs):
        raise SystemExit("ran")
"""


@pytest.fixture
def own(tmp_path: Path) -> str:
    (tmp_path / "own.py").write_text(OWN)
    return f"{tmp_path / 'own.py'}"


def test_a_class_of_a_file_gets_its_options(own: str) -> None:
    assert build(f"{own}:Own", {}, {"units": 7, "slope": 1}, "here", nn.Module, inputs=2).given[:3] == (2, 7, 1)
    assert build(f"{own}:Any", {}, {"whatever": 1}, "here", nn.Module, inputs=2).options == {"inputs": 2, "whatever": 1}


def test_a_module_and_a_builtin_are_found() -> None:
    assert find_class("torch.nn:Linear", {}, "here") is nn.Linear
    assert find_class("line", {"line": "torch.nn:Linear"}, "here") is nn.Linear


def test_options_of_a_class_that_takes_any() -> None:
    assert options_of(nn.Identity) is None
    assert list(options_of(nn.LeakyReLU)) == ["negative_slope", "inplace"]


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("Own", {"unit": 3}, "here.unit: .*takes no such option. Did you mean 'units'"),
        ("Own", {"units": "many"}, "here.units='many': expected a number"),
        ("Own", {"slope": True}, "here.slope=True: expected a number"),
        ("Own", {"name": 3}, "here.name=3: expected text"),
        ("Own", {"open": 1}, "here.open=1: expected true or false"),
        ("Needy", {}, "needs the option 'joints'"),
        ("Owl", {}, "no class 'Owl' there. Did you mean 'Own'"),
        ("nn", {}, "no class 'nn'"),
    ],
)
def test_what_does_not_fit_is_named(own: str, name: str, options: dict, says: str) -> None:
    with pytest.raises(UserError, match=says):
        build(f"{own}:{name}", {}, options, "here", nn.Module, inputs=2)


def test_what_is_of_another_kind_is_never_made(own: str) -> None:
    """A settings file could otherwise start anything that a class of Python starts when it is made."""
    for use in (f"{own}:Other", "subprocess:Popen"):
        with pytest.raises(UserError, match="is not a subclass of"):
            build(use, {}, {}, "here", nn.Module, inputs=["true"])


@pytest.mark.parametrize(
    ("use", "says"),
    [
        ("own", "no such built-in"),
        ("own.py:Own", "no file"),
        ("nothing_such:Own", "cannot import 'nothing_such'"),
        (":Own", "cannot import"),
        ("..:Own", "cannot import"),
        ("torch.nn:", "no class ''"),
    ],
)
def test_what_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, use: str, says: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=says):
        find_class(use, {"mine": "torch.nn:Linear"}, "here")


def test_no_built_in_is_promised_where_there_is_none() -> None:
    with pytest.raises(UserError, match=r"here='own': expected file\.py:Class or package\.module:Class"):
        find_class("own", {}, "here")


@pytest.mark.parametrize("content", ["1/0", "def", "import nothing_such", "import sys; sys.exit(0)", "\x00"])
def test_a_file_that_does_not_run_is_named_every_time(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.py"
    path.write_text(content)
    for _ in range(2):
        with pytest.raises(UserError, match="bad.py does not run"):
            find_class(f"{path}:X", {}, "here")


def test_a_module_that_breaks_while_imported_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "breaks_on_import.py").write_text("1/0")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match="ZeroDivisionError"):
        find_class("breaks_on_import:X", {}, "here")
