"""A study of reaches: the reachable volume of several people and their clinical score (thesis table 7.1).

``mocap-id study`` runs the trials (:mod:`mocap_id.workflows.study`). Here, `trial_results` reads the result of each
trial, `tables` declares the tables, and `table_rows` and `correlation` make their rows.
"""

from mocap_id.workflows.reach_study.tables import make_tables
from mocap_id.workflows.reach_study.trial_results import make_page, read_reach_result

__all__ = ["make_page", "make_tables", "read_reach_result"]
