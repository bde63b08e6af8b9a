"""Joint states from markers (thesis chapter 3.2.6): process model, unscented filter, smoother, noise."""

from mocap_id.estimation.noise import Noise
from mocap_id.estimation.rivals import BRIDGE_LIMIT
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.estimation.smoothing import FRAMEWISE, Engine, FilterSettings, Method, States, smooth

__all__ = [
    "BRIDGE_LIMIT",
    "FRAMEWISE",
    "Engine",
    "FilterSettings",
    "Method",
    "Noise",
    "SigmaPoints",
    "States",
    "smooth",
]
