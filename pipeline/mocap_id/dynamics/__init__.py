"""Identification of inertial parameters from states and contact wrench (thesis chapter 4).

The steps, in order: :func:`preparation.prepare`, :func:`fit.fit`, :func:`identification.identify`,
:func:`prediction.predict`.
"""

from mocap_id.dynamics.base_parameters import BaseSet, base_names, base_set, base_units, full_names, structural_base
from mocap_id.dynamics.consistency import Consistency, ConsistentSolution
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.point_grid import PointGrid, segment_grid
from mocap_id.dynamics.prediction import Prediction
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData
from mocap_id.dynamics.regressor import (
    planar_regressor,
    planar_torque_regressor,
    spatial_regressor,
    spatial_torque_regressor,
)

__all__ = [
    "BaseSet",
    "Consistency",
    "ConsistentSolution",
    "Fit",
    "FitSettings",
    "Identification",
    "KinematicError",
    "PointGrid",
    "Prediction",
    "PreparedTrial",
    "TrialData",
    "base_names",
    "base_set",
    "base_units",
    "full_names",
    "planar_regressor",
    "planar_torque_regressor",
    "segment_grid",
    "spatial_regressor",
    "spatial_torque_regressor",
    "structural_base",
]
