"""Checks of force plates: which are under the feet or a chair, where they are, and when they fail.

Sign convention: all forces are those of the ground (or chair) on the body, not of the body on the plate.
"""

from mocap_id.plates.choice import GRAVITY, PlateChoice, choose_plates, find_contradictions, standing_mass
from mocap_id.plates.seat import ZeroRule, measure_empty_chair

__all__ = [
    "GRAVITY",
    "PlateChoice",
    "ZeroRule",
    "choose_plates",
    "find_contradictions",
    "measure_empty_chair",
    "standing_mass",
]
