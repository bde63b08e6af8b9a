"""Regression check: recompute trials and compare their main results with a baseline."""

from mocap_id.workflows.regress.baseline import Baseline
from mocap_id.workflows.regress.regression_check import Change, Regression, regress, update

__all__ = ["Baseline", "Change", "Regression", "regress", "update"]
