"""Rigid-body geometry (thesis chapter 2): rotations, rigid motions, joints, chains and the plane of motion."""

from mocap_id.geometry import planar, se3, so3
from mocap_id.geometry.chain import (
    Ball,
    Chain,
    Revolute,
    body_jacobian,
    body_product,
    inverse_dynamics,
    link_motion,
    link_wrench,
    spatial_inertia,
    spatial_jacobian,
    spatial_product,
)
from mocap_id.geometry.planar import PlaneFrame

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
