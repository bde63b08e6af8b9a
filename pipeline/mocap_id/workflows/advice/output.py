"""The output of `advise`: text, a JSON document, and the movement as CSV and as a figure."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from mocap_id.design.experiment import SMALLER
from mocap_id.design.predicted_covariance import PredictedUncertainty
from mocap_id.design.proposal import OBJECTIVES, Proposal
from mocap_id.design.trajectory import Trajectory
from mocap_id.dynamics.excitation import classify
from mocap_id.reporting.advised_movement import draw
from mocap_id.reporting.numbers import show
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results.columns import to_finite
from mocap_id.reporting.results.result import Result
from mocap_id.workflows.advice.advice import Advice

_NAMED = 4  # number of parameters that are mentioned


def format_text(advised: Advice) -> Iterator[str]:
    """Yield the lines of the text for the terminal."""
    design = advised.design
    yield f"{advised.trial}: {len(advised.names)} parameters, condition number {design.now.condition:.0f}"
    yield _format_limits(advised)
    yield ""
    if design.best is None or not design.helps:
        yield (
            "no movement within these limits helps: none reduces the "
            f"{OBJECTIVES[design.objective]} by a fifth and a standard deviation by 5 %. More markers, a zeroed and "
            "calibrated plate or a longer recording would help"
        )
    else:
        yield f"record this, {design.seconds:.0f} s: {design.best.words}"
        yield f"  {_describe_benefit(advised, design.best)}"
    yield ""
    yield f"simple changes, best first{'' if design.helps else ', none recommended'}:"
    changes = [each for each in design.simple if each.value < design.value or not design.helps]
    for rank, each in enumerate(changes, start=1):
        yield f"  {rank}. {each.words}: {_describe_benefit(advised, each)}"
    if not changes:
        yield "  no simple change is better within these limits"
    yield ""
    if design.designed is not None:
        head = "designed" if design.helps else "designed, not recommended"
        yield f"{head}: {design.designed.words}: {_describe_benefit(advised, design.designed)}"
    else:
        yield "designed: no movement of all joints together is within these limits"
    yield ""
    yield from _format_table(advised)


def _format_limits(advised: Advice) -> str:
    limits = advised.limits
    parts = [
        f"{name} {np.degrees(low):.0f}° to {np.degrees(high):.0f}°, up to {np.degrees(speed):.0f}°/s"
        for name, low, high, speed in zip(advised.joints, limits.low, limits.high, limits.speed, strict=True)
    ]
    if limits.support is None:
        return "limits: " + "; ".join(parts) + "; the base is bolted down"
    low, high = (100 * end for end in limits.support)
    return "limits: " + "; ".join(parts) + f"; centre of pressure {low:.1f} to {high:.1f} cm"


def _describe_benefit(advised: Advice, proposal: Proposal) -> str:
    """Return the benefit of a movement as text: the standard deviations that decrease, and the condition number."""
    design = advised.design
    before, after = design.now.sd / design.size, proposal.predicted.sd / design.size
    gains = [i for i in np.argsort(-before) if after[i] < SMALLER * before[i]]
    named = [
        f"sd of {advised.names[i]} from {show(100 * before[i], 2, '%')} to {show(100 * after[i], 2, '%')}"
        for i in gains[:_NAMED]
    ]
    condition = f"condition number {design.now.condition:.0f} -> {proposal.predicted.condition:.0f}"
    return ", ".join([*(named or ["no smaller sd"]), condition])


def _format_table(advised: Advice) -> Iterator[str]:
    design = advised.design
    columns = [("now", design.now)]
    if design.simple:
        columns.append(("simple 1", design.simple[0].predicted))
    if design.designed is not None:
        columns.append(("designed", design.designed.predicted))
    width = max(map(len, advised.names))
    sds = [(name, each.sd) for name, each in columns]
    if advised.sensor_sd is not None:
        sds.append(("sensor", advised.sensor_sd))
    yield "sd by size, %".ljust(width) + "".join(name.rjust(10) for name, _ in sds)
    for i, name in enumerate(advised.names):
        yield name.ljust(width) + "".join(f"{100 * sd[i] / design.size[i]:10.2f}" for _, sd in sds)
    if advised.sensor_sd is not None:
        yield (
            f"sensor: the same movement with a wrench sensor in the {advised.joints[-1]}; these are lower limits, "
            "because they contain only the noise of the sensor and of the accelerations"
        )
    yield "condition number".ljust(width) + "".join(f"{f.condition:10.1f}" for _, f in columns)


def make_output(advised: Advice) -> Result:
    """Return the files to write: ``advice.json``, and the best new movement as CSV and as a figure."""
    design, limits = advised.design, advised.limits
    content = {
        "trial": advised.trial,
        "objective": {"name": design.objective, "text": OBJECTIVES[design.objective], "now": to_finite(design.value)},
        "helps": design.helps,
        "seconds": design.seconds,
        "limits": {
            "joints": [
                {
                    "name": name,
                    "low_deg": math.degrees(limits.low[j]),
                    "high_deg": math.degrees(limits.high[j]),
                    "speed_deg_s": math.degrees(limits.speed[j]),
                    "acceleration_deg_s2": math.degrees(limits.acceleration[j]),
                }
                for j, name in enumerate(advised.joints)
            ],
            "support_m": None if limits.support is None else list(limits.support),
        },
        "now": _describe_prediction(advised, design.now),
        "simple": [_describe_proposal(advised, each) for each in design.simple],
        "designed": None if design.designed is None else _describe_proposal(advised, design.designed),
        "sensor": _describe_sensor(advised),
    }
    return Result("advice", "advice.json", content, other_files=lambda: _draw_movement(advised), indent=2)


def _describe_sensor(advised: Advice) -> dict[str, Any] | None:
    """Return the standard deviations with a wrench sensor before the last segment, as JSON; None if unknown."""
    if advised.sensor_sd is None:
        return None
    size = advised.design.size
    rows = [
        {"name": name, "sd": to_finite(sd), "relative_sd": to_finite(sd / one)}
        for name, sd, one in zip(advised.names, advised.sensor_sd, size, strict=True)
    ]
    return {"joint": advised.joints[-1], "parameters": rows}


def _describe_proposal(advised: Advice, proposal: Proposal) -> dict[str, Any]:
    head = {"text": proposal.words, "designed": proposal.designed, "objective": to_finite(proposal.value)}
    return head | _describe_prediction(advised, proposal.predicted)


def _describe_prediction(advised: Advice, predicted: PredictedUncertainty) -> dict[str, Any]:
    size = advised.design.size
    return {
        "condition_number": to_finite(predicted.condition),
        "condition_number_scaled": to_finite(predicted.condition_scaled),
        "fitted_s": predicted.samples,
        "parameters": [
            {
                "name": name,
                "value": float(advised.value[i]),
                "unit": advised.units[i],
                "sd": to_finite(predicted.sd[i]),
                "relative_sd": to_finite(predicted.sd[i] / size[i]),
                "verdict": classify(float(predicted.sd[i] / size[i]), advised.weak),
            }
            for i, name in enumerate(advised.names)
        ],
    }


def _format_csv(advised: Advice, trajectory: Trajectory) -> str:
    """Return a movement as CSV: time_s, and angle, velocity and acceleration of every joint (rad, rad/s, rad/s²)."""
    heads = [f"{joint.replace(' ', '_')}_{unit}" for unit in ("rad", "rad_s", "rad_s2") for joint in advised.joints]
    rows = np.column_stack([trajectory.time - trajectory.time[0], trajectory.q, trajectory.dq, trajectory.ddq])
    stream = io.StringIO()
    np.savetxt(stream, rows, fmt="%.6f", delimiter=",", header=",".join(["time_s", *heads]), comments="")
    return stream.getvalue()


def _draw_movement(advised: Advice) -> dict[str, bytes]:
    movement = advised.design.best_standalone
    if movement is None:
        return {}
    title = f"A movement to record after {advised.trial}"
    figure = render(
        "movement", title, lambda: draw(movement.trajectory, advised.joints, advised.limits, movement.words)
    )
    return {"movement.csv": _format_csv(advised, movement.trajectory).encode(), **figure}
