"""Identification of inertial parameters from states and contact wrench (thesis chapter 4).

The functions are called in this order: :func:`preparation.prepare`, :func:`fit.fit`, :func:`identification.identify`,
:func:`prediction.predict`.

Shapes: T samples, R of them in the fit, n joints, K bodies (the n + 1 segments of a chain, base first), c fitted
components of the wrench, b base parameters, k constant errors of the plate, S error modes (independent errors of one
standard deviation each). Units are SI: m, rad, kg, N, N·m and s. Missing values are NaN.

Many functions have these arguments. A docstring describes an argument only if it differs from this list.

prepared, trial : PreparedTrial, SpatialTrial
    A trial in the plane or in space, with regressor and filtered signals.
gate : (T,) bool array
    True for samples in which the body touches only the ground.
result : Fit or Identification
    Result of the fit, or identified parameters.
base : (b,) array
    Base parameters.
full : (4K,) array
    Full parameters: m, mx, my, Izz of every body about the origin of its frame. In space there are ten for each body.
centres : (n, 2) array
    Centre of each joint in the frame of the segment before it.
q, dq, ddq : (T, n) arrays
    Joint angles and their time derivatives.
grid : PointGrid
    Grid of point masses.
error : KinematicError
    Uncertainty of the geometry.
"""

from mocap_id.dynamics.base_parameters import base_names, structural_base
from mocap_id.dynamics.consistency import PointGrid
from mocap_id.dynamics.regressor import planar_regressor, spatial_regressor

__all__ = ["PointGrid", "base_names", "planar_regressor", "spatial_regressor", "structural_base"]
