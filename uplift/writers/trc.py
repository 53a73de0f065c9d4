"""Predictions as a TRC, the marker file of OpenSim: one clip, tabs, blank cells for what is missing."""

from __future__ import annotations

from pathlib import Path

from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.markers import Trial, trial_of
from uplift.writers.plain import filled_in, numbers

__all__ = ["write_trc"]

_ROWS = 512


def write_trc(prediction: Prediction, path: str | Path) -> None:
    """Write one clip in mm, in the axes the prediction is in; frames count from 1, frame 1 is at 0 s.

    Joint names lose their white space. Frames that are not there are blank rows. Raises UserError for
    poses without a size in mm or a frame rate, and for more than one clip.
    """
    trial = trial_of(prediction, path, "TRC")
    # OpenSim drops an empty cell at the end of a line, so that every line of markers ends in a tab.
    template = "\t".join(["%.5f"] * (3 * len(trial.names))) + "\t\n"
    with replacing(path) as handle:
        handle.write(_head(trial, Path(path).name).encode())
        for start in range(0, len(trial.points), _ROWS):
            rows = numbers(trial.points[start : start + _ROWS])
            first = trial.start + start
            lines = (
                f"{frame + 1}\t{frame / trial.fps:.6f}\t{filled_in(template, row, '')}"
                for frame, row in enumerate(rows, first)
            )
            handle.write("".join(lines).encode())


def _head(trial: Trial, name: str) -> str:
    rate, count = f"{trial.fps:.7g}", len(trial.points)
    called = " ".join(name.encode("utf-8", "replace").decode().split())
    facts = {
        "DataRate": rate,
        "CameraRate": rate,
        "NumFrames": count,
        "NumMarkers": len(trial.names),
        "Units": "mm",
        "OrigDataRate": rate,
        "OrigDataStartFrame": trial.start + 1,
        "OrigNumFrames": count,
    }
    axes = "".join(f"X{n}\tY{n}\tZ{n}\t" for n in range(1, len(trial.names) + 1))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{called}",
        "\t".join(facts),
        "\t".join(map(str, facts.values())),
        "Frame#\tTime\t" + "".join(f"{marker}\t\t\t" for marker in trial.names),
        "\t\t" + axes,
        "",
    ]
    return "\n".join(lines) + "\n"
