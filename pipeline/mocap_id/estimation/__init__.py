"""Joint states from markers, encoders and inertial sensors: unscented Kalman filter, smoother, noise (3.2.6)."""

from mocap_id.estimation.smoothing import BRIDGE_LIMIT, FRAMEWISE, FilterSettings, States, smooth

__all__ = ["BRIDGE_LIMIT", "FRAMEWISE", "FilterSettings", "States", "smooth"]
