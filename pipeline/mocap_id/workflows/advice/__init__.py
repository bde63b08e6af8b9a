"""``mocap-id advise``: the movement to record next, so that the parameters of the body become better known."""

from mocap_id.workflows.advice.advice import Advice, advise
from mocap_id.workflows.advice.options import AdviceOptions, angle_range, support_range
from mocap_id.workflows.advice.output import advice_output, lines

__all__ = ["Advice", "AdviceOptions", "advice_output", "advise", "angle_range", "lines", "support_range"]
