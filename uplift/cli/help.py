"""``--help``: what a verb takes, or one of its groups, settings, priors or networks, from where each is defined."""

from __future__ import annotations

import inspect
import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any, NoReturn

from uplift.cli.verbs import NEEDED, VERBS, sub_verbs
from uplift.config.settings import PRIOR_SETTINGS, TRAINER_FLAGS, Setting, all_groups
from uplift.errors import UserError, did_you_mean

__all__ = ["bold_names", "help_text", "option_settings", "overview", "topics", "value_text"]

_INDENT = 2
_CLASSES = {"lifter.network": "lifter.options", "student.network": "student.options", "data.use": "data.options"}
"""Settings that name a class, and those that hold its options."""


def help_text(words: Sequence[str]) -> str:
    """Return the help that ``uplift ... --help ...`` asks for.

    Words after ``--help`` are topics. A ``task=`` of fit gives the defaults.

    Raises UserError: an unknown topic, with the nearest; an invalid task.
    """
    at = next(place for place, word in enumerate(words) if word in ("--help", "-h"))
    before, after = list(words[:at]), list(words[at + 1 :])
    given = [word for word in (*before[1:], *after) if "=" in word]
    asked = [word for word in after if "=" not in word and not word.startswith("-")]
    if not before:
        return overview()
    verb, plain = before[0], [word for word in before[1:] if "=" not in word]
    below = sub_verbs(verb)
    if below:
        name, *_ = *plain, *asked, ""
        if name not in below:
            return _several(verb) if not name else _unknown(name, below, f"uplift {verb}")
        asked, verb = [word for word in asked if word != name], f"{verb} {name}"
    table = {one.name: one for one in _with_task(verb, given)} if given else dict(VERBS[verb].settings)
    if not asked:
        return _lines(_whole(verb, table, given))
    return "\n\n".join(_lines(_topic(verb, table, topic.rstrip("."))) for topic in asked)


def bold_names(text: str) -> str:
    """Return a help text with the names of its entries in bold, for a terminal."""
    return re.sub(r"^(  )(\S+)(?=  |$)", "\\1\033[1m\\2\033[0m", text, flags=re.M)


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(line.rstrip() for line in lines)


def _unknown(topic: str, valid: Iterable[str], verb: str) -> NoReturn:
    raise UserError(f"{verb} --help {topic}: there is no '{topic}'.{did_you_mean(topic, valid)}")


# The verbs.

_EXAMPLES = """examples:
  uplift fit task=demo                                  no data needed
  uplift fit task=cmu trainer.max_time=00:04:00         any setting as key=value
  uplift fit skeleton=beetle.yaml data.train=beetle.npz your own data
  uplift fit task=masks_demo                            shapes, no data needed
  uplift data check task=cmu                            what data is there
  uplift evaluate run=runs/cmu/last
  uplift predict run=person input=walk.mp4 output=poses.html
"""


def overview() -> str:
    """Return the help of the program: its verbs, and examples."""
    wide = max(map(len, VERBS)) + _INDENT
    return _lines(
        [
            "usage: uplift VERB [key=value ...]",
            "",
            "Lift 2D keypoints or masks of anything to 3D, learning from 2D alone.",
            "",
            "verbs:",
            *(_row(name, one.about, wide) for name, one in VERBS.items()),
            "",
            *_EXAMPLES.splitlines(),
            "",
            "uplift VERB --help lists the settings of a verb; uplift --version.",
            "-q or --quiet with any verb: only warnings, errors, and what was written.",
        ]
    )


def _several(verb: str) -> str:
    below = sub_verbs(verb)
    return _lines(
        [
            *_usage(form for one in below.values() for form in one.usage),
            "",
            *(_row(name, one.about, max(map(len, below)) + _INDENT) for name, one in below.items()),
            "",
            f"uplift {verb} {next(iter(below))} --help lists its settings.",
        ]
    )


def _usage(forms: Iterable[str]) -> list[str]:
    return [f"{'usage:' if not place else '      '} uplift {form}" for place, form in enumerate(forms)]


