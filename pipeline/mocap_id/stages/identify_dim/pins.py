"""What pins cost: left-out repetitions on the pinned chain and on measured poses, on the same samples in one band."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.comparison import Comparison, compare
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.prepare import Prepared
from mocap_id.protocols.movement import Movement
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.segment_fit import SegmentFit


def held_pinned(
    prepared: Prepared, pinned: Identification, movement: Movement, segments: SegmentFit
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Left-out repetitions on the pinned chain: samples (T,), model and measurement (T, 3) after the bodies' low-pass.

    None where no repetition could be left out on both motions. The samples are predicted on both.
    """
    on_chain = validation.validate(prepared, movement, pinned, np.zeros((len(prepared.recorded.time), 3))).held_out
    on_bodies = segments.validation.held_out
    if on_chain is None or on_bodies is None:
        return None
    both = on_chain.samples & on_bodies.samples
    lowpass = segments.prepared.lowpass
    return both, lowpass(on_chain.wrench), lowpass(on_chain.measured)


def pinned_facts(
    prepared: Prepared, pinned: Identification, movement: Movement, segments: SegmentFit, threshold: float
) -> dict[str, Any]:
    """What pins would cost: the pinned chain and the measured poses on the same samples, after the same low-pass.

    Parameters
    ----------
    prepared, pinned
        The pinned chain and what was identified on it.
    movement : Movement
    segments : SegmentFit
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    chain, bodies = held_pinned(prepared, pinned, movement, segments), segments.validation.held_out
    if chain is None or bodies is None:
        why = segments.validation.why
        return {"why": why, "chain": None, "segments": None, "clock_offset_s": _clock(pinned)}
    both, model, measured = chain
    both = both & np.isfinite(model).all(axis=1)
    return {
        "why": None,
        "samples": int(both.sum()),
        "chain": comparison_facts(compare(model, measured, both, threshold)),
        "segments": comparison_facts(compare(bodies.filtered, bodies.filtered_measured, both, threshold)),
        "clock_offset_s": _clock(pinned),
    }


def _clock(found: Identification) -> float | None:
    """The clock offset that was found, s; None where the trial does not show it."""
    return found.fit.found if found.fit.offset_known else None


def comparison_facts(compared: Comparison) -> dict[str, Any]:
    """JSON of a comparison."""
    wrench = {name: None if one is None else asdict(one) for name, one in compared.wrench.items()}
    return {"wrench": wrench, "cop_rms_m": compared.cop_rms}
