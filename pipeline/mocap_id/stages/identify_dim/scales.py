"""Absolute check of the scale of plate, cameras and clock rates, and its effect on the standard deviations."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import BaseSet
from mocap_id.dynamics.body_ratios import find_body_ratios
from mocap_id.dynamics.calibration import Calibration, ScaleCause, propagate_calibration
from mocap_id.dynamics.chain_parameters import ChainMap
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.scale_check import check_scales
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.verdict import Reason

_PLACED, _BOLTED = 0.005, 0.001  # m: error of a plate's place under a person, and under a robot bolted to it
_LEAST_JOINTS = 2  # ankle and knee: the ratios of a person need a shank


def calibration(context: Context) -> Calibration:
    """Return the standard deviations of the instruments' errors of scale from the settings."""
    settings: IdentifyDimSettings = context.settings
    position, bolted = settings.plate_position_sd_m, context.trial.protocol == "robot-joint"
    return Calibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
        position=position if position is not None else _BOLTED if bolted else _PLACED,
        mass=context.trial.subject.mass,
        mass_sd=settings.subject_mass_sd_kg,
    )


def check_and_calibrate(
    context: Context,
    prepared: PreparedTrial,
    movement: Movement,
    found: Identification,
    reference: FloatArray,
    *,
    chain: tuple[BaseSet, ChainMap] | None = None,
    unsmoothed: PreparedTrial | None = None,
) -> Identification:
    """Return the identification with errors of scale in its covariance, and with the result of the check.

    A cause that the check suspects counts with the size that was found.

    Parameters
    ----------
    context : Context
    prepared : PreparedTrial
    movement : Movement
    found : Identification
    reference : (4(n + 1),) array
        Full parameters of the reference body on the chain; without one (NaN), there is no check.
    chain : (BaseSet, ChainMap), optional
        Base parameters of the chain and the map to them, for measured poses.
    unsmoothed : PreparedTrial, optional
        The trial with poses that are hardly filtered, for the check: the cut-offs of the fit damp accelerations.
    """
    usual = calibration(context)
    mass = float(found.full[::4].sum())
    mass_sd = float(np.sqrt(found.covariance[::4, ::4].sum() if chain else found.covariance[0, 0]))
    whole = {0, 1, 2} <= set(prepared.settings.components)
    scales = None
    if whole and np.isfinite(reference).all() and len(prepared.recorded.centres) >= _LEAST_JOINTS:
        base, map_ = (prepared.base, None) if chain is None else chain
        ratios = find_body_ratios(
            base,
            prepared.recorded.centres,
            reference,
            mass,
            usual,
            chain=None if map_ is None else (map_.matrix, map_.constant),
        )
        scales = check_scales(unsmoothed or prepared, movement.free, found, ratios)
    sd = {
        "gain": usual.estimate_gain_error(mass, mass_sd) if 1 in prepared.settings.components else usual.gain,
        "moments": usual.moments,
        "position": prepared.recorded.position_sd or usual.position,
        "lengths": usual.lengths,
        "tilt": usual.tilt,
    }
    for name in scales.suspects if scales is not None else ():
        sd[name] = max(sd.get(name, 0.0), abs(scales.causes[name].value)) if scales is not None else 0.0
    return found.add_calibration(propagate_calibration(prepared, found.fit, found.base, sd), scales)


def scale_facts(found: Identification) -> dict[str, Any] | None:
    """Return JSON of the check; None if it was not possible."""
    if found.scales is None:
        return None
    return {
        "suspects": list(found.scales.suspects),
        "causes": {name: asdict(cause) for name, cause in found.scales.causes.items()},
    }


def calibration_facts(found: Identification) -> list[list[float]] | None:
    """Return the part of the base parameters' covariance that the same instruments have in common."""
    return None if found.calibration is None else found.calibration.covariance.tolist()


def scale_reasons(found: Identification, given: float | None) -> tuple[Reason, ...]:
    """Return the cautions of the check, and a note if no mass is given that could show the plate's gain."""
    scales = found.scales
    if scales is None:
        return ()
    trust = () if given is not None else (_ON_TRUST,)
    if not scales.suspects:
        return trust
    first = scales.causes[scales.suspects[0]]
    named = len(scales.suspects) == 1
    if named:
        text = f"{_sentence(scales.suspects[0], first)}. {_CHECK[scales.suspects[0]]}"
    else:
        either = "; or ".join(_sentence(name, scales.causes[name]) for name in scales.suspects[:3])
        text = f"the data do not show which of these is wrong: {either}. Check them in this order"
    text += ". The standard deviations of the parameters contain an error of this size"
    value, limit = first.value, first.limit
    return (*trust, Reason("scale-error" if named else "scales-contradict", text, value=value, limit=limit))


_ON_TRUST = Reason(
    "scale-on-trust",
    "no mass of the person is given, so nothing in the recording shows an error of the plate's gain that is common to "
    "all channels: the scale of forces, torques and parameters is assumed to be right, to within "
    "`identify-dim: {plate_gain_sd: …}`. Give `subject: {mass: …}` from a scale to check it",
    level="ok",
)


def _sentence(name: str, cause: ScaleCause) -> str:
    """Return what is wrong, and by how much, if this cause is the only one."""
    value, sd = cause.value, cause.sd
    if name == "inertia":
        factor = max(1.0 + value, 0.05)
        rate = 100 * (factor**-0.5 - 1.0)
        return (
            f"the frame rate in the file is {_much(rate)} (inertial forces are {factor:.2f} ± {sd:.2f} times what the "
            "accelerations give)"
        )
    percent = f"{_much(100 * value)} (± {100 * sd:.1f} %)"
    sentences = {
        "moments": f"the plate's moments are {percent}",
        "vertical gain": f"the gain of the plate's vertical force is {percent}",
        "vertical force": f"the plate's vertical force has a constant error of {value:+.0f} ± {sd:.0f} N",
        "position": f"the plate is {1e3 * abs(value):.0f} ± {1e3 * sd:.0f} mm away from its place in the file",
        "lengths": f"distances between markers are {percent}",
        "tilt": f"the cameras' frame is tilted by {np.degrees(value):.1f}° ± {np.degrees(sd):.1f}° against gravity",
        "gain": f"all components of the plate's wrench are {percent}",
    }
    return sentences[name]


def _much(percent: float) -> str:
    return f"{abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"


_CHECK = {
    "inertia": "Compare the rates in the file (`POINT:RATE`, `ANALOG:RATE`) with those of the recording system",
    "moments": "Check the calibration matrix of the plate and the units of its moments",
    "vertical gain": "Check the calibration matrix and the amplifier of the plate's vertical channels",
    "vertical force": "Zero the plate without load before the trial, and check what else stands on it",
    "position": "Measure the corners of the plate again",
    "lengths": "Calibrate the cameras again, and check the length of the wand in their software",
    "tilt": "Set the cameras' frame again with its axis vertical",
    "gain": "Compare the plate with a known weight, and check `subject: {mass: …}`",
}