def _whole(verb: str, table: Mapping[str, Setting], given: Sequence[str]) -> Iterator[str]:
    """Yield the help of a verb: usage, words, and all settings."""
    one = VERBS[verb]
    yield from [*_usage(one.usage), "", one.about[:1].upper() + one.about[1:] + "."]
    if one.words:
        yield from ["", *(_row(name, about, len(name) + _INDENT) for name, about in one.words.items())]
    if verb in ("fit", "data check"):
        yield from _fit_whole(verb, table, given)
        return
    for lifts, title in ((None, "settings:"), ("keypoints", "of keypoints alone:"), ("masks", "of masks alone:")):
        chosen = [setting._replace(only=None) for setting in table.values() if setting.only == lifts]
        if chosen:
            yield from ["", title, *_entries(chosen, _name_width(table.values()))]


# Settings as entries: the name and what it is, and below that what it accepts.


def _width() -> int:
    return min(max(shutil.get_terminal_size((80, 24)).columns, 60), 100)


def _row(name: str, text: str, wide: int) -> str:
    """Return a name and its text, wrapped beside it."""
    start = " " * _INDENT + name.ljust(wide)
    first = [start] if len(name) < wide else [start.rstrip()]
    lines = textwrap.wrap(text, _width() - wide - _INDENT, break_on_hyphens=False) or [""]
    if len(name) < wide:
        first, lines = [start + lines[0]], lines[1:]
    return "\n".join([*first, *(" " * (wide + _INDENT) + line for line in lines)])


def _name_width(settings: Iterable[Setting]) -> int:
    return min(max((len(one.name) for one in settings), default=0) + _INDENT, 30)


def _entries(settings: Iterable[Setting], wide: int | None = None) -> Iterator[str]:
    """Yield an entry for each setting."""
    settings = list(settings)
    wide = wide or _name_width(settings)
    for one in settings:
        about = re.sub(r"(?<!\.)\.$", "", _plain(one.help.removeprefix(f"{','.join(one.parts)}: ")))
        if about:
            yield _row(one.name, about, wide)
        yield _row("" if about else one.name, f"[{_facts(one)}]", wide)


def _facts(one: Setting) -> str:
    """Return type, range or choices, and default."""
    accepts = "" if one.kind is Any else one.accepts.removeprefix("a ")
    shown = value_text(one.default)
    default = f"default {shown}" if shown else "unset" if one.default is None else ""
    default = "needed" if one.default is NEEDED else default
    return "; ".join(part for part in (accepts, default, f"{one.only} only" if one.only else "") if part)


def value_text(value: Any) -> str:
    """Return a value as it is written after ``key=``; nothing for None and what is empty."""
    if value is None or value in ("", [], (), {}):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return ",".join(map(value_text, value))
    if isinstance(value, dict) and all(isinstance(inner, dict) for inner in value.values()):
        return ", ".join(value)
    if isinstance(value, dict):
        return " ".join(f"{key}={value_text(inner)}" for key, inner in value.items())
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _plain(text: str) -> str:
    """Return a docstring's text without its markup."""
    return re.sub(r"`+", "", text)


# fit: groups, and the defaults of a task.


def _with_task(verb: str, given: Sequence[str]) -> list[Setting]:
    """Return the settings with what a task and other ``key=value`` words give as defaults."""
    if verb not in ("fit", "data check"):
        return list(VERBS[verb].settings.values())
    from uplift.config.loading import put_override, read_task, split_words, task_path

    _, values = split_words(given)
    plain = read_task(task_path(values["task"])) if values.get("task") else {}
    for key, value in values.items():
        if key not in ("task", "resume"):
            put_override(plain, f"{key}={value}")
    plain["task"] = values.get("task", "")
    return [one._replace(default=_found(plain, one)) for one in VERBS[verb].settings.values()]


def _found(plain: Mapping[str, Any], one: Setting) -> Any:
    value: Any = plain
    for key in one.name.split("."):
        if not isinstance(value, Mapping) or key not in value:
            return one.default
        value = value[key]
    return value


def _fit_whole(verb: str, table: Mapping[str, Setting], given: Sequence[str]) -> Iterator[str]:
    of_task = (
        f"an empty task file; uplift {verb} task=NAME --help shows those of a task, and task=default what a fit "
        "without a task starts from"
    )
    intro = (
        "Settings are key=value words; a list is a,b, nothing is null. Several values of what takes "
        "one, as seed=0..15 or lifter.options.units=128,256, are a sweep: a fit for each. A typo is answered with the nearest name. "
        f"Defaults are those of {' '.join(given) or of_task}."
    )
    yield from ["", *textwrap.wrap(intro, _width())]
    for group in ("", *(group for group in all_groups() if group)):
        yield from ["", *_group(group, table)]
    yield from ["", *textwrap.wrap(f"{_hint(verb)}.", _width())]


