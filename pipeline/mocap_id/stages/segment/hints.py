"""Settings of the segmentation as rules and constraints, in the plane and in space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.kinematics import Constraints, SegmentationRules
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings

UNSURE = 0.5
"""Confidence below which a caution is given."""


def search_rules(settings: SegmentSettings, longest: int) -> SegmentationRules:
    """Return the limits of the search for segments; ``longest`` is the protocol's longest chain."""
    return SegmentationRules(
        still_limit=settings.still_limit_m,
        min_arc=float(np.radians(settings.min_arc_deg)),
        max_residual=settings.max_joint_residual_m,
        max_body_residual=settings.max_body_residual_m,
        count=settings.count,
        longest=settings.count or longest,
    )


def marker_constraints(
    labels: tuple[str, ...], settings: SegmentSettings, known: Sequence[list[int]] = ()
) -> Constraints:
    """Return the hints `together` and `apart` as columns of markers; ``known`` are more columns together."""
    together = [*(find_markers(labels, group, "segment: together") for group in settings.together), *known]
    apart = [find_markers(labels, group, "segment: apart") for group in settings.apart]
    found = Constraints.of(len(labels), together, apart)
    if found.contradictory.any():
        marker = labels[int(np.argmax(found.contradictory))]
        raise ConfigError(
            f"segment: `together` and `apart` contradict each other: they put {marker} on one segment and on two"
        )
    return found


def given_names(names: tuple[str, ...], count: int) -> tuple[str, ...]:
    """Return the user's names of ``count`` segments, or raise ConfigError if there are more or fewer."""
    if len(names) != count:
        raise ConfigError(
            f"segment.names gives {len(names)} names for {count} segments ({', '.join(names)}); "
            "give one for each, base first, or set segment.count too"
        )
    return names
