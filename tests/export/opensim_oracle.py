"""OpenSim's results for an exported run, as JSON; needs a Python with the `opensim` package.

    python opensim_oracle.py FOLDER TRIAL OUT.json [MARKERS.trc]

Kinematics are computed if there is a markers' file, free bodies if there is a model of them.

This script is independent of mocap-id and imports nothing from it.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import opensim

folder, trial, result = Path(sys.argv[1]).resolve(), sys.argv[2], Path(sys.argv[3]).resolve()
markers = folder / (sys.argv[4] if len(sys.argv) > 4 else f"{trial}.trc")
opensim.Logger.setLevelString("Error")


def columns(table: opensim.TimeSeriesTable) -> dict[str, np.ndarray]:
    """Return a table as arrays by label, with its times."""
    found = {"time": np.array(table.getIndependentColumn())}
    return found | {label: table.getDependentColumn(label).to_numpy() for label in table.getColumnLabels()}


def kinematics() -> dict[str, list[float]]:
    """Return the angles of OpenSim's inverse kinematics with the exported set-up, rad."""
    out = Path(tempfile.mkdtemp())
    tool = opensim.InverseKinematicsTool(str(folder / f"{trial}_ik.xml"))
    tool.set_model_file(str(folder / f"{trial}.osim"))
    tool.setMarkerDataFileName(str(markers))
    tool.setResultsDir(str(out))
    tool.setOutputMotionFileName(str(out / "ik.mot"))
    tool.run()
    table = opensim.TimeSeriesTable(str(out / "ik.mot"))
    return {name: values.tolist() for name, values in columns(table).items()}


def dynamics(name: str) -> dict[str, list[float]]:
    """Return generalised forces for the exported states, accelerations and loads, without differentiation."""
    model = opensim.Model(str(folder / f"{name}.osim"))
    loads = folder / f"{name}_external_loads.xml"
    if loads.exists():
        model.addModelComponent(opensim.ExternalLoads(str(loads), True))
    state = model.initSystem()
    states = columns(opensim.TimeSeriesTable(str(folder / f"{name}_states.sto")))
    accelerations = columns(opensim.TimeSeriesTable(str(folder / f"{name}_accelerations.sto")))
    solver = opensim.InverseDynamicsSolver(model)
    coordinates = model.getCoordinateSet()
    names = [coordinates.get(i).getName() for i in range(coordinates.getSize())]
    moved = [path for path in states if path.endswith("/value")]
    found: dict[str, list[float]] = {"time": [], **{each: [] for each in names}}
    for row in range(0, len(states["time"]), max(1, len(states["time"]) // 200)):
        state.setTime(states["time"][row])
        udot = opensim.Vector(len(names), 0.0)
        for path in moved:
            moving = path.split("/")[-2]
            coordinate = coordinates.get(moving)
            coordinate.setValue(state, states[path][row], False)
            coordinate.setSpeedValue(state, states[path.replace("/value", "/speed")][row])
            udot[names.index(moving)] = accelerations[moving][row]
        force = solver.solve(state, udot)
        found["time"].append(states["time"][row])
        for i, each in enumerate(names):
            found[each].append(force[i])
    return found


def tool_dynamics(name: str, coordinates: str) -> dict[str, list[float]]:
    """Return generalised forces of OpenSim's own tool, which differentiates the exported coordinates by splines."""
    out = Path(tempfile.mkdtemp())
    tool = opensim.InverseDynamicsTool(str(folder / f"{name}_id.xml"))
    tool.setModelFileName(str(folder / f"{name}.osim"))
    tool.setCoordinatesFileName(str(folder / coordinates))
    if (folder / f"{name}_external_loads.xml").exists():
        tool.setExternalLoadsFileName(str(folder / f"{name}_external_loads.xml"))
    tool.setResultsDir(str(out))
    tool.setOutputGenForceFileName("id.sto")
    tool.run()
    table = opensim.TimeSeriesTable(str(out / "id.sto"))
    return {label: values.tolist() for label, values in columns(table).items()}


model = opensim.Model(str(folder / f"{trial}.osim"))
state = model.initSystem()
found = {
    "version": opensim.GetVersion(),
    "mass": model.getTotalMass(state),
    "bodies": model.getNumBodies(),
    "markers": model.getMarkerSet().getSize(),
}
if (folder / f"{trial}_states.sto").exists():
    found["dynamics"] = dynamics(trial)
if markers.exists():
    found["kinematics"] = kinematics()
if (folder / f"{trial}_id.xml").exists():
    found["tool"] = tool_dynamics(trial, f"{trial}_angles.mot")
if (folder / f"{trial}_free.osim").exists():
    free = opensim.Model(str(folder / f"{trial}_free.osim"))
    found["free"] = {
        "mass": free.getTotalMass(free.initSystem()),
        "bodies": [free.getBodySet().get(i).getName() for i in range(free.getNumBodies())],
        "dynamics": dynamics(f"{trial}_free"),
        "tool": tool_dynamics(f"{trial}_free", f"{trial}_free_poses.mot"),
    }
result.write_text(json.dumps(found))
