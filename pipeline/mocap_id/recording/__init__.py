"""Readers and writers of recordings: C3D, TRC, exports of QTM, Motive and Nexus, MOT, and CSV logs of sensors."""

from mocap_id.recording.lab_plates import PlateSamples, PlateSignals, ThinnedFrames, compute_averaging_width, decimate
from mocap_id.recording.model import Plate, Recording, to_z_up
from mocap_id.recording.reader import is_marker_text, read
from mocap_id.recording.sensor_logs import (
    CELLS_BELOW_SURFACE_M,
    BoardLog,
    read_angles,
    read_board,
    read_encoder,
    read_force_log,
)
from mocap_id.recording.text_tables import read_table
from mocap_id.recording.writer import (
    format_motion_table,
    format_trc,
    write_c3d,
    write_recording,
    write_recording_as_text,
    write_trc,
)

__all__ = [
    "CELLS_BELOW_SURFACE_M",
    "BoardLog",
    "Plate",
    "PlateSamples",
    "PlateSignals",
    "Recording",
    "ThinnedFrames",
    "compute_averaging_width",
    "decimate",
    "format_motion_table",
    "format_trc",
    "is_marker_text",
    "read",
    "read_angles",
    "read_board",
    "read_encoder",
    "read_force_log",
    "read_table",
    "to_z_up",
    "write_c3d",
    "write_recording",
    "write_recording_as_text",
    "write_trc",
]
