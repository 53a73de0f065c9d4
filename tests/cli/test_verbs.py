"""The tables of the verbs' settings: what they list is what is accepted, with the defaults of the code behind them."""

from __future__ import annotations

import inspect
import math
import typing
from dataclasses import MISSING, fields, is_dataclass

import pytest

from uplift.cli.evaluate import MOST, evaluate
from uplift.cli.kinds import KINDS
from uplift.cli.parsing import checked, keyed
from uplift.cli.predict import predict
from uplift.cli.simulate import _TRACKERS, simulate
from uplift.cli.verbs import EVALUATE, NEEDED, POSE_KEYS, PREDICT, READ_KEYS, SHAPE_KEYS, SIMULATE, VERBS
from uplift.config.settings import Setting, all_settings
from uplift.data.clean_masks import MaskOptions
from uplift.data.datasets.cmu import Rates, Rig
from uplift.data.formats.base import ReadOptions
from uplift.data.parsers.meshes import _AXES, MeshOptions
from uplift.data.synthetic.masks import ViewChoice
from uplift.data.synthetic.simulate import simulate as simulate_body
from uplift.errors import UserError
from uplift.export import PAGES
from uplift.export.gallery import _MOST_FRAMES, check_options
from uplift.export.meshes import _UNITS, SHAPE_AXES, shape_jobs
from uplift.export.scene import AXES

OWN_TABLES = {
    name: verb.settings for name, verb in VERBS.items() if verb.settings and name not in ("fit", "data check")
}
EVERY = [(verb, one) for verb, table in OWN_TABLES.items() for one in table.values()]
IDS = [f"{verb} {one.name}" for verb, one in EVERY]


def words_for(verb: str, key: str, value: str) -> list[str]:
    """Return words with all that the verb needs, and ``key=value``."""
    table = OWN_TABLES[verb]
    needed = [f"{name}=x" for name, one in table.items() if one.default is NEEDED and name != key]
    return [*(["x"] * bool(VERBS[verb].words)), *needed, f"{key}={value}"]


def valid_text(setting: Setting) -> str:
    if setting.choices:
        return setting.choices[-1]
    if setting.kind is str:
        return "text"
    if setting.kind is bool:
        return "true"
    if setting.kind in (int, float):
        return str(setting.low)
    return "1,2" if setting.low is None else ",".join(map(str, setting.default))


@pytest.mark.parametrize(("verb", "setting"), EVERY, ids=IDS)
def test_every_listed_setting_is_accepted_in_its_range(verb: str, setting: Setting) -> None:
    if typing.get_origin(setting.kind) is dict:
        name = f"{setting.name}.fps"
        assert keyed(verb, words_for(verb, name, "25"))[name] == "25"
        return
    text = valid_text(setting)
    keys = keyed(verb, words_for(verb, setting.name, text))
    assert keys[setting.name] == text
    assert keys.value(setting.name) == checked(setting, text, verb)
    for beyond in beyond_limits(setting):
        with pytest.raises(UserError, match=r"expected"):
            keyed(verb, words_for(verb, setting.name, beyond)).value(setting.name)


def beyond_limits(setting: Setting) -> list[str]:
    if setting.choices:
        return ["something else"]
    if setting.kind in (int, float):
        high = [str(setting.high * 2)] if setting.high < math.inf else []
        return [str(setting.low - 1), "many", "nan", *high, *(["1.5"] if setting.kind is int else [])]
    if setting.low is None:
        return []
    if typing.get_origin(setting.kind) is list:
        return [str(setting.low - 1), f"1,{setting.high + 1}", "1,1.5", "a,b"]
    low = setting.low[0] if isinstance(setting.low, tuple) else setting.low
    return ["1", "1,2,3", f"{low - 1},5", "nan,5", "a,b"]


@pytest.mark.parametrize(("verb", "setting"), EVERY, ids=IDS)
def test_every_setting_has_a_line_and_a_default_that_it_accepts(verb: str, setting: Setting) -> None:
    assert setting.help
    assert "\n" not in setting.help
    if setting.default in (NEEDED, None, "") or setting.kind == dict[str, object]:
        return
    default = setting.default
    text = ",".join(map(str, default)) if isinstance(default, (list, tuple)) else str(default)
    if text and not isinstance(default, dict):
        assert checked(setting, text, verb) == default


