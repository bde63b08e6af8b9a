"""Running many trials, here or on a cluster: a trial that fails is told and stops no other.

`one` runs a trial and says how it went, `engine` says where trials are run, `many` keeps them busy.
"""

from mocap_id.workflows.performing.engine import Dask, Engine, Here
from mocap_id.workflows.performing.many import OnError, Tell, perform_all
from mocap_id.workflows.performing.one import NOT_RUN, Performed, perform

__all__ = ["NOT_RUN", "Dask", "Engine", "Here", "OnError", "Performed", "Tell", "perform", "perform_all"]
