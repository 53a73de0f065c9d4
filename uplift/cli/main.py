# PYTHON_ARGCOMPLETE_OK
"""The command line: ``uplift VERB key=value ...``. Heavy imports wait for the verb that needs them."""

from __future__ import annotations

import argparse
import errno
import sys
from collections.abc import Callable, Sequence

from uplift import __version__
from uplift.cli.kinds import Later
from uplift.cli.verbs import VERBS
from uplift.errors import UserError

__all__ = ["main"]

_VERBS = {
    "fit": "train a lifter: fit task=NAME, or fit skeleton=NAME data.train=FILE, or fit task=masks data.train=FOLDER; "
    "also resume=RUN",
    "evaluate": "every protocol: evaluate run=RUN [data.test=FILE], or evaluate poses=FILE data.test=FILE",
    "predict": "lift keypoints or masks: predict run=RUN input=FILE|FOLDER|SET:SPLIT output=FILE.html|.npz|.csv|.bvh|.glb|...",
    "simulate": "simulated bodies with exact poses: simulate skeleton=NAME output=FILE.npz|.csv [frames=20000 seed=0]",
    "compare": "runs side by side: compare RUN RUN ...",
    "data": "data check task=NAME [data.root=FOLDER]: what is there and what is missing; data cmu FOLDER; "
    "data render MESHES... output=FILE.npz|FOLDER: masks of meshes or of simulated shapes",
    "tasks": "list the tasks and whether their data is present",
    "skeletons": "list the shipped skeletons",
    "skeleton": "skeleton check FILE [output=FILE.png]; skeleton new FILE [--from TRACKER_FILE]; "
    "skeleton map TRACKER_FILE skeleton=NAME",
}
# Errors that another path fixes; a full disk is not one of these.
_FIXABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP)
_EXAMPLES = """examples:
  uplift fit task=demo                                  no data needed: a minute or two, then a page to look at
  uplift data check task=cmu                            what is there, what is missing, where it comes from
  uplift fit task=cmu trainer.max_time=00:04:00         any setting as key=value
  uplift fit skeleton=beetle.yaml data.train=beetle.npz your own data
  uplift evaluate run=runs/cmu/last
  uplift predict run=runs/cmu/last input=keypoints.npz output=poses.html
  uplift predict run=runs/mpii/last input=mpii:train output=gallery.html page=gallery
  uplift fit task=masks_demo                            shapes from masks, no data needed: ten minutes
  uplift predict run=runs/masks_demo/last input=masks output=shapes.glb
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0, 2 for a user's mistake or missing data, 1 for other errors, 130 for Ctrl-C."""
    parser = _parser()
    given = parser.parse_args(_folded(arguments))
    if given.verb is None:
        parser.print_help()
        return 0
    try:
        return _RUN[given.verb](given.settings) or 0
    except UserError as error:
        print(f"uplift: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nuplift: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 1
    except MemoryError:
        hint = "Use fewer frames or masks (data.select.fraction) or smaller batches."
        print(f"uplift: out of memory. {hint}", file=sys.stderr)
        return 1
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        fixable = error.errno in _FIXABLE
        rest = "" if fixable else " What was saved before is complete."
        print(f"uplift: {error.strerror or error}{where}.{rest}", file=sys.stderr)
        return 2 if fixable else 1


def _folded(arguments: Sequence[str] | None) -> list[str]:
    """Return the words with ``--from FILE`` of skeleton new as ``from=FILE``: argparse takes no words after an option."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["skeleton"]:
        words = [f"from={word[7:]}" if word.startswith("--from=") else word for word in words]
        while "--from" in words:
            at = words.index("--from")
            words[at : at + 2] = [f"from={''.join(words[at + 1 : at + 2])}"]
    return words


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="uplift",
        description="Lift 2D keypoints or masks of anything to 3D, learning from 2D alone.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"uplift {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB")
    for verb, text in _VERBS.items():
        sub = verbs.add_parser(verb, help=text, description=text)
        words = sub.add_argument("settings", nargs="*", metavar="key=value" if verb != "compare" else "RUN")
        words.completer = _complete(verb)  # type: ignore[attr-defined]
    try:
        import argcomplete

        argcomplete.autocomplete(parser)
    except ImportError:
        pass
    return parser


def _complete(verb: str) -> Callable[..., list[str]]:
    def complete(prefix: str, **rest: object) -> list[str]:
        from uplift.config.files import shipped_names
        from uplift.config.loading import setting_names

        if verb == "skeleton":
            keys = [f"{key}=" for key in ("from", "root", "gravity", "format", "layout")]
            return ["check", "new", "map", *(f"skeleton={name}" for name in shipped_names("skeletons")), *keys]
        if verb == "data":
            return ["check", "cmu", "render", *(f"task={name}" for name in shipped_names("tasks")), "data.root="]
        known = {key: [""] for key in _KEYS.get(verb, ())}
        if verb == "fit":
            known |= {name: [""] for name in setting_names()} | {"resume": [""]}
            known["task"] = [name for name in shipped_names("tasks") if name != "default"]
        known["skeleton"] = shipped_names("skeletons")
        return [f"{key}={value}" for key, values in known.items() for value in values]

    return complete


_KEYS = {verb: VERBS[verb].settings for verb in ("evaluate", "predict", "simulate")}


def _fit(words: Sequence[str]) -> None:
    from uplift.config.loading import load_settings, split_words

    plain, given = split_words(words)
    for key, expected in (("task", "TASK"), ("resume", "RUN")):
        if key in plain or given.get(key) == "":
            raise UserError(f"fit: '{key}=' has no value. Expected {key}={expected}.")
    task, resume = given.get("task"), given.get("resume")
    several = "," in given.get("seed", "")
    seeds = [[f"seed={seed.strip()}"] for seed in given["seed"].split(",")] if several else [[]]
    apart = ("task", "resume", *(["seed"] if several else []))
    overrides = [word for word in words if word.partition("=")[0] not in apart]
    # A typo answers before torch is imported, and before the first of several fits.
    wanted = [] if resume else [load_settings(task, [*overrides, *seed]) for seed in seeds]
    from uplift.cli.fit import fit, fit_settings
    from uplift.cli.listing import spread
    from uplift.training.callbacks import Interrupted

    runs = []
    try:
        if resume:
            fit(task, *overrides, *seeds[0], resume=resume)
        for settings in wanted:
            runs.append(fit_settings(settings))
    except Interrupted as stopped:
        print(f"\nstopped and saved. Go on with: uplift fit resume={stopped}", file=sys.stderr)
        raise KeyboardInterrupt from stopped
    if len(runs) > 1:
        print(f"\n{spread(runs)}")


def _list(verb: str, function: str) -> Callable[[Sequence[str]], None]:
    def run(words: Sequence[str]) -> None:
        if words:
            raise UserError(f"{verb} takes no settings, found '{words[0]}'.")
        print(Later(function)())

    return run


def _by_first_word(functions: dict[str, str], expected: str) -> Callable[[Sequence[str]], int]:
    """Return a verb that prints the lines of the function that its first word names."""

    def run(words: Sequence[str]) -> int:
        if not words or words[0] not in functions:
            raise UserError(expected)
        found = Later(f"uplift.cli.{functions[words[0]]}")(list(words[1:]))
        lines, complete = found if isinstance(found, tuple) else (found, True)
        for line in lines:
            print(line)
        return 0 if complete else 2

    return run


_RUN: dict[str, Callable[[Sequence[str]], int | None]] = {
    "fit": _fit,
    "evaluate": Later("uplift.cli.evaluate:evaluate_command"),
    "predict": Later("uplift.cli.predict:predict_command"),
    "simulate": Later("uplift.cli.simulate:simulate_command"),
    "compare": lambda runs: print(Later("uplift.cli.listing:compare")(runs)),
    "data": _by_first_word(
        {
            "check": "data_check:check_data",
            "cmu": "data_cmu:make_cmu_files",
            "render": "data_render:render_masks_command",
        },
        "data: expected `uplift data check task=NAME`, `uplift data cmu FOLDER` or "
        "`uplift data render MESHES output=FILE.npz`.",
    ),
    "tasks": _list("tasks", "uplift.cli.listing:list_tasks"),
    "skeletons": _list("skeletons", "uplift.cli.listing:list_skeletons"),
    "skeleton": _by_first_word(
        {"check": "skeleton:check_skeleton_file", "new": "skeleton:new_skeleton_file", "map": "skeleton:map_joints"},
        "skeleton: expected `uplift skeleton check FILE [output=FILE.png]`, `uplift skeleton new FILE "
        "[--from TRACKER_FILE]` or `uplift skeleton map TRACKER_FILE skeleton=NAME`.",
    ),
}

if __name__ == "__main__":
    sys.exit(main())
