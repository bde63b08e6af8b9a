"""Prior of the foot's first moment, which the ankle's torque needs, and a caution about torques that may be wrong.

The data hardly separate the small first moment of the foot from the first moments of the segments above it. This is
worst with one or two marker positions on shank and thigh, as in conventional marker sets.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, as_complex
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.dynamics_artefacts import IdentifiedDynamics
from mocap_id.stages.identify_dim.scales import read_calibration
from mocap_id.stages.identify_dim.trial_data import read_joint_names, read_skeleton
from mocap_id.verdict import Reason

_FOOT_PRIOR = Reason(
    "foot-prior",
    "a segment has markers at only one or two positions. The foot's first moment is therefore taken from the reference "
    "body and the position of the ankle, not from the data alone; the torque of the ankle then follows from the centre "
    "of pressure. Set `identify-dim: {reference_pulls: false}` to use the data alone",
    level="ok",
)
_FOOT_IN_TORQUES = Reason(
    "foot-prior",
    "the torques also use the first moment of the reference body's foot, which the data hardly determine; parameters "
    "and wrench depend on the data alone. Set `identify-dim: {reference_pulls: false}` to use the data alone for both",
    level="ok",
)
_FEW = 3  # marker positions on a segment; clusters have at least as many
_FOOT_SD = 0.001  # m; from the variation of people's feet, which have 3 % of the body's mass
_TORQUE = 5.0  # N·m, largest rms error of a torque without a caution
_ONE_IN_100 = 2.576  # standard deviations that a normal error exceeds in one of 100 cases


def has_few_markers(context: Context) -> bool:
    """Return whether a moving segment of a person has markers at only one or two positions."""
    chain = read_skeleton(context)
    local = as_complex(chain.local)
    counts = [count_positions(local[chain.marker_segment == k]) for k in range(1, len(chain.centres) + 1)]
    return context.trial.protocol != "robot-joint" and min(counts) < _FEW


def choose_foot_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the standard deviation of the foot's first moment divided by the body's mass, m; None without this prior.

    A robot has no prior, and neither has a person if the standard deviation of the ankle's position is unknown. With
    measured forces of a chair or on a hand, there is a prior only for few markers, because other cases were not tested.
    """
    chosen, covariance = context.settings.reference_pulls, read_skeleton(context).covariance
    if chosen not in {None, "foot"} or context.trial.protocol == "robot-joint" or not np.isfinite(covariance[:1]).any():
        return None
    if chosen is None and recorded.external and not has_few_markers(context):
        return None
    return float(np.hypot(_FOOT_SD, np.sqrt(covariance[0, 0, 0])))


def choose_plate_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the standard deviation of the plate's position, m, if only the torques use the foot's prior, else None.

    With few markers, the parameters also need the prior.
    """
    if has_few_markers(context) or context.settings.reference_pulls == "foot":
        return None
    return recorded.position_sd or read_calibration(context).position


def explain_foot_prior(context: Context, found: Identification) -> tuple[Reason, ...]:
    """Return a note if parameters or torques use the prior of the foot; an empty tuple if they do not."""
    if found.with_foot is not None:
        return (_FOOT_IN_TORQUES,)
    foot_alone = found.uses_reference and context.settings.reference_pulls is not True
    return (_FOOT_PRIOR,) if foot_alone else ()


def check_torques(context: Context, result: IdentifiedDynamics, free: BoolArray) -> tuple[Reason, ...]:
    """Return a caution about torques of the pinned chain that may be wrong by more than 5 N·m rms.

    The errors of parameters and geometry are constant in a trial and normal over trials; errors of the motion add their
    mean square. The caution is for torques whose error exceeds 5 N·m in more than one of 100 trials. Errors of scale
    are left out, because they are the same in all trials of a laboratory. ``free`` (T,) marks the samples in which only
    the ground touches the body.
    """
    model = result.model
    used = free & np.isfinite(model.torque_sd).any(axis=1)
    untested = bool(result.prepared.recorded.external) and not has_few_markers(context)
    if context.trial.protocol == "robot-joint" or untested or result.measured_poses or not used.any():
        return ()
    constant, noise = (np.nanmean(sd[used] ** 2, axis=0) for sd in (model.torque_lasting_sd, model.torque_noise_sd))
    measured = result.prepared.measured(result.found.fit.offset)
    off = np.asarray((measured - model.wrench)[:, WRENCH_COMPONENTS.index("tauz")])
    excess = max(float(np.nanmean(off[used] ** 2) - np.mean(off[result.found.fit.in_fit] ** 2)), 0.0)
    error = np.sqrt(_ONE_IN_100**2 * constant + noise + excess)
    large = np.flatnonzero(error > _TORQUE)
    if not len(large):
        return ()
    names = read_joint_names(context)
    text = ", ".join(f"{names[j]} {error[j]:.1f} N·m" for j in large)
    worst = large[np.argmax(error[large])]
    why = "The positions of the joints and the masses of the segments after them are uncertain"
    if excess > _ONE_IN_100**2 * constant[worst]:
        at = result.prepared.recorded.time[used][np.nanargmax(np.abs(off[used]))]
        why = f"The model differs from the plate around {at:.1f} s: fill marker gaps there, or exclude it by `window:`"
    message = (
        f"in one of 100 trials like this one, the rms error of a torque exceeds these values: {text} (expected at most "
        f"{_TORQUE:g} N·m). {why}. Use the torques with their intervals"
    )
    return (Reason("torque-uncertain", message, float(error[worst]), _TORQUE),)
