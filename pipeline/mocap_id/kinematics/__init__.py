"""From trajectories to a chain: plane, window, rigid bodies, segments, joints (ch. 3.2.3-3.2.5)."""

from mocap_id.kinematics.bundle import fit_chain
from mocap_id.kinematics.bursts import find_bursts
from mocap_id.kinematics.chain_fit import ChainFit, fix_gauge, joint_angles
from mocap_id.kinematics.hypotheses import Hypothesis, SegmentationRules
from mocap_id.kinematics.plane import PlaneFit, fit_plane
from mocap_id.kinematics.segmentation import Segmentation, segment_markers
from mocap_id.kinematics.symmetry import asymmetry
from mocap_id.kinematics.window import propose_window

__all__ = [
    "ChainFit",
    "Hypothesis",
    "PlaneFit",
    "Segmentation",
    "SegmentationRules",
    "asymmetry",
    "find_bursts",
    "fit_chain",
    "fit_plane",
    "fix_gauge",
    "joint_angles",
    "propose_window",
    "segment_markers",
]
