"""From states and wrench to inertial parameters: regressor, base parameters, consistency, clock, allometry (ch. 4).

The order of the computation is :mod:`prepare`, :mod:`fit`, :mod:`identify`, :mod:`predict`, each a module with the
function of its name.
"""

from mocap_id.dynamics.base import BaseSet, base_names, base_set, base_units, full_names, structural_base
from mocap_id.dynamics.consistent import Consistency, Solution
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.predict import Prediction
from mocap_id.dynamics.prepare import FitSettings, Prepared, Recorded
from mocap_id.dynamics.regressor import (
    planar_regressor,
    planar_torque_regressor,
    spatial_regressor,
    spatial_torque_regressor,
)

__all__ = [
    "BaseSet",
    "Consistency",
    "Fit",
    "FitSettings",
    "Identification",
    "KinematicError",
    "PointGrid",
    "Prediction",
    "Prepared",
    "Recorded",
    "Solution",
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
