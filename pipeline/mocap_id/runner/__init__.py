"""Runs of one trial: reuse of earlier results, computation, writing, refusals and failures."""

from mocap_id.runner.dependencies import make_rules
from mocap_id.runner.execution import LOG_FILE, RUN_LOG, Outcome, Progress, Step, run, run_stage, run_to
from mocap_id.runner.status import TrialStatus, clean, status

__all__ = [
    "LOG_FILE",
    "RUN_LOG",
    "Outcome",
    "Progress",
    "Step",
    "TrialStatus",
    "clean",
    "make_rules",
    "run",
    "run_stage",
    "run_to",
    "status",
]