def _hint(verb: str) -> str:
    return (
        f"uplift {verb} --help GROUP shows one group: {', '.join(g for g in all_groups() if g and '.' not in g)}, "
        "priors, priors.NAME, lifter.options; also one setting, or a class of yours, file.py:Class"
    )


def _group(group: str, table: Mapping[str, Setting]) -> Iterator[str]:
    """Yield the title and the settings right below a group."""
    chosen = [one for one in table.values() if one.name.rpartition(".")[0] == group]
    only = {one.only for one in chosen}
    about = _plain(all_groups()[group])
    about = about[:1].lower() + about[1:]
    aside = re.search(r" \([^()]*\)$", about)
    chosen = [one._replace(help=one.help.removesuffix(aside[0] if aside else "")) for one in chosen]
    tag = f" ({only.copy().pop()} only)" if len(only) == 1 and None not in only else ""
    yield from textwrap.wrap(f"{group}: {about}{tag}" if group else "the fit:", _width())
    if tag:
        chosen = [one._replace(only=None) for one in chosen]
    yield from _entries(chosen, _name_width(chosen))


# One topic.


def topics(verb: str) -> list[str]:
    """Return what may follow ``--help``, without what only a class that is not loaded knows."""
    names = list(VERBS[verb].settings)
    if verb not in ("fit", "data check"):
        return names
    flags = (f"trainer.{name}" for name in TRAINER_FLAGS)
    return [*(group for group in all_groups() if group), *names, *flags]


def _topic(verb: str, table: Mapping[str, Setting], topic: str) -> Iterator[str]:
    """Yield the help of one setting, group or class."""
    holders = {*_CLASSES, *_CLASSES.values(), "student.last_options"}
    if verb not in ("fit", "data check"):
        yield from _entries([table[topic] if topic in table else _unknown(topic, table, f"uplift {verb}")])
    elif ":" in topic:
        yield from _own_class(topic)
    elif topic == "priors" or topic.startswith("priors."):
        yield from _priors(topic, table)
    elif topic.partition(".")[0] in ("callbacks", "loggers"):
        yield from _of_lightning(topic, table)
    elif topic == "trainer.flags" or topic.removeprefix("trainer.") in TRAINER_FLAGS:
        yield from _flags(topic)
    elif topic in holders or topic.rpartition(".")[0] in holders:
        yield from _entries(table[name] for name in (topic, topic.rpartition(".")[0]) if name in table)
        options = _CLASSES.get(topic, topic if topic in table else topic.rpartition(".")[0])
        yield from _classes(options)
    elif topic in table:
        yield from _entries([table[topic]])
    elif topic in all_groups():
        below = [group for group in all_groups() if group == topic or group.startswith(f"{topic}.")]
        for place, group in enumerate(below):
            yield from [*[""][:place], *_group(group, table)]
    else:
        _unknown(topic, [*topics(verb), *_prior_names()], f"uplift {verb}")


def _prior_names() -> list[str]:
    from uplift.priors import PRIORS

    return ["priors", *(f"priors.{name}" for name in PRIORS)]


# Classes: priors, networks and data sets describe their options in __init__ and in their docstring.


def option_settings(found: type, skip: Sequence[str] = ()) -> list[Setting]:
    """Return the options that a class takes as settings, described by the ``Args`` of its docstring."""
    about = _arguments(inspect.getdoc(found) or "") | _arguments(inspect.getdoc(found.__init__) or "")
    return [
        Setting(name, _kind(one), NEEDED if one.default is one.empty else one.default, about.get(name, ""), None, None, (), None)
        for name, one in inspect.signature(found).parameters.items()
        if name not in skip and one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)
    ]  # fmt: skip


def _kind(one: inspect.Parameter) -> Any:
    """Return the type of an option: that of its default, which is what is checked."""
    if type(one.default) in (bool, int, float, str):
        return type(one.default)
    named = {"bool": bool, "int": int, "float": float, "str": str}
    annotation = str(one.annotation).removesuffix(" | None")
    listed = isinstance(one.default, (list, tuple)) and all(isinstance(part, str) for part in one.default)
    return named.get(annotation, list[str] if listed and "str" in annotation else Any)


