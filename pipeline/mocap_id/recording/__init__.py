"""Recordings of any lab, C3D or TRC with MOT, read into one form; and written."""

from mocap_id.recording.choice import PlateChoice, choose_plates, standing_mass
from mocap_id.recording.decimation import PlateSamples, decimate
from mocap_id.recording.description import describe
from mocap_id.recording.model import Plate, Recording
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.reading import read
from mocap_id.recording.tables import MotionTable, read_table
from mocap_id.recording.writing import write_c3d, write_trc

__all__ = [
    "MotionTable",
    "Plate",
    "PlateChoice",
    "PlateSamples",
    "PlateSignals",
    "Recording",
    "choose_plates",
    "decimate",
    "describe",
    "read",
    "read_table",
    "standing_mass",
    "write_c3d",
    "write_trc",
]
