# PYTHON_ARGCOMPLETE_OK
"""The command line: ``uplift VERB key=value ...``. Heavy imports wait for the verb that needs them."""

from __future__ import annotations

import argparse
import functools
import os
import shlex
import sys
import typing
from collections.abc import Callable, Sequence
from typing import NoReturn

from uplift import __version__
from uplift.cli.failures import clear_output, status_of
from uplift.cli.help import bold_names, help_text, topics
from uplift.cli.kinds import Later
from uplift.cli.verbs import VERBS, sub_verbs
from uplift.config.settings import TRAINER_FLAGS, Setting
from uplift.config.trust import consent_of, granted
from uplift.errors import UserError, nearest

__all__ = ["main"]

_QUIET = ("--quiet", "-q")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0, 2 for a user's mistake or missing data, 1 for other errors, 130 for Ctrl-C."""
    words = _folded(arguments)
    with clear_output():
        try:
            words, trust = _without_trust(words)
            help_wanted = _asks_for_help(words)
            # Words without a key may be names of files, which a shell found for a pattern: no consent.
            with granted(consent_of([word for word in words if help_wanted or "=" in word], trust)):
                return _run(words)
        except (Exception, KeyboardInterrupt) as error:
            return status_of(error, words)


def _run(words: list[str]) -> int:
    parser = _parser()
    if _asks_for_help(words):
        text = help_text(words or ["--help"])
        print(bold_names(text) if sys.stdout.isatty() and "NO_COLOR" not in os.environ else text)
        return 0
    if words[0] not in (*_RUN, *_QUIET, "--version"):
        raise UserError(
            f"no command '{words[0]}'.{nearest(words[0], _RUN)} There are {', '.join(_RUN)}. (uplift --help)"
        )
    given = parser.parse_args(words)
    with Later("uplift.config.progress:quiet")(given.quiet):
        return _RUN[given.verb](given.settings) or 0


def _without_trust(words: list[str]) -> tuple[list[str], list[str]]:
    """Return the words without those of ``trust=``, where the verb takes it, and its values."""
    verb = next((name for name in (" ".join(words[:2]), *words[:1]) if name in VERBS), "")
    if not verb or "trust" not in VERBS[verb].settings:
        return words, []
    found = [word.removeprefix("trust=") for word in words if word.startswith("trust=")]
    if "" in found:
        raise UserError(f"{verb}: 'trust=' has no value. Expected trust=FILE.py.")
    return [word for word in words if not word.startswith("trust=")], found


def _asks_for_help(words: Sequence[str]) -> bool:
    """Return whether the words are to be answered with help: none, or ``--help`` of the program or of a verb."""
    return not words or (bool({"--help", "-h"} & set(words)) and words[0] in (*_RUN, "--help", "-h"))


