"""Wrong skeleton files: one error each, with the file, the line, what was found and what to do."""

from __future__ import annotations

import os
import re
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from uplift.errors import UserError
from uplift.skeleton import load_skeleton

LINES = [
    "name: dog",
    "joints: [body, head, rpaw, lpaw, rtoe, ltoe]",
    "root: body",
    "bones:",
    "  - [body, head]",
    "  - [body, rpaw]",
    "  - [body, lpaw]",
    "  - [rpaw, rtoe]",
    "  - [lpaw, ltoe]",
    "mirror:",
    "  - [rpaw, lpaw]",
    "  - [rtoe, ltoe]",
    "facing:",
    "  front: [body, head]",
    "  left: [rpaw, lpaw]",
    "gravity: true",
]

# name: (line that is changed, what to, line of the error, words of the message)
WRONG = {
    "unknown joint in a bone": (8, "  - [rpaw, rtoo]", 8, "'rtoo'.*not a joint.*'rtoe'"),
    "unknown root": (3, "root: bodi", 3, "'bodi'.*not a joint.*'body'"),
    "no root": (3, "", 1, "'root' is missing"),
    "no joints": (2, "", 1, "'joints' is missing"),
    "too few joints": (2, "joints: [body, head]", 2, "2 joints; expected 3"),
    "joint twice": (2, "joints: [body, head, rpaw, lpaw,\n  rtoe, ltoe, head]", 3, "joint 'head' twice"),
    "bone twice": (9, "  - [lpaw, ltoe]\n  - [rtoe, rpaw]", 10, "bone between 'rtoe' and 'rpaw' twice"),
    "bone to itself": (9, "  - [lpaw, lpaw]", 9, "'lpaw' paired with itself"),
    "bone of three": (9, "  - [lpaw, ltoe, head]", 9, "3 names.*expected a pair"),
    "cycle": (9, "  - [lpaw, ltoe]\n  - [ltoe, rtoe]", 10, "cycle.*loops: true"),
    "not connected": (9, "", 2, "no bones lead from the root 'body' to joint 'ltoe'"),
    "bones are text": (4, "bones: body-head\nrest:", 4, "text 'body-head'.*expected a list of pairs"),
    "joints are a mapping": (2, "joints: {body: 1}", 2, "found a mapping.*list of joint names"),
    "joint is a number": (2, "joints: [body, head, 7, rpaw, lpaw, rtoe, ltoe]", 2, "the number 7"),
    "joint reads as true": (2, "joints: [body, head, on, rpaw, lpaw, rtoe, ltoe]", 2, "quotes"),
    "joint has blanks": (2, "joints: [body, head, ' a', rpaw, lpaw, rtoe, ltoe]", 2, "no blanks"),
    "mirror in two pairs": (12, "  - [rtoe, lpaw]", 12, "'lpaw' in a second mirror pair"),
    "mirror with itself": (12, "  - [rtoe, rtoe]", 12, "'rtoe' paired with itself"),
    "mirror of an unknown": (12, "  - [rtoe, ltow]", 12, "'ltow'.*not a joint.*'ltoe'"),
    "mirror of one": (12, "  - [rtoe]", 12, "1 names.*expected a pair"),
    "mirror half way": (12, "", 11, r"'rtoe' and 'ltoe'.*in no pair"),
    "contact unknown": (16, "contacts: [rtoo]", 16, "'rtoo' in 'contacts'.*not a joint.*'rtoe'"),
    "contact twice": (16, "contacts: [rtoe, rtoe]", 16, "'rtoe' twice in 'contacts'"),
    "contact is the root": (16, "contacts: [body]", 16, "the root 'body' in 'contacts'"),
    "contacts without gravity": (16, "gravity: false\ncontacts: [rtoe]", 17, "gravity is false"),
    "contacts are text": (16, "contacts: rtoe", 16, "text 'rtoe'.*list of joints that stand"),
    "front from and to the same": (14, "  front: [body, body]", 14, "front.*same place"),
    "front along left": (14, "  front: [lpaw, rpaw]", 15, "'left' along front"),
    "front across": (14, "  front: [ltoe, rtoe]", 14, "'front' runs from one side"),
    "left along the middle": (15, "  left: [[rpaw, lpaw], body]", 15, "same on both sides"),
    "only one direction": (14, "", 13, "'front' is missing"),
    "direction with one end": (14, "  front: [body]", 14, "1 ends"),
    "direction to nowhere": (14, "  front: [body, []]", 14, "empty list"),
    "direction with a joint twice": (14, "  front: [body, [head, head]]", 14, "'head' twice"),
    "unknown direction": (14, "  frnot: [body, head]", 14, "'frnot'.*'front'"),
    "unknown joint in facing": (15, "  left: [rpaw, paw]", 15, "'paw'.*not a joint"),
    "unknown joint in trunk": (16, "trunk: [body, haed]", 16, "'haed' in 'trunk'.*not a joint.*'head'"),
    "trunk with one end": (16, "trunk: [body]", 16, "1 ends in 'trunk'"),
    "trunk to where it starts": (16, "trunk: [body, body]", 16, "same place"),
    "angles are a list": (16, "angles: [knee]", 16, "found a list for 'angles'.*mapping of names"),
    "angle of two joints": (16, "angles: {bend: {joints: [body, rpaw]}}", 16, "2 joints in 'bend'; expected three"),
    "angle of an unknown joint": (
        16,
        "angles: {bend: {joints: [body, rpaw, rtoo]}}",
        16,
        "'rtoo'.*not a joint.*'rtoe'",
    ),
    "angle from nowhere": (
        16,
        "angles: {bend: {segment: [body, head]}}",
        16,
        "found segment in 'bend'.*with from: or towards",
    ),
    "angle with joints and more": (
        16,
        "angles: {a: {joints: [body, rpaw, rtoe], from: up}}",
        16,
        "found joints and from in 'a'",
    ),
    "angle about and towards": (
        16,
        "angles: {a: {segment: [body, head], towards: up, about: up}}",
        16,
        "about goes with from",
    ),
    "angle with an unknown key": (
        16,
        "angles: {a: {segmnt: [body, head], from: up}}",
        16,
        "'segmnt' in 'a'.*'segment'",
    ),
    "angle from an unknown direction": (
        16,
        "angles: {a: {segment: [body, head], from: upp}}",
        16,
        "direction 'upp'.*'up'",
    ),
    "angle of a point": (16, "angles: {a: {segment: [head, head], from: up}}", 16, "two ends at the same place"),
    "no up without gravity": (16, "gravity: false", 13, "'up' is missing"),
    "gravity is a word": (16, "gravity: maybe", 16, "text 'maybe'.*true or false"),
    "unknown key": (16, "gravitiy: true", 16, "unknown key 'gravitiy'.*'gravity'"),
    "key twice": (16, "gravity: true\nroot: head", 17, "key 'root' twice.*line 3"),
    "key is a number": (16, "3: true", 16, "key '3'"),
    "from an unknown joint": (16, "from: {x: {tail: a}}", 16, "'tail'.*not a joint"),
    "from of nothing": (16, "from: {x: {}}", 16, "nothing in 'from.x'"),
    "from of a number": (16, "from:\n  x:\n    head: 3", 18, "the number 3"),
    "from twice in a mean": (16, "from: {x: {head: [a, a]}}", 16, "'a' twice"),
    "midpoint of an unknown": (16, "midpoints: {body: [rpow, lpaw]}", 16, "'rpow'.*'rpaw'"),
    "midpoint of itself": (16, "midpoints: {body: [body, lpaw]}", 16, "itself a midpoint"),
    "length not above 0": (16, "proportions: {head: 0}", 16, "length 0"),
    "length is a word": (16, "proportions: {head: long}", 16, "the text 'long'.*a number"),
    "length not finite": (16, "proportions: {head: .nan}", 16, "nan.*finite"),
    "rest of an unknown": (16, "rest: {hed: [1, 0, 0]}", 16, "'hed'.*'head'"),
    "rest with two numbers": (16, "rest: {head: [1, 0]}", 16, "2 numbers"),
    "rest without direction": (16, "rest: {head: [0, 0, 0]}", 16, "with a direction"),
    "limit not finite": (16, "limits:\n  rtoe: {flexion: [0, .inf]}", 17, "inf.*finite"),
    "limit is true": (16, "limits: {rtoe: {flexion: [0, true]}}", 16, "expected a number"),
    "description is a list": (1, "description: [a]", 1, "found a list.*expected text"),
    "python tag": (1, "name: !!python/object/apply:os.system ['touch ran']", 1, "YAML tag.*python"),
    "own tag": (1, "name: !dog x", 1, "YAML tag"),
    "alias": (16, "gravity: true\nrest: &a {head: [1, 0, 0]}\nproportions: *a", 18, r"alias \(\*a\)"),
    "tab": (14, "\tfront: [body, head]", 14, "not YAML.*spaces"),
    "open bracket": (2, "joints: [body, head", 3, "not YAML"),
    "two documents": (16, "---\nname: cat", 16, "not YAML.*one document"),
    "control character": (16, "gravity: \x07", 16, "control character"),
    "number too long": (16, "proportions: {head: " + "9" * 5000 + "}", 16, "not a valid int"),
    "deep nesting": (16, "limits: " + "[" * 500 + "]" * 500, 16, "nested more than"),
}


