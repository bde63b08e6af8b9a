"""The springs that restore the largest part of the range of a joint or a chain (thesis 7.3, 7.4)."""

from mocap_id.workflows.prescribe.computation import prescribe_from
from mocap_id.workflows.prescribe.device_output import device_lines
from mocap_id.workflows.prescribe.output import prescription_output
from mocap_id.workflows.prescribe.result import PrescriptionResult

__all__ = ["PrescriptionResult", "device_lines", "prescribe_from", "prescription_output"]
