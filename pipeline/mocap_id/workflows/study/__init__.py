"""Studies: trials of several people or of a robot, and the tables of the thesis's chapters 5 to 8.

`discovery` makes a study's file from a folder of recordings. `study` averages over trials and people, runs the trials
and writes the results. A study of sit-to-stand, of one arm (curls, reaches) or of a robot has one module each, which is
read from top to bottom: the result of a trial, the rows, and the tables with their columns.
"""

from mocap_id.workflows.study.study import StudyResult, run_study

__all__ = ["StudyResult", "run_study"]
