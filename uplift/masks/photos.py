"""The photos that masks belong to."""

from __future__ import annotations

from pathlib import Path

from uplift.errors import UserError
from uplift.masks.picture import ENDINGS

__all__ = ["Photos"]


class Photos:
    """The pictures in the folder that a user names with ``images=``; without one, names are as the file has them.

    Raises:
        UserError: no such folder, or no picture in it.
    """

    def __init__(self, folder: str | None):
        self.folder = None if folder is None else Path(folder)
        self.missing = 0
        """Photos that were asked for and are not there."""
        self._files: dict[str, str] = {}
        if self.folder is None:
            return
        if not self.folder.is_dir():
            raise UserError(f"images={folder}: no such folder (looked in {self.folder.absolute().parent}).")
        for path in sorted(self.folder.rglob("*")):
            if path.suffix.lower() in ENDINGS:
                inside = path.relative_to(self.folder)
                for key in (inside.as_posix(), path.name, inside.with_suffix("").as_posix(), path.stem):
                    self._files.setdefault(key, str(path))
        if not self._files:
            raise UserError(f"images={folder}: no picture in that folder.")

    def of_name(self, name: str) -> str:
        """Return the photo of that file name; where it is not in the folder, nothing."""
        if self.folder is None:
            return name
        return self._found(name, Path(name).name)

    def of_mask(self, name: str) -> str:
        """Return the photo named as a mask is, apart from the ending; nothing without a folder of photos."""
        if self.folder is None:
            return ""
        bare = Path(name).with_suffix("")
        return self._found(bare.as_posix(), bare.name)

    def notes(self) -> list[str]:
        """Return what there is to tell."""
        return [f"{self.missing:,} masks have no photo in {self.folder}"] if self.missing else []

    def _found(self, *keys: str) -> str:
        photo = next((self._files[key] for key in keys if key in self._files), "")
        self.missing += not photo
        return photo
