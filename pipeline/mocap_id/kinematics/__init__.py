"""Chains from marker trajectories, in the plane and (``space``) in space: bodies, segments, joints (3.2.3 to 3.2.5)."""

from mocap_id.kinematics.base_motion import propose_window
from mocap_id.kinematics.bundle import LinkMethod, fit_chain, fit_links, frames_along_motion, frames_over_time
from mocap_id.kinematics.chain_fit import ChainFit, ChainState, joint_angles, orient_frames
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.joint import measure_asymmetry
from mocap_id.kinematics.link_fit import Hypothesis, SegmentationRules
from mocap_id.kinematics.marker_faults import Swap, find_bursts, find_swaps, undo_swaps
from mocap_id.kinematics.plane import PlaneFit, fit_plane
from mocap_id.kinematics.segmentation import Segmentation, segment_markers
from mocap_id.kinematics.skin_slides import SkinModel, angle_errors, fit_skin, skin_from_residuals

__all__ = [
    "ChainFit",
    "ChainState",
    "Constraints",
    "Hypothesis",
    "LinkMethod",
    "PlaneFit",
    "Segmentation",
    "SegmentationRules",
    "SkinModel",
    "Swap",
    "angle_errors",
    "find_bursts",
    "find_swaps",
    "fit_chain",
    "fit_links",
    "fit_plane",
    "fit_skin",
    "frames_along_motion",
    "frames_over_time",
    "joint_angles",
    "measure_asymmetry",
    "orient_frames",
    "propose_window",
    "segment_markers",
    "skin_from_residuals",
    "undo_swaps",
]
