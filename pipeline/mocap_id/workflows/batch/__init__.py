"""A batch: trials from files, folders, patterns or a study, run in parallel, and one table of them.

`trial_files` finds the trials, `table` declares the table, and `batch` runs the trials.
"""

from mocap_id.workflows.batch.batch import Batch, run_batch
from mocap_id.workflows.batch.named_trials import find_trials
from mocap_id.workflows.batch.table import BATCH

__all__ = ["BATCH", "Batch", "find_trials", "run_batch"]