def _arguments(doc: str) -> dict[str, str]:
    """Return the entries of the ``Args`` of a docstring, each in one line."""
    section = re.search(r"^Args:\n((?:[ \t]+\S.*\n?|\n)+)", doc, re.M)
    found: dict[str, str] = {}
    names: list[str] = []
    for line in textwrap.dedent(section[1]).splitlines() if section else ():
        entry = re.match(r"(\w[\w, ]*)(?: \([^)]*\))?: *(.*)", line)
        if entry:
            names = [name.strip() for name in entry[1].split(",")]
        for name in names if line.strip() else ():
            found[name] = f"{found.get(name, '')} {entry[2] if entry else line.strip()}".strip()
    return found


def _description(found: type) -> list[str]:
    """Return the paragraphs of a class's docstring above its sections."""
    doc = inspect.getdoc(found) if found.__doc__ else ""
    paragraphs = (
        re.split(r"^(?:(?:Args|Raises|Example)\b.*:|Parameters$)", doc or "", maxsplit=1, flags=re.M)[0]
        .strip()
        .split("\n\n")
    )
    return [_plain(" ".join(paragraph.split())) for paragraph in paragraphs]


def _class_help(
    title: str, found: type, skip: Sequence[str], prefix: str = "", more: Iterable[Setting] = ()
) -> Iterator[str]:
    """Yield what a class is and takes."""
    first, *others = _description(found)
    yield from textwrap.wrap(f"{title}: {first}" if first else title, _width())
    for paragraph in others:
        yield from ["", *textwrap.wrap(paragraph, _width())]
    options = [*option_settings(found, skip), *more]
    named = [one._replace(name=prefix + one.name) for one in options]
    yield from ["", *_entries(named)] if named else ["", "  no options"]
    for one in inspect.signature(found).parameters.values():
        if one.kind is one.VAR_KEYWORD:
            yield from ["", f"and any other option (**{one.name})"]


def _priors(topic: str, table: Mapping[str, Setting]) -> Iterator[str]:
    from uplift.config.plugins import find_class
    from uplift.priors import PRIORS

    _, _, below = topic.partition(".")
    name, _, option = below.partition(".")
    in_task = table["priors"].default or {}
    if not name:
        yield from _all_priors(PRIORS, in_task)
        return
    spec = in_task.get(name) or {}
    use = str(spec.get("use", name))
    if use not in PRIORS and ":" not in use:
        _unknown(topic, [*_prior_names(), *(f"priors.{one}" for one in in_task)], "uplift fit")
    found, more = find_class(use, PRIORS, f"priors.{name}"), list(PRIOR_SETTINGS.values())
    if option:
        every = {one.name: one for one in (*option_settings(found, ("skeleton",)), *more)}
        one = every[option] if option in every else _unknown(topic, (f"priors.{name}.{o}" for o in every), "uplift fit")
        yield from _entries([one._replace(name=topic)])
        return
    yield from _class_help(f"priors.{name}", found, ("skeleton",), f"priors.{name}.", more)
    if spec:
        yield from ["", f"  in this fit: {value_text(spec)}"]


def _all_priors(priors: Mapping[str, str], in_task: Mapping[str, Any]) -> Iterator[str]:
    from uplift.config.plugins import find_class

    found = {name: find_class(name, priors, "priors") for name in priors}
    for judges, title in (
        ("poses", "priors of poses (lifts=keypoints):"),
        ("shapes", "priors of shapes (lifts=masks):"),
    ):
        chosen = {name: one for name, one in found.items() if one.judges == judges}
        yield from [
            title,
            *(_row(name, _description(one)[0], max(map(len, found)) + _INDENT) for name, one in chosen.items()),
            "",
        ]
    yield "each takes its own options (uplift fit --help priors.NAME), and:"
    yield from _entries([one._replace(name=f"priors.NAME.{one.name}") for one in PRIOR_SETTINGS.values()])
    if in_task:
        yield from [
            "",
            "in this fit:",
            *(_row(name, value_text(spec) or "weight=1", 16) for name, spec in in_task.items()),
        ]
    yield from ["", "A prior of your own: priors.NAME.use=file.py:Class (docs/priors.md)."]


