"""`WarmStart`, what ``init=`` means for a fit of keypoints: its networks are those of a trained lifter, with its weights."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from uplift.config.run import lifter_label, read_weights
from uplift.config.settings import LifterSettings, Settings
from uplift.errors import UserError, listed
from uplift.models.model import Model, load_poses
from uplift.training.lifting import KeypointModule
from uplift.training.student import student_settings

__all__ = ["WarmStart"]

_OF_THE_FIT = ("refine", "both_ways", "intrinsics", "denoise")
"""Of the settings of a lifter: what does not make its network."""
_WARM_UP = 0.1
"""Least of the teacher: Adam's first steps are as long as all others, and would undo what the weights know."""


@dataclass
class WarmStart:
    """A trained lifter that a fit starts from."""

    name: str
    """As the user named it."""
    model: Model
    path: Path
    """The file of its weights."""
    notes: list[str] = field(default_factory=list)

    @classmethod
    def load(cls, name: str) -> WarmStart:
        """Read the lifter; raises UserError as `read_weights` does, and for one of masks."""
        weights = read_weights(name)
        return cls(name, load_poses(weights), weights.path.resolve())

    def settings(self, settings: Settings) -> Settings:
        """Return ``settings`` with all networks as that of the lifter, each stage going on with the weights of the last.

        Notes what that changes. Raises UserError where a network is named that is another one.
        """
        given = self.model.settings
        usual = student_settings(settings, last=True) if settings.student.share > 0 else settings.lifter
        self._refuse_another_network(settings, usual)
        kept = {name: getattr(settings.lifter, name) for name in _OF_THE_FIT}
        lifter = replace(given, **kept)
        if changed := _texts(lifter, usual):
            self.notes.append(f"init: the network is the one there: {listed(changed)}")
        student = replace(settings.student, network=None, options={}, last_options={}, warm=True, cameras=given.cameras)
        teacher = replace(settings.teacher, warm_up=max(settings.teacher.warm_up, _WARM_UP))
        views = replace(settings.views, count_root=lifter.radius == "all")
        return replace(settings, lifter=lifter, teacher=teacher, student=student, views=views, init=self.init)

    @property
    def init(self) -> str:
        """The name under which the lifter is found later, when ``last`` is another run; of a ready lifter its own."""
        return str(self.path) if Path(self.name).exists() else self.name

    def _refuse_another_network(self, settings: Settings, usual: LifterSettings) -> None:
        """Raise UserError where the user, and not the recipe, names a network that is another one."""
        given, wanted = self.model.settings, dict[str, tuple[Any, Any]]()
        if usual.network != LifterSettings().network:
            name = "lifter.network" if settings.student.network is None else "student.network"
            wanted[name] = (usual.network, given.network)
        for name in settings.lifter.options.keys() & usual.options.keys():
            wanted[f"lifter.options.{name}"] = (usual.options[name], given.options.get(name, "its default"))
        for name, (asked, found) in wanted.items():
            if asked != found:
                raise UserError(
                    f"{name}={asked}, but the network of init={self.name} has {found}: leave it out, as sizes are those "
                    "of that network."
                )

    def into(self, module: KeypointModule) -> None:
        """Copy the weights into the first module that is trained, and note which joints they know."""
        try:
            shared = module.start_from(self.model)
        except UserError as error:
            raise UserError(f"init={self.name}: {error}") from error
        joints, there = module.skeleton.joints, self.model.skeleton
        note = f"init: the weights of {lifter_label(self.init)}, trained on skeleton '{there.name}'"
        if joints != there.joints:
            fresh = [joint for joint in joints if joint not in shared]
            note += f", which has {len(shared)} of the {len(joints)} joints"
            note += f"; new to it: {listed(fresh)}" if fresh else ""
        self.notes.append(note)

    def facts(self) -> dict[str, Any]:
        """Return what run.json keeps: the file, a hash of it, and the notes."""
        return {
            "lifter": str(self.path),
            "sha256": hashlib.sha256(self.path.read_bytes()).hexdigest(),
            "notes": self.notes,
        }


def _texts(settings: LifterSettings, usual: LifterSettings) -> list[str]:
    """Return the settings that differ, each with what it would have been."""
    pairs = [(name, value, getattr(usual, name)) for name, value in vars(settings).items()]
    return [f"{name} {_text(value)}, not {_text(other)}" for name, value, other in pairs if value != other]


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_text(inner)}" for name, inner in value.items()) + "}"
    return str(value).lower() if isinstance(value, bool) else str(value)
