"""What a simulated person does: each action mixes leg, trunk and arm postures at its own tempo."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ACTIONS", "Action"]


@dataclass(frozen=True)
class Action:
    """Postures to move between; a step cycle in place of leg postures where there is one."""

    share: float
    """Share of clips when every action is on."""
    legs: tuple[str, ...]
    trunk: tuple[str, ...]
    arms: tuple[str, ...]
    """``swing`` swings them with the steps."""
    cycle: str = ""
    """One of `uplift.simulator.gait.CYCLES`."""
    tempo: float = 1.0
    """Time between postures against the usual one."""
    turn_deg_s: float = 15.0
    """Standard deviation of the turning speed."""


_EASY = ("hang", "hang", "low", "hip", "folded", "to face", "behind", "guard")
_WIDE = ("forward", "low", "out", "overhead", "across", "elbows out", "on head", "any")

ACTIONS = {
    "walk": Action(0.12, (), ("upright", "slouch"), ("swing",), "walk", turn_deg_s=25.0),
    "walk busy": Action(0.05, (), ("upright", "lean", "twist", "side"), (*_EASY, *_WIDE), "walk", turn_deg_s=35.0),
    "run": Action(0.07, (), ("upright", "lean"), ("swing",), "run", turn_deg_s=40.0),
    "climb": Action(0.04, (), ("upright", "lean"), ("swing", "forward", "overhead", "low", "hang"), "climb"),
    "stand": Action(0.06, ("stand", "stand", "wide", "crossed"), ("upright", "slouch"), _EASY, tempo=1.5),
    "gesture": Action(0.08, ("stand", "step", "wide"), ("upright", "lean", "twist", "side"), (*_EASY, *_WIDE)),
    "reach": Action(
        0.08, ("stand", "tiptoe", "step", "half squat", "lunge"), ("upright", "lean", "arch", "twist", "side"),
        ("forward", "overhead", "low", "out", "across"),
    ),
    "bend": Action(0.06, ("stand", "wide", "half squat", "step"), ("bend", "bend", "lean", "upright"), ("low", "forward", "hang", "any")),
    "squat": Action(0.05, ("squat", "half squat", "stand", "wide"), ("lean", "bend", "upright"), ("low", "forward", "hang", "out", "to face")),
    "sit": Action(0.07, ("sit", "sit", "sit crossed", "ankle on knee", "stand"), ("upright", "slouch", "lean", "twist"), (*_EASY, "forward", "low"), tempo=1.4),
    "floor": Action(0.02, ("tailor seat", "floor seat", "huddle"), ("upright", "slouch", "lean"), ("low", "behind", "forward", "folded")),
    "kneel": Action(0.03, ("kneel", "half kneel", "heel seat", "stand"), ("upright", "lean", "bend"), (*_EASY, "low", "forward", "overhead")),
    "crawl": Action(0.015, ("kneel", "half kneel"), ("crawl",), ("support", "support", "low")),
    "lie": Action(0.004, ("supine",), ("supine",), ("hang", "out", "overhead", "any")),
    "lie prone": Action(0.002, ("prone",), ("prone",), ("hang", "out", "overhead")),
    "fight": Action(
        0.08, ("guard", "guard", "lunge", "front kick", "side kick", "knee up"), ("upright", "twist", "tilt", "lean"),
        ("guard", "guard", "punch", "hang", "across", "low"), tempo=0.7, turn_deg_s=50.0,
    ),
    "kick": Action(0.03, ("stand", "step", "front kick", "side kick", "back kick", "knee up"), ("upright", "tilt", "arch", "lean"), ("out", "guard", "any", "hang"), tempo=0.7),
    "dance": Action(
        0.10, ("stand", "tiptoe", "passe", "leg out", "back kick", "crossed", "lunge", "wide", "split", "knee up", "half squat"),
        ("upright", "arch", "side", "twist", "tilt"), ("overhead", "out", "across", "hip", "elbows out", "forward", "any"), tempo=0.8, turn_deg_s=90.0,
    ),
    "jump": Action(
        0.05, ("half squat", "flight", "half squat", "split", "stand", "squat"), ("upright", "lean", "arch"),
        ("hang", "overhead", "behind", "forward", "out"), tempo=0.55, turn_deg_s=30.0,
    ),
    "step": Action(0.04, ("step", "side lunge", "lunge", "crossed", "high step", "half squat"), ("upright", "lean", "twist"), (*_EASY, *_WIDE), tempo=0.8, turn_deg_s=60.0),
    "loose": Action(0.06, ("loose", "loose", "stand", "flight", "half squat"), ("loose",), ("any",), tempo=0.9, turn_deg_s=50.0),
}  # fmt: skip
