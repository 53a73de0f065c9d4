"""The tables of settings in the documentation are those that the code gives."""

from __future__ import annotations

import pytest

from benchmarks.settings_tables import _BLOCK, pages, renewed, table
from uplift.cli.verbs import VERBS
from uplift.config.settings import all_groups

PAGES = pages()
BLOCKS = [what.split() for page in PAGES for _, what, _ in _BLOCK.findall(page.read_text())]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_as_the_code_gives_them(page) -> None:
    text = page.read_text()
    assert renewed(text) == text, "run: make docs"


def test_every_verb_and_group_has_its_table() -> None:
    fit = {group for what in BLOCKS if what[0] == "fit" for group in what[1:]}
    assert fit == {group or "." for group in all_groups()}
    shown = {" ".join(what[:2]) if " ".join(what[:2]) in VERBS else what[0] for what in BLOCKS}
    several = {"fit", "compare", "data check", "skeleton check", "schema task", "schema skeleton"}
    assert {name for name, one in VERBS.items() if one.settings} - several <= shown
    assert ["verbs"] in BLOCKS
    assert {what[1] for what in BLOCKS if what[0] == "predict"} >= {"both", "keypoints", "masks"}


def test_a_stale_table_is_noticed() -> None:
    stale = "<!-- settings: simulate -->\nold\n<!-- end -->\n"
    assert renewed(stale) != stale
    assert "| `frames=` | `20000` | whole number of at least 1 | frames |" in renewed(stale)
    assert renewed(renewed(stale)) == renewed(stale)


def test_a_name_that_is_none_is_an_error() -> None:
    with pytest.raises(SystemExit, match="there is no 'framse'"):
        table(["simulate", "framse"])
