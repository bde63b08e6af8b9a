"""The prior of the foot, which the torque of an ankle needs, and a caution about torques that may be wrong.

The data hardly separate the small first moment of the foot from the moments above it, least of all with one or two
marker places on shank and thigh, as in conventional marker sets.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.dynamics_artefacts import IdentifiedDynamics
from mocap_id.stages.identify_dim.scales import calibration
from mocap_id.stages.identify_dim.trial_data import joint_names, read_skeleton
from mocap_id.verdict import Reason

_FOOT_PRIOR = Reason(
    "foot-prior",
    "a segment has markers at one or two places only, so the foot's first moment is taken from the reference body and "
    "the place of the ankle, not from the data alone: the torque of the ankle then follows from the centre of "
    "pressure. Set `identify-dim: {reference_pulls: false}` to use the data alone",
    level="ok",
)
_FOOT_IN_TORQUES = Reason(
    "foot-prior",
    "the torques also use the foot's first moment of the reference body, which the data hardly show; parameters and "
    "wrench depend on the data alone. Set `identify-dim: {reference_pulls: false}` to use the data alone for both",
    level="ok",
)
_FEW = 3  # places of markers on a segment: clusters have as many or more
_FOOT_SD = 0.001  # m; from people's feet, whose mass is 3 % of the body's
_TORQUE = 5.0  # N·m, rms
_ONE_IN_100 = 2.576  # standard deviations that a normal error exceeds in one of 100 cases


def few_markers(context: Context) -> bool:
    """Return whether a moving segment of a person has markers at one or two places only."""
    chain = read_skeleton(context)
    local = as_complex(chain.local)
    places = [count_positions(local[chain.marker_segment == k]) for k in range(1, len(chain.centres) + 1)]
    return context.trial.protocol != "robot-joint" and min(places) < _FEW


def foot_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the deviation of the foot's first moment in relation to the mass, m; None if the data alone determine it.

    It is known from the place of the ankle, if this has a standard deviation. A robot has no foot. With measured forces
    of a chair or on a hand, the prior is for few markers only: others were not measured.
    """
    chosen, covariance = context.settings.reference_pulls, read_skeleton(context).covariance
    if chosen not in {None, "foot"} or context.trial.protocol == "robot-joint" or not np.isfinite(covariance[:1]).any():
        return None
    if chosen is None and recorded.external and not few_markers(context):
        return None
    return float(np.hypot(_FOOT_SD, np.sqrt(covariance[0, 0, 0])))


def plate_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the error of the plate's place, m, if the prior of the foot is for the torques alone.

    With few markers the data show the foot's first moment so badly that the parameters need the prior too.
    """
    if few_markers(context) or context.settings.reference_pulls == "foot":
        return None
    return recorded.position_sd or calibration(context).position


def foot_notes(context: Context, found: Identification) -> tuple[Reason, ...]:
    """Return a note if the foot has a prior."""
    if found.with_foot is not None:
        return (_FOOT_IN_TORQUES,)
    foot_alone = found.uses_reference and context.settings.reference_pulls is not True
    return (_FOOT_PRIOR,) if foot_alone else ()


def torque_reasons(context: Context, result: IdentifiedDynamics, free: BoolArray) -> tuple[Reason, ...]:
    """Return a caution about torques of the pinned chain that may be wrong by more than 5 N·m rms.

    In a trial, parameters and geometry have one error, which is normal; errors of the motion add their mean square. The
    caution is about torques whose error exceeds 5 N·m in more than one of 100 such trials. Errors of scale are the same
    in all trials of a laboratory and do not count.

    Parameters
    ----------
    context : Context
    result : IdentifiedDynamics
    free : (T,) bool array
        Samples in which only the ground touches the body.
    """
    model = result.model
    shown = free & np.isfinite(model.torque_sd).any(axis=1)
    untried = bool(result.prepared.recorded.external) and not few_markers(context)  # no such trial was measured
    if context.trial.protocol == "robot-joint" or untried or result.measured_poses or not shown.any():
        return ()
    lasting, noise = (np.nanmean(sd[shown] ** 2, axis=0) for sd in (model.torque_lasting_sd, model.torque_noise_sd))
    off = _moment_residual(result)
    beyond = max(float(np.nanmean(off[shown] ** 2) - np.mean(off[result.found.fit.in_fit] ** 2)), 0.0)
    error = np.sqrt(_ONE_IN_100**2 * lasting + noise + beyond)
    loose = np.flatnonzero(error > _TORQUE)
    if not len(loose):
        return ()
    names = joint_names(context)
    text = ", ".join(f"{names[j]} {error[j]:.1f} N·m" for j in loose)
    worst = loose[np.argmax(error[loose])]
    why = "The places of the joints and the masses beyond them are uncertain"
    if beyond > _ONE_IN_100**2 * lasting[worst]:
        at = result.prepared.recorded.time[shown][np.nanargmax(np.abs(off[shown]))]
        why = f"The model does not follow the plate around {at:.1f} s: fill markers there, or leave it out by `window:`"
    message = (
        f"in one of 100 trials like this one, the rms error of a torque exceeds these values: {text} (expected at most "
        f"{_TORQUE:g} N·m). {why}. Use the torques with their intervals"
    )
    return (Reason("torque-uncertain", message, float(error[worst]), _TORQUE),)


def _moment_residual(result: IdentifiedDynamics) -> FloatArray:
    """Return the measured minus the modelled moment (T,), N·m."""
    measured = result.prepared.measured(result.found.fit.offset)
    return np.asarray((measured - result.model.wrench)[:, WRENCH_COMPONENTS.index("tauz")])
