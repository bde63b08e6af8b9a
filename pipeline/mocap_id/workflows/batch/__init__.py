"""A batch: trials from files, folders, patterns or a study, run in parallel, and one table of their results."""

from mocap_id.workflows.batch.batch import BATCH, Batch, run_batch
from mocap_id.workflows.batch.named_trials import find_readable_trials, find_trials

__all__ = ["BATCH", "Batch", "find_readable_trials", "find_trials", "run_batch"]
