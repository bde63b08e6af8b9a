"""Check of the scales of plate, cameras and clocks, and effect of their errors on the standard deviations."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import BaseSet
from mocap_id.dynamics.body_ratios import find_body_ratios
from mocap_id.dynamics.chain_parameters import ChainMap
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import Calibration, ScaleCause, propagate_calibration
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.scale_check import check_scales
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.verdict import Reason

_PERSON, _ROBOT = 0.005, 0.001  # m: standard deviation of a plate's position under a person, and under a bolted robot
_LEAST_JOINTS = 2  # ankle and knee, because the ratios of a person need a shank


def read_calibration(context: Context) -> Calibration:
    """Return the standard deviations of the errors of scale of plate and cameras, from the settings."""
    settings: IdentifyDimSettings = context.settings
    position = settings.plate_position_sd_m
    if position is None:
        position = _ROBOT if context.trial.protocol == "robot-joint" else _PERSON
    return Calibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
        position=position,
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
    """Return the identification with the result of the check of scales, and with errors of scale in its covariance.

    If the check suspects an error, the covariance contains the error at the size that the check has estimated.

    Parameters
    ----------
    reference : (4(n + 1),) array
        Full parameters of the reference body with the chain; without a reference body (NaN), there is no check.
    chain : (BaseSet, ChainMap), optional
        Base parameters of the chain, and the map from the bodies to them; for measured poses.
    unsmoothed : PreparedTrial, optional
        Trial with nearly unfiltered poses for the check, because the low-pass of the fit reduces accelerations.
    """
    usual = read_calibration(context)
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
    if scales is not None:
        sd |= {name: max(sd.get(name, 0.0), abs(scales.causes[name].value)) for name in scales.suspects}
    return found.add_calibration(propagate_calibration(prepared, found.fit, found.base, sd), scales)


def make_scale_facts(found: Identification) -> dict[str, Any]:
    """Return JSON about the check, and the part of the base parameters' covariance that comes from errors of scale."""
    scales = None
    if found.scales is not None:
        causes = {name: asdict(cause) for name, cause in found.scales.causes.items()}
        scales = {"suspects": list(found.scales.suspects), "causes": causes}
    covariance = None if found.calibration is None else found.calibration.covariance.tolist()
    return {"scales": scales, "calibration_covariance": covariance}


def explain_scales(found: Identification, given: float | None, *, stands: bool) -> tuple[Reason, ...]:
    """Return a caution about suspected errors of scale, and a note if the user has not given the mass ``given``, kg.

    ``stands`` says whether the plates or a balance board measure a standing person.
    """
    scales = found.scales
    trust = () if given is not None or not (stands or scales is not None) else (ON_TRUST,)
    if scales is None or not scales.suspects:
        return trust
    first = scales.causes[scales.suspects[0]]
    certain = len(scales.suspects) == 1
    if certain:
        text = f"{_describe_cause(scales.suspects[0], first)}. {_CHECK[scales.suspects[0]]}"
    else:
        either = "; or ".join(_describe_cause(name, scales.causes[name]) for name in scales.suspects[:3])
        text = f"the data do not determine which of these is wrong: {either}. Check them in this order"
    text += ". The standard deviations of the parameters contain an error of this size"
    value, limit = first.value, first.limit
    return (*trust, Reason("scale-error" if certain else "scales-contradict", text, value=value, limit=limit))


ON_TRUST = Reason(
    "scale-on-trust",
    "the mass of the person is not given, so the gain of all channels of the plate cannot be checked: the scale of "
    "forces, torques and parameters is assumed to be right, with the standard deviation `identify-dim: {plate_gain_sd: "
    "…}`. Weigh the person and give `subject: {mass: …}` to check it",
    level="ok",
)


def _describe_cause(name: str, cause: ScaleCause) -> str:
    """Return a text with the error and the size that it has if only this cause is wrong."""
    value, sd = cause.value, cause.sd
    if name == "inertia":
        factor = max(1.0 + value, 0.05)
        rate = 100 * (factor**-0.5 - 1.0)
        return (
            f"the frame rate in the file is {_describe_size(rate)} (inertial forces are {factor:.2f} ± {sd:.2f} times "
            "those computed from the accelerations)"
        )
    percent = f"{_describe_size(100 * value)} (± {100 * sd:.1f} %)"
    sentences = {
        "moments": f"the plate's moments are {percent}",
        "vertical gain": f"the gain of the plate's vertical force is {percent}",
        "vertical force": f"the plate's vertical force has a constant error of {value:+.0f} ± {sd:.0f} N",
        "position": f"the plate is {1e3 * abs(value):.0f} ± {1e3 * sd:.0f} mm away from its position in the file",
        "lengths": f"distances between markers are {percent}",
        "tilt": f"the cameras' axes are tilted by {np.degrees(value):.1f}° ± {np.degrees(sd):.1f}° against gravity",
        "gain": f"all components of the plate's wrench are {percent}",
    }
    return sentences[name]


def _describe_size(percent: float) -> str:
    return f"{abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"


_CHECK = {
    "inertia": "Compare the rates in the file (`POINT:RATE`, `ANALOG:RATE`) with the rates of the recording system",
    "moments": "Check the calibration matrix of the plate and the units of its moments",
    "vertical gain": "Check the calibration matrix and the amplifier of the plate's vertical channels",
    "vertical force": "Zero the plate without load before the trial, and check that no other object is on it",
    "position": "Measure the corners of the plate again",
    "lengths": "Calibrate the cameras again, and check the length of the wand in their software",
    "tilt": "Set the origin and axes of the cameras again with a vertical axis",
    "gain": "Compare the plate with a known weight, and check `subject: {mass: …}`",
}
