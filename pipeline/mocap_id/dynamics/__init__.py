"""Identification of inertial parameters from states and contact wrench (thesis chapter 4).

The steps, in order: :func:`preparation.prepare`, :func:`fit.fit`, :func:`identification.identify`,
:func:`prediction.predict`.
"""

from mocap_id.dynamics.base_parameters import base_names, structural_base
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.regressor import planar_regressor, spatial_regressor

__all__ = ["PointGrid", "base_names", "planar_regressor", "spatial_regressor", "structural_base"]
