"""The last segment of a chain that is asked to be shorter than the motion shows.

A chain of a given number of segments may end at a body on which another one hangs, such as a pelvis that carries a
trunk. Cut off there, what hangs beyond would be on no segment, and a model that stands on the chain would put its mass
on the pelvis. So the two are offered as one last segment as well, however much they bend.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from mocap_id.kinematics.rigid import Body


def whole_tips(
    links: Sequence[Body],
    real: set[tuple[int, int]],
    joined: Callable[[Body, Body], Body | None],
    limit: float,
) -> Iterator[tuple[Body, set[int]]]:
    """Every two bodies that hang on each other over a real joint, as one.

    Parameters
    ----------
    links : sequence of Body
        Of a level, the base first.
    real : set of (int, int)
        Pairs of links with a real joint, the lower one first.
    joined : callable
        Two bodies as one; None where they must not be.
    limit : float
        Markers of the two together stay this close to their place on it, rms, m.

    Yields
    ------
    tip : Body
    below : set of int
        Links that one of the two has a real joint with.
    """
    for i, j in sorted({(min(pair), max(pair)) for pair in real if 0 not in pair}):
        tip = joined(links[i], links[j])
        if tip is not None and tip.residual <= limit:
            yield tip, {below for below, above in real if above in {i, j}} - {i, j}
