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

__all__ = [
    "HELD_OUT",
    "OWN",
    "SERIES",
    "TRANSFERRED",
    "BodyErrors",
    "Transfer",
    "TrialTransfer",
    "apply_model",
    "errors_at_home",
    "rms_error",
    "transfer",
]
