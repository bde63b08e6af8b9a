"""The fit on measured poses: bands, prior, parameters of the bodies, and what they say of the chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.bands import ChosenBands
from mocap_id.dynamics.comparison import Comparison, compare
from mocap_id.dynamics.fold import Fold, fold, in_base
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.held_out import hold_out, parts
from mocap_id.dynamics.identify import Identification, identify
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.loose_prior import BodyPrior
from mocap_id.dynamics.predict import Noise, shown_noise
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.reference_term import deviations
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, chosen_bands, loose_prior, with_prior
from mocap_id.stages.identify_dim.rivals import Rivals
from mocap_id.stages.identify_dim.validation import Validation

_MEMORY = 0.12  # s, over which residuals on measured poses stay correlated


@dataclass(frozen=True)
class SegmentFit:
    """A trial identified on the measured poses of its bodies.

    Parameters
    ----------
    bodies : MeasuredBodies
    prepared : Prepared
        On the bodies' motion.
    found : Identification
        Full parameters of the bodies.
    in_chain : Identification
        The pinned chain's, with base and full parameters that follow from the bodies'.
    prior : BodyPrior
    bands : ChosenBands
    rivals : Rivals
        Bodies from tables, as parameters of these bodies.
    chain_reference : (4(n + 1),) array
        The chosen table's body on the chain.
    prior_share : (b,) array
        How much of each base parameter's precision is the prior's, 0 … 1.
    folded : Fold
    grid : PointGrid
    validation : Validation
    """

    bodies: MeasuredBodies
    prepared: Prepared
    found: Identification
    in_chain: Identification
    prior: BodyPrior
    bands: ChosenBands
    rivals: Rivals
    chain_reference: FloatArray
    prior_share: FloatArray
    folded: Fold
    grid: PointGrid
    validation: Validation

    def noise(self, centre_sd: FloatArray) -> Noise:
        """Errors beside those of the parameters; half of a joint's gap counts as an error of its centre."""
        half_gap = np.array([self._gap(joint) / 2 for joint in range(len(centre_sd))])
        held, spread = self.validation.held_out, np.hypot(centre_sd, half_gap)
        if held is not None:
            return shown_noise(self.prepared, self.found, _finite(held.filtered - held.filtered_measured), spread)
        residual = _finite(self.filtered(self.found.base) - self.filtered_measured)
        independent = len(residual) / max(1.0, _MEMORY * self.prepared.recorded.rate) * residual.shape[1]
        return shown_noise(self.prepared, self.found, residual, spread, len(self.found.base) / max(independent, 1.0))

    def filtered(self, parameters: FloatArray) -> FloatArray:
        """(T, 3) wrench of bodies with these parameters after the fit's low-pass; NaN off the fit's samples."""
        return self._on_fit(self.prepared.filtered @ parameters)

    @property
    def filtered_measured(self) -> FloatArray:
        """(T, 3) measured wrench after the fit's low-pass, less the plate's bias; NaN off the fit's samples."""
        return filtered_measured(self.prepared, self.found)

    @property
    def facts(self) -> dict[str, Any]:
        """What was chosen, and why."""
        return {
            "bands_hz": dict(zip(("x", "y", "angle"), self.bands.bands, strict=True)),
            "bands_why": self.bands.why,
            "bodies": list(self.bodies.names),
            "used": list(self.bodies.used),
            "prior": self.prior.source,
            "prior_share": self.prior_share.tolist(),
        }

    def _gap(self, joint: int) -> float:
        gap = self.bodies.gap.get(joint)
        return 0.0 if gap is None or gap.pinned or not np.isfinite(gap.size) else gap.size

    def _on_fit(self, wrench: FloatArray) -> FloatArray:
        return np.where(self.found.fit.in_fit[:, None], wrench, np.nan)


