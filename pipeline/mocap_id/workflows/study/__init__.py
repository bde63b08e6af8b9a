"""Studies: trials of several people or of a robot, and the tables of the thesis's chapters 5 to 8.

`discovery` makes a study's file from a folder of recordings. `study` runs the trials and writes the results. A study of
sit-to-stand, of reaches, of curls or of a robot has one module each, which is read from top to bottom: the result of a
trial, the rows, and the tables with their columns. `pooling` averages over trials and people.
"""

from mocap_id.workflows.study.study import StudyResult, run_study

__all__ = ["StudyResult", "run_study"]
