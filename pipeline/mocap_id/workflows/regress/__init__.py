"""Recorded trials run anew and held against the numbers of a baseline: has an answer moved?

`quantities` takes the headline numbers from a summary, each with a tolerance; `baseline` is the file; `regress` runs
the trials and compares.
"""

from mocap_id.workflows.regress.baseline import Baseline
from mocap_id.workflows.regress.regress import Moved, Regression, regress, update

__all__ = ["Baseline", "Moved", "Regression", "regress", "update"]
