"""Rules and constraints of the segmentation from its settings, and the caution about doubtful segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.kinematics import Constraints, SegmentationRules
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings
from mocap_id.verdict import Reason

UNSURE = 0.5
"""Confidence below which there is a caution."""


def make_rules(settings: SegmentSettings, longest: int) -> SegmentationRules:
    """Return the limits of the search for segments; ``longest`` is the largest number of segments of the protocol."""
    return SegmentationRules(
        still_limit=settings.still_limit_m,
        min_arc=float(np.radians(settings.min_arc_deg)),
        max_residual=settings.max_joint_residual_m,
        max_body_residual=settings.max_body_residual_m,
        count=settings.count,
        longest=settings.count or longest,
    )


def make_constraints(
    labels: tuple[str, ...], settings: SegmentSettings, known: Sequence[list[int]] = ()
) -> Constraints:
    """Return the hints `together` and `apart` with marker indices. Each group in ``known`` is also on one segment.

    Raises ConfigError if the hints contradict each other.
    """
    together = [*(find_markers(labels, group, "segment: together") for group in settings.together), *known]
    apart = [find_markers(labels, group, "segment: apart") for group in settings.apart]
    constraints = Constraints.of(len(labels), together, apart)
    if constraints.contradictory.any():
        marker = labels[int(np.argmax(constraints.contradictory))]
        raise ConfigError(
            f"segment: `together` and `apart` contradict each other: one joins {marker} to a marker, the other "
            "separates these two"
        )
    return constraints


def check_names(names: tuple[str, ...], count: int) -> tuple[str, ...]:
    """Return the user's names of ``count`` segments; ConfigError if the number of names is different."""
    if len(names) != count:
        raise ConfigError(
            f"segment: names: there are {len(names)} names for {count} segments ({', '.join(names)}); "
            "give one name for each segment, base first, or also set `segment: {count: …}`"
        )
    return names


def explain_doubt(why: str, confidence: float | None = None) -> tuple[Reason, ...]:
    """Return a caution that the segments are doubtful; ``why`` is the strongest evidence against them.

    ``confidence`` is the probability that the segments are right; None if the evidence has no probability.
    """
    return (
        Reason(
            "segments-unsure",
            f"the segments are doubtful: {why}. Check the skeleton; if it is wrong, set `segment: {{count: …}}`, or "
            "name markers that are `together` or `apart`, or markers to `ignore`.",
            confidence,
            None if confidence is None else UNSURE,
        ),
    )
