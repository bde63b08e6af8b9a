"""``mocap-id transfer``: the model of one trial applied to other trials of the same person (thesis table 6.3)."""

from mocap_id.workflows.transfer.model_transfer import (
    HELD_OUT,
    OWN,
    TRANSFERRED,
    BodyErrors,
    Transfer,
    TrialTransfer,
    apply_model,
    errors_at_home,
    rms_error,
    transfer,
)
from mocap_id.workflows.transfer.support import SERIES
from mocap_id.workflows.transfer.table import as_frame, as_json, check_format, write

__all__ = [
    "HELD_OUT",
    "OWN",
    "SERIES",
    "TRANSFERRED",
    "BodyErrors",
    "Transfer",
    "TrialTransfer",
    "apply_model",
    "as_frame",
    "as_json",
    "check_format",
    "errors_at_home",
    "rms_error",
    "transfer",
    "write",
]