def _folded(arguments: Sequence[str] | None) -> list[str]:
    """Return the words with ``--trust FILE``, and ``--from FILE`` of skeleton new, as ``trust=FILE`` and ``from=FILE``.

    ``--quiet`` comes last: argparse takes no words after an option.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    words = [word for word in given if word not in _QUIET]
    if len(words) < len(given):
        words.append(_QUIET[0])
    for option in ("trust", "from") if words[:1] == ["skeleton"] else ("trust",):
        words = [word[2:] if word.startswith(f"--{option}=") else word for word in words]
        while f"--{option}" in words:
            at = words.index(f"--{option}")
            words[at : at + 2] = [f"{option}={''.join(words[at + 1 : at + 2])}"]
    return words


class _Parser(argparse.ArgumentParser):
    """Says what is wrong as everything else does."""

    def error(self, message: str) -> NoReturn:
        """Raise UserError."""
        raise UserError(f"{message}. Settings are key=value words. ({self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="uplift", usage="uplift VERB [key=value ...] (uplift --help)", add_help=False)
    parser.add_argument("--version", action="version", version=f"uplift {__version__}")
    parser.add_argument("--help", "-h", action="store_true")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for verb in _RUN:
        sub = verbs.add_parser(verb, usage=f"uplift {verb} [key=value ...] (uplift {verb} --help)", add_help=False)
        sub.add_argument("--help", "-h", action="store_true")
        sub.add_argument(*_QUIET, action="store_true")
        words = sub.add_argument("settings", nargs="*")
        words.completer = functools.partial(_complete, verb)  # type: ignore[attr-defined]
    try:
        import argcomplete

        argcomplete.autocomplete(parser)
    except ImportError:
        pass
    return parser


def _complete(verb: str, prefix: str, **rest: object) -> list[str]:
    """Return the words that may follow ``uplift VERB``: names of settings, or the values of one."""
    below, typed = sub_verbs(verb), os.environ.get("COMP_LINE", "").split()
    action = next((word for word in typed if word in below), None)
    if below and action is None:
        return list(below)
    name = f"{verb} {action}" if action else verb
    if {"--help", "-h"} & set(typed):
        return topics(name)
    if verb == "lifters":
        return _ready()
    key, equals, _ = prefix.partition("=")
    known = {one.name: one for one in VERBS[name].settings.values() if typing.get_origin(one.kind) is not dict}
    if not equals:
        flags = [f"trainer.{flag}" for flag in TRAINER_FLAGS] if name == "fit" else []
        return [f"{key}=" for key in (*known, *flags)]
    return [f"{key}={value}" for value in (_values(known[key]) if key in known else ())]


def _values(setting: Setting) -> list[str]:
    """Return the values that a setting is completed with; none where they are not a few."""
    if setting.name in ("task", "skeleton", "layout", "data.layout"):
        from uplift.config.files import shipped_names

        return [name for name in shipped_names("tasks" if setting.name == "task" else "skeletons") if name != "default"]
    if setting.name == "run":
        return _ready()
    return list(setting.choices) or (["true", "false"] if setting.kind is bool else [])


def _ready() -> list[str]:
    """Return the names of the ready lifters."""
    from uplift.config.files import shipped_names

    return shipped_names("lifters")


def _fit(words: Sequence[str]) -> int:
    from uplift.config.grid import split_grid
    from uplift.config.loading import load_settings, split_words, trust_of
    from uplift.config.run import RunFolder, is_sweep

    plain, given = split_words(words)
    for key, expected in (("task", "TASK"), ("resume", "RUN")):
        if key in plain or given.get(key) == "":
            raise UserError(f"fit: '{key}=' has no value. Expected {key}={expected}.")
    task, resume = given.get("task"), given.get("resume")
    overrides = [word for word in words if word.partition("=")[0] not in ("task", "resume")]
    # A typo answers before torch is imported.
    plain, several = ([], []) if resume else split_grid(overrides)
    if several or (resume and is_sweep(resume)):
        return _sweep(task, resume, overrides, words)
    wanted = None if resume else load_settings(task, plain)
    from uplift.cli.fit import fit, fit_settings
    from uplift.training.callbacks import Interrupted

    try:
        if wanted is None:
            fit(task, *overrides, resume=resume)
        else:
            fit_settings(wanted)
    except Interrupted as stopped:
        more = f"resume={stopped}{trust_of(RunFolder.open(str(stopped)).settings())}"
        print(f"\nstopped and saved. Go on with: uplift fit {more}", file=sys.stderr)
        raise KeyboardInterrupt from stopped
    return 0


def _sweep(task: str | None, resume: str | None, overrides: Sequence[str], words: Sequence[str]) -> int:
    from uplift.cli.sweep.command import resume_sweep, start_sweep

    if resume:
        found = resume_sweep(resume, [f"task={task}", *overrides] if task else overrides)
    else:
        found = start_sweep(task, overrides, shlex.join(["uplift", "fit", *words]))
    return 1 if found.failed() else 0


def _list(verb: str, function: str) -> Callable[[Sequence[str]], None]:
    def run(words: Sequence[str]) -> None:
        if words:
            raise UserError(f"{verb} takes no settings, found '{words[0]}'.")
        print(Later(function)())

    return run


_ANSWERS = ("data_check:check_data", "skeleton:map_joints")
"""What is asked for what it prints, and says it even where it is to be quiet."""


def _by_first_word(functions: dict[str, str], expected: str) -> Callable[[Sequence[str]], int]:
    """Return a verb that prints the lines of the function that its first word names."""

    def run(words: Sequence[str]) -> int:
        if not words or words[0] not in functions:
            raise UserError(expected)
        found = Later(f"uplift.cli.{functions[words[0]]}")(list(words[1:]))
        lines, complete = found if isinstance(found, tuple) else (found, True)
        show = print if functions[words[0]] in _ANSWERS else Later("uplift.config.progress:say")
        for line in lines:
            show(line)
        return 0 if complete else 2

    return run


_RUN: dict[str, Callable[[Sequence[str]], int | None]] = {
    "fit": _fit,
    "evaluate": Later("uplift.cli.evaluate:evaluate_command"),
    "predict": Later("uplift.cli.predict_files:predict_command"),
    "detect": Later("uplift.cli.detect:detect_command"),
    "detectors": Later("uplift.cli.detect:detectors_command"),
    "simulate": Later("uplift.cli.simulate:simulate_command"),
    "compare": Later("uplift.cli.listing:compare_command"),
    "tables": Later("uplift.cli.tables:tables_command"),
    "data": _by_first_word(
        {
            "check": "data_check:check_data",
            "cmu": "data_cmu:make_cmu_files",
            "render": "data_render:render_masks_command",
            "shard": "data_shard:shard_command",
        },
        "data: expected `uplift data check task=NAME`, `uplift data cmu FOLDER`, "
        "`uplift data render MESHES output=FILE.npz` or `uplift data shard FILES output=FOLDER`.",
    ),
    "tasks": _list("tasks", "uplift.cli.listing:list_tasks"),
    "skeletons": _list("skeletons", "uplift.cli.listing:list_skeletons"),
    "lifters": Later("uplift.cli.lifters:lifters_command"),
    "skeleton": _by_first_word(
        {"check": "skeleton:check_skeleton_file", "new": "skeleton:new_skeleton_file", "map": "skeleton:map_joints"},
        "skeleton: expected `uplift skeleton check FILE [output=FILE.png]`, `uplift skeleton new FILE "
        "[--from TRACKER_FILE]` or `uplift skeleton map TRACKER_FILE skeleton=NAME`.",
    ),
    "schema": _by_first_word(
        {"task": "schema:write_task_schema", "skeleton": "schema:write_skeleton_schema"},
        "schema: expected `uplift schema task` or `uplift schema skeleton`.",
    ),
}

if __name__ == "__main__":
    sys.exit(main())
