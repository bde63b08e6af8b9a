"""A study: trials of several people with several strategies, and the tables of the thesis's chapter 6.

`discovery` and `draft` make the study's file from a folder of recordings. `study` runs the trials and writes the
results: `trial_results` reads the result of each trial, `tables` declares the tables, and the modules `*_table` make
their rows.
"""

from mocap_id.workflows.study.study import StudyResult, run_study

__all__ = ["StudyResult", "run_study"]
