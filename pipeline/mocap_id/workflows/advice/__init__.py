"""``mocap-id advise``: the movement to record next for more precise body parameters."""

from mocap_id.workflows.advice.advice import Advice, advise
from mocap_id.workflows.advice.options import AdviceOptions, parse_angle_range, parse_support
from mocap_id.workflows.advice.output import format_text, make_output

__all__ = ["Advice", "AdviceOptions", "advise", "format_text", "make_output", "parse_angle_range", "parse_support"]
