"""Errors of the models of a real sit-to-stand and of real squats. It needs MOCAP_ID_RECORDINGS and two minutes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import JOINTS, format_table, make_parser, publish, real_recordings, rms, temporary_folder, write_real_trial

from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.config import load
from mocap_id.dynamics.measured_motion import close_gaps
from mocap_id.dynamics.prediction import centre_of_pressure
from mocap_id.geometry import planar
from mocap_id.protocols.body_names import make_empty_reference
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.stages.identify_dim.dynamics_artefacts import validate
from mocap_id.stages.identify_dim.plane import identify_on_chain, prepare_trial
from mocap_id.stages.identify_dim.segment_fit import (
    BodyFit,
    MeasuredBodies,
    bridge_gaps,
    filter_measured,
    fit_bodies,
    read_bodies,
)
from mocap_id.stages.identify_dim.trial_data import ReferenceBodies, build_reference_bodies
from mocap_id.store import Folder
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.transfer import HELD_OUT, OWN, SERIES, TRANSFERRED, apply_model, rms_error

HEADS = ("Fx, N", "Fy, N", "tauz, N·m", "CoP, mm")
STEPS = (
    "1 pinned chain",
    "2 its poses, new fit",
    "3 + other markers",
    "4 measured, all joints pinned",
    "5 hip open",
    "6 all joints open",
    "7 even prior",
    "8 Winter",
    "8 de Leva",
)
THIGH = 2
WINTER = "Winter"


@dataclass(frozen=True)
class Trial:
    done: IdentifiedTrial
    file: Path

    @property
    def context(self) -> Context:
        trial, folder = load(self.file), Folder(self.done.folder)
        return Context(trial.keys, trial.settings[STAGE.name], {name: folder.read(name) for name in STAGE.inputs})

    @property
    def base(self) -> Any:
        tree: Any = Folder(self.done.folder).read("dynamics.h5")
        return tree.data["base"]


def run(source: Path, folder: Path, recording: str, name: str, **keys: Any) -> Trial:
    yaml = write_real_trial(source / recording, folder / f"{name}.yaml", **{"subject": {"mass": 60.0}, **keys})
    return Trial(open_identified_trial(yaml), yaml)


def format_errors(values: Mapping[str, float]) -> list[str]:
    """Return errors of the wrench in the units of the tables."""
    return [f"{(1e3 if name == 'cop_x' else 1.0) * values[name]:.1f}" for name in SERIES]


def format_facts(errors: Mapping[str, Any]) -> list[str]:
    """Return rms errors from bias and standard deviation in the facts of a trial."""
    return format_errors({name: float(np.hypot(one["bias"], one["sd"])) for name, one in errors.items()})


def make_held_out_rows(name: str, trial: Trial, chain: Trial) -> list[list[str]]:
    """Return errors on left-out repetitions of every model, filtered and unfiltered."""
    held, pins = trial.done.facts["held_out"], trial.done.facts["pins"]
    on_chain = chain.done.facts["held_out"]
    pressure = {"bias": 0.0, "sd": pins["chain"]["cop_rms_m"]}
    return [
        [name, model, band, str(samples), *format_facts(errors)]
        for model, band, samples, errors in (
            ("pinned chain", "in the band", pins["samples"], {**pins["chain"]["wrench"], "cop_x": pressure}),
            ("measured poses", "in the band", held["samples"], held["model"]),
            ("Winter", "in the band", held["samples"], held["reference"]),
            ("pinned chain", "unfiltered", on_chain["samples"], on_chain["model"]),
            ("measured poses", "unfiltered", held["samples"], held["unfiltered"]),
        )
    ]


def move_to_chain(bodies: MeasuredBodies, q: FloatArray) -> MeasuredBodies:
    """Move the bodies to the segments of the pinned chain, except the body of other markers."""
    poses = bodies.poses
    angle, origin = planar.segment_poses(q, poses.centres)
    own = slice(angle.shape[1])
    position, turned = poses.position.copy(), poses.angle.copy()
    position[:, own], turned[:, own] = origin + planar.rotate(angle, poses.centroid[own]), angle
    return replace(bodies, poses=replace(poses, position=position, angle=turned), observed=find_complete_rows(turned))


def compare_steps(trial: Trial) -> dict[str, list[str]]:
    """Return the errors on left-out repetitions, in the band, for each of :data:`STEPS`."""
    context = trial.context
    read = prepare_trial(context)
    prepared, movement = read.prepared, read.movement
    assert prepared is not None
    tables, recorded = build_reference_bodies(context, prepared.recorded, movement), prepared.recorded
    chain = identify_on_chain(context, prepared, movement, read.grid, tables)
    apart = read.bodies
    assert apart is not None
    table, segments = context.table("poses.parquet"), range(len(recorded.centres) + 1)
    chosen = bridge_gaps(read_bodies(table, recorded.centres, trial.done.facts["motion"]["used"]))  # no joint is pinned
    bare, with_others = (read_bodies(table, recorded.centres, [*segments, *more]) for more in ([], apart.used[-1:]))
    every = chosen.poses.joints

    def fitted(way: MeasuredBodies, rival: ReferenceBodies = tables) -> BodyFit:
        return fit_bodies(context, way, prepared, movement, pinned=chain, tables=rival)

    ways = [move_to_chain(bare, recorded.q), move_to_chain(with_others, recorded.q)]
    ways += [replace(chosen, poses=close_gaps(chosen.poses, joints)) for joints in (every, every[:2], [])]
    fits = [fitted(way) for way in ways]
    fits.append(fitted(chosen, ReferenceBodies(make_empty_reference(len(recorded.centres), None), ())))
    best = fits[4]
    first, lowpass = validate(prepared, movement, chain, np.zeros((len(recorded.time), 3))), best.prepared.lowpass
    assert not isinstance(first, str)
    assert not isinstance(best.left_out, str)
    on_chain = first.samples & best.left_out.samples, lowpass(first.wrench), lowpass(first.measured)
    found: list[tuple[BoolArray, FloatArray, FloatArray]] = [on_chain]
    for each in fits:
        held = each.left_out
        assert not isinstance(held, str)
        found.append((held.samples, held.filtered, held.filtered_measured))
    for body in best.references.every:
        model = np.where(best.found.fit.in_fit[:, None], best.prepared.filtered @ body.parameters, np.nan)
        found.append((found[0][0], model, filter_measured(best.prepared, best.found)))
    both = np.logical_and.reduce([samples & np.isfinite(model).all(axis=1) for samples, model, _ in found])
    threshold = trial.done.cop_threshold
    return {
        name: format_errors(compute_errors(model[both], measured[both], threshold))
        for name, (_, model, measured) in zip(STEPS, found, strict=True)
    }


def compute_errors(model: FloatArray, measured: FloatArray, threshold: float) -> dict[str, float]:
    both = (np.column_stack([wrench, centre_of_pressure(wrench, threshold)]) for wrench in (model, measured))
    off = np.subtract(*both)
    return dict(zip(SERIES, rms(off), strict=True))


def make_gap_rows(name: str, trial: Trial) -> list[list[str]]:
    """Return the gap of every joint, and the acceleration of one body relative to the other."""
    gaps = trial.done.facts["motion"]["joints"]
    return [
        [name, joint, f"{1e3 * gaps[joint]['gap_m']:.1f}", f"{gaps[joint]['acceleration_m_s2']:.2f}"]
        for joint in JOINTS
    ]


def make_clock_row(name: str, trial: Trial) -> list[str]:
    """Return the clock offset of the pinned chain, of the measured poses, and of their left-out repetitions, ms."""
    facts = trial.done.facts
    folds = 1e3 * np.array(facts["held_out"]["clock_offset_s"])
    found = f"{1e3 * facts['clock_offset_s']:.1f} ± {1e3 * facts['clock_offset_sd_s']:.1f}"
    return [name, f"{1e3 * facts['pins']['clock_offset_s']:.1f}", found, f"{folds.min():.1f} … {folds.max():.1f}"]


def make_torque_row(trial: Trial, band: Trial, below: str) -> list[str]:
    """Return model minus plate at each joint, N·m.

    The bodies below the joint have the model's own parameters, or Winter's.
    """
    dynamics, bodies = trial.done.dynamics, trial.done.bodies
    full = trial.done.reference if below == WINTER else trial.done.parameters
    used = (dynamics["in_fit"] & band.done.dynamics["in_fit"]).to_numpy()
    measured = dynamics[["Fx", "Fy", "tauz"]].to_numpy()
    found = []
    for j in range(len(JOINTS)):
        carried = bodies.regressor @ np.where(np.repeat(bodies.motion.beyond[j], 4), 0.0, full)
        by_plate = np.einsum("tc,tc->t", bodies.motion.jacobian[:, :, j], measured - carried)
        off = band.done.in_band(dynamics[f"tau_{j + 1}"].to_numpy() - by_plate)[used]
        found.append(f"{rms(off):.1f} ({np.nanmean(off):+.1f})")
    return found


def make_transfer_tables(pairs: Mapping[str, tuple[Trial, Trial]]) -> dict[str, str]:
    """Return tables of errors and of stated standard deviations, and the verdicts."""
    off, stated, verdicts = [], [], []
    for name, (source, target) in pairs.items():
        found = apply_model(source.done, target.done)
        bodies = {body.name: body.errors for body in found.bodies}
        off += [
            [name, body, *format_errors({key: rms_error(bodies[body][key]) for key in SERIES})]
            for body in (OWN, HELD_OUT, TRANSFERRED, "winter")
        ]
        sds = format_errors(found.stated)
        shares = [f"{100 * found.inside[key]:.0f} %" for key in SERIES]
        stated.append([name, *(f"{sd} / {share}" for sd, share in zip(sds, shares, strict=True))])
        codes = ", ".join(f"`{reason.code}`" for reason in found.reasons)
        verdicts.append(f"{name}: {'supported' if found.supported else f'not supported ({codes})'}.")
    return {
        "real-transfer": format_table(["", "body", *HEADS], off),
        "real-stated": format_table(["", *HEADS], stated),
        "real-verdicts": f"The verdict of `mocap-id transfer`: {' '.join(verdicts)}",
    }


def make_parameter_rows(one: Trial, other: Trial) -> list[list[str]]:
    """Return the parameters of two trials, and their difference in standard deviations."""
    rows = []
    values, sds, shares = ([trial.base[key] for trial in (one, other)] for key in ("value", "sd", "prior_share"))
    for k, (name, unit) in enumerate(zip(one.base["name"], one.base["unit"], strict=True)):
        row = [f"`{name}`", str(unit).replace("*", "·").replace("^2", "²")]
        for value, sd, share in zip(values, sds, shares, strict=True):
            row += [f"{value[k]:.2f} ± {sd[k]:.2f}", f"{100 * share[k]:.0f} %"]
        rows.append([*row, f"{abs(values[0][k] - values[1][k]) / np.hypot(sds[0][k], sds[1][k]):.1f}"])
    return rows


def make_sections(source: Path, folder: Path) -> dict[str, str]:
    named = {"STS1": run(source, folder, "STS1", "sts"), "squats1": run(source, folder, "squats1", "squats")}
    by_chain = {name: run(source, folder, name, f"{name}-chain", **{STAGE.name: {"motion": "chain"}}) for name in named}
    four = run(source, folder, "STS1", "sts-4", segment={"count": 4})
    sts, squats = named.values()
    found = {name: compare_steps(trial) for name, trial in named.items()}
    models = (("pinned chain", "own", by_chain), ("measured poses", "own", named), ("measured poses", WINTER, named))
    torques = [
        [n, model, below, *make_torque_row(of[n], named[n], below)] for n in named for model, below, of in models
    ]
    held_out = [row for name in named for row in make_held_out_rows(name, named[name], by_chain[name])]
    inside = {name: trial.done.facts["held_out"]["inside"] for name, trial in named.items()}
    shares = [[name, *(f"{100 * of[key]:.0f} %" for key in SERIES)] for name, of in inside.items()]
    stepped = [[step, *(cell for name in named for cell in found[name][step])] for step in STEPS]
    gaps = [row for each in named.items() for row in make_gap_rows(*each)]
    clocks = [make_clock_row(*each) for each in named.items()]
    k = 4 * THIGH
    thighs = " and ".join(
        f"{trial.done.parameters[k]:.1f} ± {np.sqrt(trial.done.covariance[k, k]):.1f} kg on `{name}`"
        for name, trial in named.items()
    )
    head = ["parameter", "unit", "STS1", "prior", "squats1", "prior", "difference"]
    return {
        "real-held-out": format_table(["", "model", "", "samples", *HEADS], held_out),
        "real-inside": format_table(["", *(head.split(",")[0] for head in HEADS)], shares),
        "real-steps": format_table(["", *(f"{name}: {head}" for name in named for head in HEADS)], stepped),
        "real-gaps": format_table(["", "joint", "gap, mm", "acceleration, m/s²"], gaps),
        "real-clocks": format_table(["", "pinned chain, ms", "measured poses, ms", "by repetition, ms"], clocks),
        "real-torques": format_table(["", "model", "below", *(f"{joint}, N·m" for joint in JOINTS)], torques),
        "real-thigh": f"Both thighs together weigh {thighs} in the model, {sts.done.reference[k]:.0f} kg in "
        "Winter's table.",
        **make_transfer_tables({"STS1 → squats1": (sts, squats), "squats1 → STS1": (squats, sts)}),
        "real-parameters": format_table(head, make_parameter_rows(four, squats)),
    }


def main() -> None:
    given = make_parser(__doc__).parse_args()
    with temporary_folder() as folder:
        publish(make_sections(real_recordings(), folder), write=given.write)


if __name__ == "__main__":
    main()
