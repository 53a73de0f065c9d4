"""Every module of the package can be imported, and every global name that its functions use exists."""

from __future__ import annotations

import builtins
import dis
import importlib
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

import uplift

ROOT = Path(uplift.__file__).parent
MODULES = [
    ".".join(("uplift", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
    for path in sorted(ROOT.rglob("*.py"))
    if path.stem != "__main__" and path.parent.name != "assets"  # programs for the Python of others
]


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield a code object and all those inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)


# The linter cannot check this: it would take the shapes in annotations for names.
@pytest.mark.parametrize("name", MODULES)
def test_every_name_exists(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__file__ is not None
    whole = compile(Path(module.__file__).read_text(), module.__file__, "exec")
    used = {
        step.argval
        for code in codes(whole)
        for step in dis.get_instructions(code)
        if step.opname == "LOAD_GLOBAL" and code is not whole
    }
    assert {word for word in used if not hasattr(module, word) and not hasattr(builtins, word)} == set()


@pytest.mark.parametrize("name", MODULES)
def test_every_exported_name_exists(name: str) -> None:
    module = importlib.import_module(name)
    assert [word for word in getattr(module, "__all__", ()) if not hasattr(module, word)] == []
