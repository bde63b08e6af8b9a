"""Joint states from markers (thesis chapter 3.2.6): process model, unscented Kalman filter, smoother, noise."""

from mocap_id.estimation.alternative_estimators import BRIDGE_LIMIT
from mocap_id.estimation.noise import FilterNoise
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.estimation.smoothing import FRAMEWISE, Engine, FilterSettings, Method, States, smooth

__all__ = [
    "BRIDGE_LIMIT",
    "FRAMEWISE",
    "Engine",
    "FilterNoise",
    "FilterSettings",
    "Method",
    "SigmaPoints",
    "States",
    "smooth",
]
