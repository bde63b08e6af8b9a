"""Joint states of chains in space: a Kalman filter and smoother on rotations."""

from mocap_id.estimation.space.space_smoothing import SpatialSettings, SpatialStates, smooth_in_space

__all__ = ["SpatialSettings", "SpatialStates", "smooth_in_space"]
