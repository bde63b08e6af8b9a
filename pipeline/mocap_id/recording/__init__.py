"""Recordings of any lab, C3D or TRC with MOT, read into one form; and written."""

from mocap_id.recording.angle_table import AngleTable, read_angles
from mocap_id.recording.axes import to_z_up
from mocap_id.recording.decimation import Look, PlateSamples, averaging_width, decimate
from mocap_id.recording.encoder_log import EncoderLog, read_encoder
from mocap_id.recording.force_log import ForceLog, read_force_log
from mocap_id.recording.model import Plate, Recording
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.recording.reading import read
from mocap_id.recording.tables import MotionTable, read_table
from mocap_id.recording.text_writing import motion_text, trc_text
from mocap_id.recording.writing import write_c3d, write_trc

__all__ = [
    "AngleTable",
    "EncoderLog",
    "ForceLog",
    "Look",
    "MotionTable",
    "Plate",
    "PlateSamples",
    "PlateSignals",
    "Recording",
    "averaging_width",
    "decimate",
    "motion_text",
    "read",
    "read_angles",
    "read_encoder",
    "read_force_log",
    "read_table",
    "to_z_up",
    "trc_text",
    "write_c3d",
    "write_trc",
]