def test_no_other_setting_is_accepted() -> None:
    for verb, table in OWN_TABLES.items():
        names = {name for other in OWN_TABLES.values() for name in other} | {"reading", "data.options"}
        for name in names - set(table) | {"data.options"}:
            with pytest.raises(UserError, match="is not one of its settings"):
                keyed(verb, words_for(verb, name, "1"))


@pytest.mark.parametrize("verb", [name for name, one in VERBS.items() if one.settings])
def test_what_a_verb_needs_is_asked_for(verb: str) -> None:
    for name in [name for name, one in VERBS[verb].settings.items() if one.default is NEEDED]:
        with pytest.raises(UserError, match=f"{verb} needs {name}=...: .*--help"):
            keyed(verb, [word for word in words_for(verb, "none", "") if not word.startswith((f"{name}=", "none"))])


# The code behind the verbs has the same names and defaults.


def defaults(behind: object) -> dict[str, object]:
    if is_dataclass(behind):
        return {one.name: one.default if one.default is not MISSING else None for one in fields(behind)}
    return {name: one.default for name, one in inspect.signature(behind).parameters.items()}  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("table", "behind"),
    [
        (READ_KEYS, ReadOptions),
        (SIMULATE, simulate),
        (SIMULATE, simulate_body),
        (SHAPE_KEYS, MaskOptions),
        (SHAPE_KEYS, shape_jobs),
        (POSE_KEYS, check_options),
        (VERBS["data render"].settings, MeshOptions),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_defaults_are_those_of_the_code(table: dict[str, Setting], behind: object) -> None:
    theirs = defaults(behind)
    shared = (theirs.keys() & table.keys()) - {"output", "skeleton", "category", "items"}
    assert shared
    for name in shared:
        ours = table[name].default
        assert (tuple(ours) if isinstance(ours, list) else ours) == theirs[name], name


def test_reading_keys_are_the_fields_of_the_options() -> None:
    assert list(READ_KEYS) == [one.name for one in fields(ReadOptions)]


def test_defaults_of_evaluate_and_predict() -> None:
    assert EVALUATE["items"].default == MOST
    assert inspect.signature(evaluate).parameters["items"].default is None
    assert (PREDICT["refine"].default == "on") is inspect.signature(predict).parameters["refine"].default
    assert (PREDICT["bones"].default == "constant") is inspect.signature(predict).parameters["constant_bones"].default


def test_defaults_of_data_cmu_and_render() -> None:
    cmu, render = VERBS["data cmu"].settings, VERBS["data render"].settings
    assert cmu["fps"].default == Rates.fps
    assert cmu["rate"].default == [f"{Rates.amc:g}"]
    assert cmu["image_size"].default == "x".join(map(str, Rig.image_size))
    for ours, theirs in {"cameras": "cameras", "tilt": "tilt_deg", "tilt_sd": "tilt_sd_deg", "distance": "distance_m",
                         "focal_px": "focal_px"}.items():  # fmt: skip
        assert cmu[ours].default == getattr(Rig, theirs), ours
    views = ViewChoice()
    assert render["azimuth_deg"].default == views.azimuth_deg
    assert render["elevation_deg"].default == (views.elevation_mean_deg, views.elevation_sd_deg)
    assert render["distance"].default == views.distance
    assert (render["upright"].default == "true") is views.upright


def test_choices_are_those_of_the_code() -> None:
    assert set(PREDICT["axes"].choices) == set(AXES) | set(SHAPE_AXES)
    assert set(PREDICT["page"].choices) == {page for pages in PAGES.values() for page in pages}
    assert PREDICT["unit"].choices == _UNITS
    assert SIMULATE["tracker"].choices == _TRACKERS
    assert set(VERBS["data render"].settings["up"].choices) == set(_AXES)
    assert PREDICT["frames"].high == _MOST_FRAMES
    for key in ("border", "pieces"):
        assert PREDICT[key].choices == all_settings()[f"data.{key}"].choices


def test_each_kind_of_run_has_its_own_words() -> None:
    for lifts, kind in KINDS.items():
        assert set(kind.predict_keys) == {name for name, one in PREDICT.items() if one.only == lifts}
        assert set(kind.evaluate_keys) == {name for name, one in EVALUATE.items() if one.only == lifts}


def test_fit_and_data_check_take_all_settings() -> None:
    settings = all_settings()
    for verb, more in (("fit", {"resume", "trust"}), ("data check", {"trust"})):
        table = VERBS[verb].settings
        assert set(table) == set(settings) | more
        assert all(table[name] == one for name, one in settings.items() if name != "task")
