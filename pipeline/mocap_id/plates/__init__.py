"""Force plates: which one the feet or the chair stand on, where it lies, and when it fails."""

from mocap_id.plates.choice import GRAVITY, PlateChoice, choose_plates, doubtful, standing_mass
from mocap_id.plates.seat import ZeroRule, empty_chair

__all__ = ["GRAVITY", "PlateChoice", "ZeroRule", "choose_plates", "doubtful", "empty_chair", "standing_mass"]
