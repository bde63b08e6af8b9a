"""Joint states from markers (thesis chapter 3.2.6): process model, unscented filter, smoother, noise."""

from mocap_id.estimation.noise import Noise
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.estimation.smoothing import Engine, FilterSettings, States, smooth

__all__ = ["Engine", "FilterSettings", "Noise", "SigmaPoints", "States", "smooth"]
