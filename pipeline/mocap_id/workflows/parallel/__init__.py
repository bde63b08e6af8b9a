"""Many trials in parallel, on this machine or on a cluster."""

from mocap_id.workflows.parallel.backends import Backend, DaskBackend, LocalBackend
from mocap_id.workflows.parallel.pool import OnError, TrialCallback, run_trials
from mocap_id.workflows.parallel.trial import NOT_RUN, TrialRun, run_trial

__all__ = [
    "NOT_RUN",
    "Backend",
    "DaskBackend",
    "LocalBackend",
    "OnError",
    "TrialCallback",
    "TrialRun",
    "run_trial",
    "run_trials",
]
