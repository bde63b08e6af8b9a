"""Joint states from markers (thesis chapter 3.2.6): process model, unscented Kalman filter, smoother, noise."""

from mocap_id.estimation.alternative_estimators import BRIDGE_LIMIT
from mocap_id.estimation.smoothing import FRAMEWISE, FilterSettings, States, smooth

__all__ = ["BRIDGE_LIMIT", "FRAMEWISE", "FilterSettings", "States", "smooth"]
