"""The tables of settings in the documentation: ``python -m benchmarks.settings_tables`` writes them anew.

A table lies between ``<!-- settings: WHAT -->`` and ``<!-- end -->``. WHAT is a verb, with names of settings or groups
where it is not to be all; ``verbs``, a line for each verb; ``networks``, their options; or ``lifters``, the ready ones.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from uplift.cli.help import option_settings
from uplift.cli.verbs import NEEDED, VERBS
from uplift.config.plugins import find_class
from uplift.config.settings import Setting, all_groups

ROOT = Path(__file__).resolve().parent.parent
_BLOCK = re.compile(r"(<!-- settings: (.+?) -->\n).*?(<!-- end -->)", re.S)


def pages() -> list[Path]:
    """Return the pages of the documentation that hold tables of settings."""
    return [page for page in sorted((ROOT / "docs").glob("*.md")) if _BLOCK.search(page.read_text())]


def renewed(text: str) -> str:
    """Return the text of a page with its tables written anew."""
    return _BLOCK.sub(lambda found: f"{found[1]}\n{table(found[2].split())}\n\n{found[3]}", text)


def table(what: Sequence[str]) -> str:
    """Return one table of settings."""
    if what[0] == "verbs":
        rows = [
            (f"`{name}`", one.about, " ".join(f"`{form}`" for form in one.usage).replace("|", r"\|"))
            for name, one in VERBS.items()
        ]
        return _table(("verb", "what", "forms"), rows)
    if what[0] == "lifters":
        return _table(("name", "what", "joints", "error", "size", "licence"), _lifters())
    if what[0] == "networks":
        return _table(("network", "option", "default", "meaning"), _networks())
    verb = " ".join(what[:2]) if " ".join(what[:2]) in VERBS else what[0]
    wanted = list(what[len(verb.split()) :])
    chosen = _chosen(VERBS[verb].settings.values(), wanted)
    equals = "" if verb == "fit" else "="
    return _table(("setting", "default", "accepts", "meaning"), [_row(one, equals) for one in chosen])


def _chosen(settings: Iterable[Setting], wanted: Sequence[str]) -> list[Setting]:
    """Return settings by name, by group, or those that go with ``both``, ``keypoints`` or ``masks``."""
    only = {"both": None, "keypoints": "keypoints", "masks": "masks"}
    if wanted and wanted[0] in only:
        return [one._replace(only=None) for one in settings if one.only == only[wanted[0]]]
    groups = all_groups() if wanted else ()
    above = {one.name: one.name.rpartition(".")[0] or "." for one in settings}
    unknown = [name for name in wanted if name not in above and name not in groups and name != "."]
    if unknown:
        raise SystemExit(f"settings: there is no '{unknown[0]}'.")
    return [one for one in settings if not wanted or one.name in wanted or above[one.name] in wanted]


def _row(one: Setting, equals: str) -> tuple[str, ...]:
    default = "needed" if one.default is NEEDED else f"`{default_text(one.default)}`"
    only = f"; {one.only} only" if one.only else ""
    return f"`{one.name}{equals}`", default, one.accepts.removeprefix("a ") + only, _escaped(one.help)


def default_text(value: Any) -> str:
    """Return a default as YAML has it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(default_text, value))}]"
    return str(value) if value != "" else "''"


def _lifters() -> list[tuple[str, ...]]:
    from uplift.config.files import shipped, shipped_names
    from uplift.config.safe_weights import ENDING, describe_safe

    rows = []
    for name in shipped_names("lifters"):
        path = shipped("lifters") / f"{name}{ENDING}"
        found = describe_safe(path)
        skeleton, about = found["skeleton"], found["about"]
        figures = ", ".join(f"`{metric}` {value}" for metric, value in about["figures"].items())
        joints = f"{len(skeleton['joints'])} (`{skeleton['name']}`)"
        rows.append(
            (f"`{name}`", about["title"], joints, figures, f"{path.stat().st_size / 1e6:.1f} MB", about["licence"])
        )
    return rows


def _networks() -> list[tuple[str, ...]]:
    from uplift.models.networks import NETWORKS

    return [
        (f"`{name}`", f"`{one.name}`", f"`{default_text(one.default)}`", _escaped(one.help.removesuffix(".")))
        for name in NETWORKS
        for one in option_settings(find_class(name, NETWORKS, "lifter"), ("inputs", "outputs"))
    ]


def _escaped(text: str) -> str:
    return text.replace("|", r"\|").replace("<", "&lt;").replace("*", r"\*").replace("``", "`")


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    text = ["| " + " | ".join(cells) + " |" for cells in lines]
    text[1] = "|" + "---|" * len(head)
    return "\n".join(text)


def main() -> None:
    """Write all tables anew, and say which pages changed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for page in pages():
        before, after = page.read_text(), renewed(page.read_text())
        if before != after:
            page.write_text(after)
        print(f"{'wrote' if before != after else 'as it was'}: {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
