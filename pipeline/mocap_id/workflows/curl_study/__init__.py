"""A study of curls: repetitions and compensation of several people under several conditions (thesis 8.3, figure 8.5).

``mocap-id study`` runs the trials (:mod:`mocap_id.workflows.study`). Here, `trial_results` reads the result of each
trial, `tables` declares the tables, and `table_rows` makes their rows.
"""

from mocap_id.workflows.curl_study.tables import make_tables
from mocap_id.workflows.curl_study.trial_results import read_curl_result

__all__ = ["make_tables", "read_curl_result"]
