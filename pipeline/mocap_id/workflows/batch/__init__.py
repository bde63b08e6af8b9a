"""A batch: trials of files, folders, patterns or a study, run wherever there are workers, and one table over them.

`finding` makes trials of what the user names, `table` says what stands in a row, `batch` puts it together.
"""

from mocap_id.workflows.batch.batch import Batch, run
from mocap_id.workflows.batch.finding import find
from mocap_id.workflows.batch.table import BATCH

__all__ = ["BATCH", "Batch", "find", "run"]
