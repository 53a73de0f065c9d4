"""The command evaluate: its words, and what it says at the end."""

from __future__ import annotations

from collections.abc import Sequence

from uplift.errors import UserError
from uplift.words import EVALUATE_KEYS, keyed, one_of, whole

__all__ = ["evaluate_command"]


def evaluate_command(words: Sequence[str], use: str) -> None:
    """Evaluate the run or the poses that the words name, and print all figures; ``use`` is the verb's help."""
    keys = keyed("evaluate", words, EVALUATE_KEYS)
    if ("run" in keys) == ("poses" in keys):
        raise UserError(f"evaluate takes run=RUN or poses=FILE. ({use})")
    from uplift.verbs.evaluate import evaluate, evaluate_poses

    if "run" in keys:
        if "skeleton" in keys:
            raise UserError("evaluate run=...: the run knows its skeleton; skeleton= goes with poses=.")
        refine = one_of("evaluate", keys, "refine", ("on", "off"), "on") == "on" if "refine" in keys else None
        items = whole("evaluate", keys, "items")
        print(evaluate(keys["run"], keys.get("data.test"), refine=refine, items=items).table())
        from uplift.run import RunFolder

        folder = RunFolder.open(keys["run"]).path
        print(f"\nwrote {folder}/evaluation.json and evaluation.csv (older ones: evaluations/)")
        print(f"next: uplift compare {folder} OTHER_RUN")
        return
    for key in ("refine", "items"):
        if key in keys:
            raise UserError(f"evaluate poses=FILE takes the poses as they are: {key}= goes with run=.")
    if "data.test" not in keys:
        raise UserError("evaluate poses=FILE needs data.test=FILE with the true poses.")
    print(evaluate_poses(keys["poses"], keys["data.test"], keys.get("skeleton")).table())