def _classes(options: str) -> Iterator[str]:
    """Yield the networks, or the readers of published data sets, that ``options`` go to."""
    from uplift.config.plugins import find_class

    if options.startswith("data."):
        from uplift.data.datasets import DATA_SETS as classes

        given, title = ("folder",), "data.use={}"
    else:
        from uplift.models.networks import NETWORKS as classes

        given, title = ("inputs", "outputs"), "the network {}"
    for name in classes:
        found = find_class(name, classes, options)
        yield from ["", *_class_help(title.format(name), found, given, f"{options}.")]


def _of_lightning(topic: str, table: Mapping[str, Setting]) -> Iterator[str]:
    """Yield the callbacks or loggers there are, or the options of one."""
    from uplift.config.plugins import find_class
    from uplift.training.stages import CALLBACKS, LOGGERS

    group, _, name = topic.partition(".")
    builtin = CALLBACKS if group == "callbacks" else LOGGERS
    if not name:
        yield from _entries([table[group]])
        yield from ["", *textwrap.wrap(f"Lightning's: {', '.join(builtin)}.", _width())]
        hint = f"Options of one: uplift fit --help {group}.NAME. Your own: {group}.NAME.use=file.py:Class (docs/lightning.md)."
        yield from textwrap.wrap(hint, _width())
        return
    if name not in builtin:
        _unknown(topic, (f"{group}.{one}" for one in builtin), "uplift fit")
    found = find_class(name, builtin, topic)
    yield from [*textwrap.wrap(f"{topic}: {_description(found)[0]}", _width()), ""]
    yield from _entries(_in_short(one, f"{topic}.") for one in option_settings(found)) or ["  no options"]


def _flags(topic: str) -> Iterator[str]:
    """Yield one flag of Lightning's Trainer, or all that a fit takes beside its settings."""
    from lightning import Trainer

    wanted = TRAINER_FLAGS if topic == "trainer.flags" else [topic.removeprefix("trainer.")]
    if topic == "trainer.flags":
        yield from ["flags of Lightning's Trainer that every stage is given, as Lightning describes them", ""]
    found = {one.name: one for one in option_settings(Trainer)}
    yield from _entries([_in_short(found[name], "trainer.") for name in wanted])


def _in_short(one: Setting, prefix: str) -> Setting:
    """Return an option of a class of Lightning's with the first sentence of its description."""
    return one._replace(name=prefix + one.name, help=re.split(r"\.(?= |$)", _plain(one.help))[0])


def _own_class(use: str) -> Iterator[str]:
    """Yield the help of a class of the user's, of any kind that a fit takes."""
    from uplift.config.plugins import find_class

    found = find_class(use, {}, "--help")
    for name, title, given, prefix, more in _KINDS_OF_CLASSES:
        module, _, kind = name.partition(":")
        if issubclass(found, getattr(import_module(module), kind)):
            yield from _class_help(f"{use}, {title}", found, given, prefix, more)
            return
    titles = ", ".join(title for _, title, *_ in _KINDS_OF_CLASSES)
    raise UserError(f"--help {use}: expected {titles}; {found.__name__} is none of them.")


_KINDS_OF_CLASSES: tuple[tuple[str, str, tuple[str, ...], str, Iterable[Setting]], ...] = (
    ("uplift.priors:Prior", "a prior", ("skeleton",), "priors.NAME.", tuple(PRIOR_SETTINGS.values())),
    ("uplift.training.student:StudentLoss", "a student's loss", ("skeleton",), "student.loss_options.", ()),
    ("uplift.training.views:Views", "views", ("skeleton",), "views.options.", ()),
    ("uplift.training.base:TrainingModule", "a module", ("skeleton",), "", ()),
    ("uplift.data.datasets:DataSet", "a data set", ("folder",), "data.options.", ()),
    ("uplift.data.formats.own:OwnFormat", "a file format", (), "", ()),
    ("lightning:Callback", "a callback", (), "callbacks.NAME.", ()),
    ("lightning.pytorch.loggers:Logger", "a logger", ("save_dir", "name", "version"), "loggers.NAME.", ()),
    ("torch.nn:Module", "a network", ("inputs", "outputs"), "lifter.options.", ()),
)
"""Base classes with what a class of theirs is, the arguments that it is given, and where its options are set."""
