"""Joint states from markers, encoders and inertial sensors: unscented Kalman filter, smoother, noise (3.2.6)."""

from mocap_id.estimation.alternative_estimators import BRIDGE_LIMIT
from mocap_id.estimation.smoothing import FRAMEWISE, FilterSettings, States, smooth

__all__ = ["BRIDGE_LIMIT", "FRAMEWISE", "FilterSettings", "States", "smooth"]
