"""One trial: which stages have to run, what they read, where their outputs go, and what happens when one fails."""

from mocap_id.runner.execution import LOG_FILE, Outcome, Progress, Step, run, run_stage, run_to
from mocap_id.runner.log import RUN_LOG
from mocap_id.runner.rules import make_rules
from mocap_id.runner.status import Standing, Status, clean, status

__all__ = [
    "LOG_FILE",
    "RUN_LOG",
    "Outcome",
    "Progress",
    "Standing",
    "Status",
    "Step",
    "clean",
    "make_rules",
    "run",
    "run_stage",
    "run_to",
    "status",
]
