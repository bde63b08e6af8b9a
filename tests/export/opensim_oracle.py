"""What OpenSim makes of an exported run, as JSON: run with a Python that has the `opensim` wheel.

    python opensim_oracle.py FOLDER TRIAL OUT.json [MARKERS.trc]

Independent of mocap-id: nothing of it is imported here.
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
    """A table as arrays by label, with its times."""
    found = {"time": np.array(table.getIndependentColumn())}
    return found | {label: table.getDependentColumn(label).to_numpy() for label in table.getColumnLabels()}


def kinematics() -> dict[str, list[float]]:
    """Angles of OpenSim's inverse kinematics, rad, by the exported set-up."""
    out = Path(tempfile.mkdtemp())
    tool = opensim.InverseKinematicsTool(str(folder / f"{trial}_ik.xml"))
    tool.set_model_file(str(folder / f"{trial}.osim"))
    tool.setMarkerDataFileName(str(markers))
    tool.setResultsDir(str(out))
    tool.setOutputMotionFileName(str(out / "ik.mot"))
    tool.run()
    table = opensim.TimeSeriesTable(str(out / "ik.mot"))
    return {name: values.tolist() for name, values in columns(table).items()}


def dynamics() -> dict[str, list[float]]:
    """Generalised forces at the exported states and accelerations, without differentiating anything; with our loads."""
    model = opensim.Model(str(folder / f"{trial}.osim"))
    loads = folder / f"{trial}_external_loads.xml"
    if loads.exists():
        model.addModelComponent(opensim.ExternalLoads(str(loads), True))
    state = model.initSystem()
    states = columns(opensim.TimeSeriesTable(str(folder / f"{trial}_states.sto")))
    accelerations = columns(opensim.TimeSeriesTable(str(folder / f"{trial}_accelerations.sto")))
    solver = opensim.InverseDynamicsSolver(model)
    coordinates = model.getCoordinateSet()
    names = [coordinates.get(i).getName() for i in range(coordinates.getSize())]
    moved = [path for path in states if path.endswith("/value")]
    found: dict[str, list[float]] = {"time": [], **{name: [] for name in names}}
    for row in range(0, len(states["time"]), max(1, len(states["time"]) // 200)):
        state.setTime(states["time"][row])
        udot = opensim.Vector(len(names), 0.0)
        for path in moved:
            name = path.split("/")[-2]
            coordinate = coordinates.get(name)
            coordinate.setValue(state, states[path][row], False)
            coordinate.setSpeedValue(state, states[path.replace("/value", "/speed")][row])
            udot[names.index(name)] = accelerations[name][row]
        force = solver.solve(state, udot)
        found["time"].append(states["time"][row])
        for i, name in enumerate(names):
            found[name].append(force[i])
    return found


def tool_dynamics() -> dict[str, list[float]]:
    """Of OpenSim's own tool, which differentiates the exported angles by splines; by the exported set-up."""
    out = Path(tempfile.mkdtemp())
    tool = opensim.InverseDynamicsTool(str(folder / f"{trial}_id.xml"))
    tool.setModelFileName(str(folder / f"{trial}.osim"))
    tool.setCoordinatesFileName(str(folder / f"{trial}_angles.mot"))
    if (folder / f"{trial}_external_loads.xml").exists():
        tool.setExternalLoadsFileName(str(folder / f"{trial}_external_loads.xml"))
    tool.setResultsDir(str(out))
    tool.setOutputGenForceFileName("id.sto")
    tool.run()
    return {name: values.tolist() for name, values in columns(opensim.TimeSeriesTable(str(out / "id.sto"))).items()}


model = opensim.Model(str(folder / f"{trial}.osim"))
state = model.initSystem()
found = {
    "version": opensim.GetVersion(),
    "mass": model.getTotalMass(state),
    "bodies": model.getNumBodies(),
    "markers": model.getMarkerSet().getSize(),
    "kinematics": kinematics(),
    "dynamics": dynamics(),
}
if (folder / f"{trial}_id.xml").exists():
    found["tool"] = tool_dynamics()
result.write_text(json.dumps(found))
