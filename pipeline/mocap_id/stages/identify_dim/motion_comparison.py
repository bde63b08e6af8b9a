"""Comparisons of the pinned chain with measured poses, and of the joint torque with a robot's encoder file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.dynamics.comparison import compare
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.reference_bodies import describe_comparison
from mocap_id.stages.identify_dim.segment_fit import SegmentFit
from mocap_id.verdict import Reason

ASKED_FOR = "asked for"
"""Reason in the facts of dynamics.h5 if the pinned chain is used because of the setting `motion: chain`."""
_CLOCKS_APART = 0.005  # s, largest difference; 5 ms changes a base parameter of a person by a fifth or more


def predict_on_chain(
    prepared: PreparedTrial, pinned: Identification, movement: Movement, segments: SegmentFit
) -> tuple[BoolArray, FloatArray, FloatArray] | None:
    """Return True (T,) in left-out samples, the wrench (T, 3) that the chain predicts, and the measured wrench (T, 3).

    In these samples, chain and bodies both have predictions. The wrenches are filtered by the low-pass of the bodies.
    The result is None without predictions.
    """
    on_chain = validation.validate(prepared, movement, pinned, np.zeros((len(prepared.recorded.time), 3))).held_out
    on_bodies = segments.validation.held_out
    if on_chain is None or on_bodies is None:
        return None
    both = on_chain.samples & on_bodies.samples
    lowpass = segments.prepared.lowpass
    return both, lowpass(on_chain.wrench), lowpass(on_chain.measured)


def compare_motions(
    prepared: PreparedTrial, pinned: Identification, movement: Movement, segments: SegmentFit, threshold: float
) -> dict[str, Any]:
    """Return the fact ``pins``: errors of chain and measured poses on the same samples, after the same low-pass.

    Parameters
    ----------
    prepared, pinned
        Trial on the pinned chain, and its identification.
    movement : Movement
        Repetitions and usable samples.
    segments : SegmentFit
        Identification with measured poses.
    threshold : float
        Largest vertical force without a centre of pressure, N.
    """
    chain, bodies = predict_on_chain(prepared, pinned, movement, segments), segments.validation.held_out
    if chain is None or bodies is None:
        why = segments.validation.why
        return {"why": why, "chain": None, "segments": None, "clock_offset_s": _get_offset(pinned)}
    both, model, measured = chain
    both = both & np.isfinite(model).all(axis=1)
    return {
        "why": None,
        "samples": int(both.sum()),
        "chain": describe_comparison(compare(model, measured, both, threshold)),
        "segments": describe_comparison(compare(bodies.filtered, bodies.filtered_measured, both, threshold)),
        "clock_offset_s": _get_offset(pinned),
    }


def _get_offset(found: Identification) -> float | None:
    """Return the clock offset, s; None if the trial does not determine it."""
    return found.fit.total_offset if found.fit.offset_known else None


def explain_motion(facts: Mapping[str, Any]) -> tuple[Reason, ...]:
    """Return reasons about the gaps of joints and the clock offset, from the facts of dynamics.h5."""
    return (*_explain_gaps(facts["motion"]), *_check_clocks(facts.get("held_out") or {}))


def _explain_gaps(motion: Mapping[str, Any]) -> Iterator[Reason]:
    """Yield a note about joints whose two sides separate more than the noise, or a caution if a setting pins them."""
    loose = {name: gap for name, gap in (motion.get("joints") or {}).items() if not gap["pinned"]}
    asked_for = motion["source"] == "chain" and motion["why"] == ASKED_FOR
    if not loose or not (asked_for or motion["source"] == "segments"):
        return
    listed = ", ".join(f"{name} {1e3 * gap['gap_m']:.1f} mm" for name, gap in loose.items())
    observation = f"the two sides of a joint separate by more than the noise (rms): {listed}"
    largest = max(gap["gap_m"] for gap in loose.values())
    if asked_for:
        yield Reason(
            "pinned-joint-gives-way",
            f"{observation}, and `identify-dim: {{motion: chain}}` pins this joint. The masses then move differently "
            "from the model, in the same way in every repetition, so the standard deviations of parameters and torques "
            "are too small. Remove the setting to use the measured pose of every segment",
            value=largest,
        )
        return
    yield Reason(
        "joint-gives-way",
        f"{observation}. The dynamics therefore use the measured pose of every segment; lengths and angles still come "
        "from the chain. Set `identify-dim: {motion: chain}` to use the chain",
        value=largest,
        level="ok",
    )


def _check_clocks(held_out: Mapping[str, Any]) -> Iterator[Reason]:
    """Yield a caution if the clock offsets of the fits without each of the repetitions differ too much."""
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


def compare_torque(context: Context, dynamics: Mapping[str, FloatArray]) -> dict[str, Any] | None:
    """Return the difference of the model's torque from the torque in the encoder file; None if one of them is missing.

    The result has ``bias`` and ``sd``, N·m, ``r2`` and the number of ``samples``. ``dynamics`` are the columns of
    dynamics.parquet. The model's torque is interpolated at the encoder's times, with the clock offset of ukf-smooth.
    """
    file = context.trial.encoder
    if file is None or "tau_1" not in dynamics:
        return None
    matched, log = context.table("encoder.parquet").facts, recording.read_encoder(file)
    if matched.get("why") is not None or log.torque is None:
        return None
    measured = matched["sign"] * log.torque
    model = SampledWrench.of(dynamics["time"], dynamics["tau_1"][:, None])
    off = model(log.time + matched["clock_offset_s"])[:, 0] - measured
    both = np.isfinite(off)
    if np.count_nonzero(both) < 2 or not np.ptp(measured[both]) > 0.0:
        return None
    return {
        "bias": float(np.mean(off[both])),
        "sd": float(np.std(off[both])),
        "r2": 1.0 - float(np.mean(off[both] ** 2)) / float(np.var(measured[both])),
        "samples": int(np.count_nonzero(both)),
    }
