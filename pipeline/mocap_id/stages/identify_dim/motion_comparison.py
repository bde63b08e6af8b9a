"""Pinned chain and measured poses compared on left-out repetitions, and reasons about gaps and clocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.comparison import Comparison, compare
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.protocols.movement import Movement
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.segment_fit import SegmentFit
from mocap_id.verdict import Reason

ASKED_FOR = "asked for"
"""Why the pinned chain was used, in the facts of dynamics.h5: `motion: chain` is set."""
_CLOCKS_APART = 0.005  # s; 5 ms changes a base parameter of a person by a fifth or more


def predict_on_chain(
    prepared: PreparedTrial, pinned: Identification, movement: Movement, segments: SegmentFit
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Return left-out repetitions on the pinned chain: samples (T,), filtered model and measurement (T, 3).

    Both are filtered with the low-pass of the bodies. Only samples that chain and bodies both predict are used; None if
    there are none.
    """
    on_chain = validation.validate(prepared, movement, pinned, np.zeros((len(prepared.recorded.time), 3))).held_out
    on_bodies = segments.validation.held_out
    if on_chain is None or on_bodies is None:
        return None
    both = on_chain.samples & on_bodies.samples
    lowpass = segments.prepared.lowpass
    return both, lowpass(on_chain.wrench), lowpass(on_chain.measured)


def pinned_facts(
    prepared: PreparedTrial, pinned: Identification, movement: Movement, segments: SegmentFit, threshold: float
) -> dict[str, Any]:
    """Return the facts ``pins``: errors of chain and measured poses on the same samples, after the same low-pass.

    Parameters
    ----------
    prepared, pinned
        The trial on the pinned chain and its identification.
    movement : Movement
    segments : SegmentFit
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    chain, bodies = predict_on_chain(prepared, pinned, movement, segments), segments.validation.held_out
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
    """Return the clock offset, s; None if the trial does not determine it."""
    return found.fit.best_offset if found.fit.offset_known else None


def comparison_facts(compared: Comparison) -> dict[str, Any]:
    """Return JSON of a comparison."""
    wrench = {name: None if one is None else asdict(one) for name, one in compared.wrench.items()}
    return {"wrench": wrench, "cop_rms_m": compared.cop_rms}


def motion_reasons(facts: Mapping[str, Any]) -> tuple[Reason, ...]:
    """Return reasons about gaps of joints and about clocks, from the facts of dynamics.h5."""
    return (*_gives_way(facts["motion"]), *_clocks(facts.get("held_out") or {}))


def _gives_way(motion: Mapping[str, Any]) -> Iterator[Reason]:
    """Yield a note about joints whose two sides separate by more than noise; a caution if a setting pins them."""
    loose = {name: gap for name, gap in (motion.get("joints") or {}).items() if not gap["pinned"]}
    asked_for = motion["source"] == "chain" and motion["why"] == ASKED_FOR
    if not loose or not (asked_for or motion["source"] == "segments"):
        return
    listed = ", ".join(f"{name} {1e3 * gap['gap_m']:.1f} mm" for name, gap in loose.items())
    found = f"the two sides of a joint separate by more than noise (rms): {listed}"
    largest = max(gap["gap_m"] for gap in loose.values())
    if asked_for:
        yield Reason(
            "pinned-joint-gives-way",
            f"{found}, and `identify-dim: {{motion: chain}}` pins this joint. Mass then moves differently from the "
            "model, in every repetition alike, so the standard deviations of parameters and torques are too small. "
            "Remove the setting to use the measured pose of every segment",
            value=largest,
        )
        return
    yield Reason(
        "joint-gives-way",
        f"{found}. The dynamics therefore use the measured pose of every segment; lengths and angles are still those "
        "of the chain. Set `identify-dim: {motion: chain}` to use the chain",
        value=largest,
        level="ok",
    )


def _clocks(held_out: Mapping[str, Any]) -> Iterator[Reason]:
    """Yield a caution if the clock offsets of the repetitions contradict each other."""
    offsets = np.asarray(held_out.get("clock_offset_s") or [], dtype=np.float64)
    apart = float(np.ptp(offsets)) if len(offsets) > 1 else 0.0
    if apart > _CLOCKS_APART:
        yield Reason(
            "clocks-disagree",
            f"the clock offset between cameras and plate depends on the repetitions it is estimated from: it differs "
            f"by {1e3 * apart:.0f} ms, expected at most {1e3 * _CLOCKS_APART:.0f} ms. One of the clocks drifts, or "
            "the model does not fit the movement: check the synchronisation of cameras and plate",
            value=apart,
            limit=_CLOCKS_APART,
        )
