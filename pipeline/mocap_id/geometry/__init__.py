"""Rigid-body geometry (thesis chapter 2): SO(3), SE(3), joints, chains and the plane frame. Only numpy is needed."""

from mocap_id.geometry import planar, se3, so3
from mocap_id.geometry.ball import Ball
from mocap_id.geometry.chain import (
    Chain,
    body_jacobian,
    body_product,
    spatial_jacobian,
    spatial_product,
)
from mocap_id.geometry.joints import Revolute
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.geometry.recursion import (
    inverse_dynamics,
    link_motion,
    link_wrench,
    spatial_inertia,
)

__all__ = [
    "Ball",
    "Chain",
    "PlaneFrame",
    "Revolute",
    "body_jacobian",
    "body_product",
    "inverse_dynamics",
    "link_motion",
    "link_wrench",
    "planar",
    "se3",
    "so3",
    "spatial_inertia",
    "spatial_jacobian",
    "spatial_product",
]
