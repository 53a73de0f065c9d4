"""A program of its own: OpenSim's inverse kinematics of every frame, each from a start that is given.

python osim_solver.py JOB.json     # in the folder of the files that it names

Nothing of uplift is imported here, and no torch: their libraries do not go together in one process.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import opensim  # type: ignore[import-not-found]

__all__ = ["solve"]


def solve(job: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return values (frames coordinates) in radians and metres, and errors (frames markers) in metres.

    ``job`` has the names of the files ``model`` and ``markers``, ``weights`` of markers and ``still`` of coordinates by
    their names, the ``accuracy``, and for each of the ``times`` the ``start`` of the ``coordinates``.

    OpenSim's own tool starts each frame where the one before ended, and may stay in a solution in which a knee is bent
    the wrong way and the thigh turned half round.
    """
    model = opensim.Model(job["model"])
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in job["coordinates"]]
    solver = _solver(model, job)
    values, errors = [], []
    for time, start in zip(job["times"], job["start"], strict=True):
        state.setTime(time)
        for coordinate, value in zip(coordinates, start, strict=True):
            coordinate.setValue(state, value, False)
        solver.assemble(state)
        values.append([coordinate.getValue(state) for coordinate in coordinates])
        errors.append([solver.computeCurrentMarkerError(name) for name in job["weights"]])
        print("solved", flush=True)
    return np.array(values), np.array(errors)


def _solver(model, job: dict):
    weights = opensim.SetMarkerWeights()
    for name, weight in job["weights"].items():
        weights.cloneAndAppend(opensim.MarkerWeight(name, weight))
    markers = opensim.MarkersReference(job["markers"], weights, opensim.Units("m"))
    still = opensim.SimTKArrayCoordinateReference()
    for name, weight in job["still"].items():
        reference = opensim.CoordinateReference(name, opensim.Constant(0.0))
        reference.setWeight(weight)
        still.push_back(reference)
    solver = opensim.InverseKinematicsSolver(model, markers, still, float("inf"))
    solver.setAccuracy(job["accuracy"])
    return solver


if __name__ == "__main__":
    opensim.Logger.setLevelString("Warn")
    found_values, found_errors = solve(json.loads(Path(sys.argv[1]).read_text()))
    np.save("values.npy", found_values)
    np.save("errors.npy", found_errors)
