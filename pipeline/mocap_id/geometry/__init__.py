"""Rigid-body geometry (thesis chapter 2): SO(3), SE(3), joints, chains, the plane; numpy alone."""

from mocap_id.geometry import planar, se3, so3
from mocap_id.geometry.chain import (
    Chain,
    body_jacobian,
    body_product,
    spatial_jacobian,
    spatial_product,
)
from mocap_id.geometry.joints import Joint, Revolute
from mocap_id.geometry.plane import PlaneFrame
from mocap_id.geometry.recursion import Loads, Motion, inverse_dynamics, link_wrench, motion, spatial_inertia

__all__ = [
    "Chain",
    "Joint",
    "Loads",
    "Motion",
    "PlaneFrame",
    "Revolute",
    "body_jacobian",
    "body_product",
    "inverse_dynamics",
    "link_wrench",
    "motion",
    "planar",
    "se3",
    "so3",
    "spatial_inertia",
    "spatial_jacobian",
    "spatial_product",
]
