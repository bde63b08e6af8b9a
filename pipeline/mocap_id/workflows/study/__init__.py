"""A study: trials of several people by several strategies, and the tables of the thesis's chapter 6 over them.

`cases` reads what the trials left, one module a table says what stands in its rows, `columns`
what the columns are, `writing` makes files of them, `study` puts it together.
"""

from mocap_id.workflows.study.study import Outcome, run

__all__ = ["Outcome", "run"]