def written(tmp_path, text: str | bytes):
    file = tmp_path / "dog.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def test_the_right_file_is_right(tmp_path):
    skeleton = load_skeleton(written(tmp_path, "\n".join(LINES)))
    assert skeleton.name == "dog"
    assert len(skeleton.bones) == 5


@pytest.mark.parametrize("case", WRONG)
def test_wrong_line_is_named(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    number, change, line, words = WRONG[case]
    lines = LINES[: number - 1] + ([change] if change else ["#"]) + LINES[number:]
    file = written(tmp_path, "\n".join(lines))
    with pytest.raises(UserError) as caught:
        load_skeleton(file)
    message = str(caught.value)
    assert message.startswith(f"{file}, line {line}: "), message
    assert re.search(words, message, re.DOTALL), message
    assert "\n" not in message
    assert len(message) < len(str(file)) + 400
    assert not (tmp_path / "ran").exists()


def test_loops_are_allowed_where_meant(tmp_path):
    lines = [*LINES[:9], "  - [ltoe, rtoe]", "loops: true", *LINES[9:]]
    skeleton = load_skeleton(written(tmp_path, "\n".join(lines)))
    assert len(skeleton.bones) == 6
    assert len(skeleton.parents) == 6


BOMB = "a: &a [x, x]\n" + "\n".join(
    f"{key}: &{key} [*{before}, *{before}]" for before, key in pairwise("abcdefghijklmnopqrstuvwxyz")
)

FILES = {
    "empty": (b"", "line 1: the file is empty"),
    "only comments": (b"# nothing\n", "line 1: the file is empty"),
    "a list": (b"- a\n- b\n", "line 1: found a list; expected a skeleton"),
    "text": (b"hello\n", "line 1: found the text 'hello'"),
    "binary": (b"name: x\n\x89PNG\r\n\xff\xfe", "line 2: not a text file"),
    "zeros": (b"\0" * 100, "line 1: not a text file"),
    "bomb": (BOMB.encode(), "line 2: found an alias"),
    "large": (b"# " + b"x" * 2_000_000, r"2\.0 MB is too large"),
    "many values": (b"joints: [" + b"a," * 80_000 + b"]", "line 1: found more than 60,000 values"),
    "many joints": (f"joints: [{', '.join(f'j{i}' for i in range(1500))}]\nroot: j0\nbones: []".encode(),
                    "line 1: found 1500 joints"),
}  # fmt: skip


@pytest.mark.parametrize("case", FILES)
def test_what_is_no_skeleton_is_refused(case, tmp_path):
    content, words = FILES[case]
    file = written(tmp_path, content)
    with pytest.raises(UserError, match=words) as caught:
        load_skeleton(file)
    assert str(caught.value).startswith(str(file))


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(UserError, match="found a folder"):
        load_skeleton(tmp_path / "folder.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(UserError, match="not a regular file"):
        load_skeleton(tmp_path / "pipe.yaml")


def test_numbers_with_an_exponent_are_numbers(tmp_path):
    lines = [*LINES, "proportions: {head: 1e-1, rpaw: 2.5E+0}"]
    assert load_skeleton(written(tmp_path, "\n".join(lines))).body["proportions"] == {
        "head": 0.1,
        "rpaw": 2.5,
    }


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 400), st.text(max_size=6), st.integers(0, 12))
@example(0, "\ufeff", 0)
@example(0, "%", 0)
@example(9, "? ", 0)
@example(9, "=", 0)
@example(9, "<<: {a: b}\n", 0)
def test_any_damage_gives_one_clear_error_or_a_skeleton(tmp_path_factory, at, text, cut):
    whole = "\n".join(LINES)
    file = written(tmp_path_factory.getbasetemp(), (whole[:at] + text + whole[at + cut :]).encode("utf-8", "replace"))
    try:
        load_skeleton(file)
    except UserError as error:
        assert str(error).startswith(str(file))
