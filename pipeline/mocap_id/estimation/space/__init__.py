"""Joint states of chains in space: a Kalman filter and smoother on rotations."""

from mocap_id.estimation.space.space_smoothing import SpatialSettings, SpatialStates, smooth_in_space
from mocap_id.estimation.space.spatial_noise import SpatialNoise

__all__ = ["SpatialNoise", "SpatialSettings", "SpatialStates", "smooth_in_space"]
