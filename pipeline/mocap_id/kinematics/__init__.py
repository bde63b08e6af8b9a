"""From trajectories to a chain: plane, window, rigid bodies, segments, joints (ch. 3.2.3-3.2.5)."""

from mocap_id.kinematics.bundle import fit_chain
from mocap_id.kinematics.bursts import find_bursts
from mocap_id.kinematics.chain_equations import State
from mocap_id.kinematics.chain_fit import ChainFit, fix_gauge, joint_angles
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.hypotheses import Hypothesis, SegmentationRules
from mocap_id.kinematics.links import LinkMethod, fit_links
from mocap_id.kinematics.plane import PlaneFit, fit_plane
from mocap_id.kinematics.sampling import frames_along_motion
from mocap_id.kinematics.segmentation import Segmentation, segment_markers
from mocap_id.kinematics.skin_errors import angle_errors
from mocap_id.kinematics.skin_slides import SkinModel, skin_model, skin_without_fit
from mocap_id.kinematics.swaps import Swap, find_swaps, repair
from mocap_id.kinematics.symmetry import asymmetry
from mocap_id.kinematics.window import propose_window

__all__ = [
    "ChainFit",
    "Constraints",
    "Hypothesis",
    "LinkMethod",
    "PlaneFit",
    "Segmentation",
    "SegmentationRules",
    "SkinModel",
    "State",
    "Swap",
    "angle_errors",
    "asymmetry",
    "find_bursts",
    "find_swaps",
    "fit_chain",
    "fit_links",
    "fit_plane",
    "fix_gauge",
    "frames_along_motion",
    "joint_angles",
    "propose_window",
    "repair",
    "segment_markers",
    "skin_model",
    "skin_without_fit",
]