def fit_segments(
    context: Context,
    ways: Sequence[MeasuredBodies],
    prepared: Prepared,
    movement: Movement,
    pinned: Identification,
    tables: Rivals,
) -> SegmentFit:
    """Identify the bodies on their measured poses.

    Parameters
    ----------
    context : Context
    ways : sequence of MeasuredBodies
        The bodies in every way to count them; the one that predicts left-out repetitions best is used.
    prepared : Prepared
        On the pinned chain.
    movement : Movement
    pinned : Identification
        Of the pinned chain.
    tables : Rivals
        Bodies from tables, on the chain.
    """
    settings, recorded, gate = context.settings, prepared.recorded, movement.free
    reference = tables.chosen.parameters
    mass = float(pinned.full[::4].sum()) if tables.chosen.mass is None else tables.chosen.mass
    part = _parts(prepared, movement)
    tried = []
    for way in ways:
        prior = loose_prior(way, recorded.q, gate, reference, mass, str(tables.chosen.table))
        tried.append((way, prior, chosen_bands(way, recorded, prepared.settings, prior, gate, part)))
    bodies, prior, bands = min(reversed(tried), key=lambda each: each[2].cost)
    ready = with_prior(bodies, recorded, prepared.settings, prior, bands.bands)
    grid = bodies.grid(settings.grid)
    found = identify(
        ready,
        gate,
        grid,
        prior.mean,
        KinematicError.none(recorded.q.shape[1]),
        consistency=settings.consistency or "cone",
        reference_sd=settings.reference_sd,
    )
    sd = deviations(reference, settings.reference_sd)
    folded = fold(bodies.poses, recorded.q, found.fit.in_fit, reference, sd)
    in_chain, share = _in_chain(context, prepared, pinned, found, folded)
    every = tuple(
        replace(each, parameters=loose_prior(bodies, recorded.q, gate, each.parameters, mass, "").mean)
        for each in tables.every
    )
    known = prior.mean if np.isfinite(reference).all() else np.full(len(prior.mean), np.nan)
    return SegmentFit(
        bodies=bodies,
        prepared=ready,
        found=found,
        in_chain=in_chain,
        prior=prior,
        bands=bands,
        rivals=Rivals(replace(tables.chosen, parameters=known), every),
        chain_reference=reference,
        prior_share=share,
        folded=folded,
        grid=grid,
        validation=validation.validate(ready, movement, found, np.zeros((len(recorded.time), 3))),
    )


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
    nothing = np.zeros((len(prepared.recorded.time), 3))
    on_chain = validation.validate(prepared, movement, pinned, nothing).held_out
    on_bodies = segments.validation.held_out
    if on_chain is None or on_bodies is None:
        return {"why": segments.validation.why, "chain": None, "segments": None, "clock_offset_s": pinned.fit.offset}
    both = on_chain.samples & on_bodies.samples
    lowpass = segments.prepared.lowpass

    def errors(model: FloatArray, measured: FloatArray) -> dict[str, Any]:
        return comparison_facts(compare(model, measured, both, threshold))

    smooth = lowpass(on_chain.wrench), lowpass(on_chain.measured)
    return {
        "why": None,
        "samples": int(both.sum()),
        "chain": errors(*smooth),
        "segments": errors(on_bodies.filtered, on_bodies.filtered_measured),
        "clock_offset_s": pinned.fit.offset,
    }


def comparison_facts(compared: Comparison) -> dict[str, Any]:
    """JSON of a comparison."""
    wrench = {name: None if one is None else asdict(one) for name, one in compared.wrench.items()}
    return {"wrench": wrench, "cop_rms_m": compared.cop_rms}


def filtered_measured(prepared: Prepared, found: Identification) -> FloatArray:
    """(T, 3) measured wrench after the fit's low-pass, less the plate's bias; NaN off the fit's samples."""
    used = np.flatnonzero(found.fit.in_fit)
    out = np.full((len(prepared.recorded.time), 3), np.nan)
    out[used] = prepared.filtered_measured(used, prepared.recorded.time[used] - found.fit.offset)
    out[:, 0] -= found.plate_bias or 0.0
    return out


def _parts(prepared: Prepared, movement: Movement) -> IntArray:
    """The repetition of each sample, for leaving one out."""
    spans = validation.spans(movement)
    time = prepared.recorded.time
    return parts(time, np.array(spans)) if len(spans) > 1 else np.zeros(len(time), dtype=np.int64)


def _in_chain(
    context: Context, prepared: Prepared, pinned: Identification, found: Identification, folded: Fold
) -> tuple[Identification, FloatArray]:
    """The chain's base and full parameters from the bodies', and the prior's share of each base parameter."""
    joints: Any = context.tree("chain.h5").data["joints"]
    centres, spread = prepared.recorded.centres, np.asarray(joints["covariance"], dtype=np.float64)
    own = slice(found.fit.base)
    base, covariance = in_base(folded, prepared.base, centres, spread, found.full, found.covariance)
    _, residual = in_base(folded, prepared.base, centres, 0 * spread, found.full, found.residual_covariance)
    rows = prepared.base.regrouping @ folded.matrix
    design = found.fit.design.reshape(-1, found.fit.design.shape[-1])
    precision = design.T @ design + found.fit.prior_precision
    gained = np.linalg.solve(precision, np.eye(len(precision)))
    by_prior = (gained @ found.fit.prior_precision @ gained)[own, own]
    share = np.einsum("bp,pq,bq->b", rows, by_prior, rows) / np.einsum("bp,pq,bq->b", rows, gained[own, own], rows)
    in_chain = replace(
        pinned,
        base=base,
        base_sd=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        residual_covariance=residual,
        full=folded.matrix @ found.full + folded.constant,
        masses=np.full(len(pinned.masses), np.nan),
    )
    return in_chain, np.clip(share, 0.0, 1.0)


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values).all(axis=1)]

