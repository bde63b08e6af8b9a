"""Result of the fit of a chain in space."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.kinematics.space.bundle import Bundle, chain_covariance
from mocap_id.kinematics.space.bundle_equations import (
    BundleProblem,
    BundleState,
    apply_step,
    joint_rotations,
    residuals,
    tangents,
)
from mocap_id.kinematics.space.joint_kinds import JointEvidence

_UNKNOWN = 0.02  # m; largest standard deviation of a known centre across its axis
_COMMON = 0.5  # largest fraction of axial rotation that the skin beside the next joint does not follow
_OPPOSITE, _WHOLE = -0.25, 0.9  # range of plausible fractions
_LEAST_ARC = float(np.radians(6))  # least rotation that determines a centre; soft tissue alone may reach this


@dataclass(frozen=True)
class SpatialFit:
    """Chain fitted to markers.

    The origin of a segment's frame is the centre of its joint. The frame's axes are nearly parallel to those of the
    trial in the first frame of the fit.
    """

    chain: SpatialChain
    evidence: tuple[JointEvidence, ...]
    residual: FloatArray  # (M,) rms residual of each marker, including skin motion by axial rotation, m
    lengths: FloatArray  # (n - 1,) distances of joints 2 … n from the joint of their parent segment, m
    length_sd: FloatArray  # (n - 1,) standard deviations of these lengths, m
    bundle: Bundle  # solution, for :func:`move_centre`
    covariance: FloatArray  # (P, P) covariance of the parameters in the order of ``bundle.problem.columns``

    def centre_among_markers(self, joint: int, segment: int) -> FloatArray:
        """Return the covariance (3, 3), m², of the centre of a joint, 1 … n, relative to a segment's mean marker."""
        about = _centre_jacobian(self.bundle.problem, joint - 1, segment)
        return np.asarray(about @ self.covariance @ about.T)


def collect_result(
    bundle: Bundle, evidence: tuple[JointEvidence, ...], covariance: FloatArray | None = None
) -> SpatialFit:
    """Return the result of a bundle adjustment; the covariance (P, P) of the parameters is computed if not given."""
    problem, state, cols = bundle.problem, bundle.state, bundle.problem.columns
    covariance = chain_covariance(bundle) if covariance is None else covariance
    turns = joint_rotations(problem, state)[0]
    joints = []
    for j, (kind, parent) in enumerate(zip(problem.kinds, problem.parents, strict=True)):
        axis, pin = state.first[j], state.second[j]
        about = _centre_jacobian(problem, j, parent)
        near = about @ covariance @ about.T
        if not np.isnan(near).any():  # the motion must determine the centre, except along the axis of a hinge
            across = np.eye(3) if kind == "ball" else tangents(axis)
            determined = bool(np.linalg.eigvalsh(across.T @ near @ across)[-1] < _UNKNOWN**2)
        else:
            determined = True
        joint = SpatialJoint(
            kind,
            parent,
            state.centres[j],
            covariance[cols.centre[j], cols.centre[j]],
            long_axis=problem.long_axes[j],
            untwisted=problem.untwisted[j],
            known=evidence[j].arc >= _LEAST_ARC and determined,
            slide_sd=float(np.sqrt(np.mean(state.slides[:, j] ** 2))),
        )
        if kind != "ball":
            spread = np.full((2, 3, 3), np.nan)
            for i, (place, each) in enumerate(((cols.first[j], axis), (cols.second[j], pin))):
                if place is not None and (i == 0 or kind == "two-axis"):
                    spread[i] = tangents(each) @ covariance[place, place] @ tangents(each).T
            offset = align_offset(turns[j], axis, pin, state.cosine[j] if kind == "two-axis" else 1.0)
            joint = replace(joint, first_axis=axis, second_axis=pin, axes_covariance=spread, offset=offset)
        if j == 0 and cols.glide is not None:
            glide_covariance = covariance[cols.glide, cols.glide]
            joint = replace(joint, glide=state.glide, glide_covariance=glide_covariance, rest=problem.rest)
        joints.append(joint)
    seen = problem.weights > 0
    local = np.where(np.asarray(seen.any(axis=0))[:, None], state.local, np.nan)
    skin_sd = np.sqrt(np.maximum(np.diag(covariance[cols.skin, cols.skin]), 0.0))
    skin = _anchor_skin(problem, state)
    whole = residuals(problem, replace(state, skin=np.zeros(len(problem.segment))))
    square = (whole**2).sum(axis=2)
    inner = [j for j, parent in enumerate(problem.parents) if parent > 0]
    lengths = np.linalg.norm(state.centres[inner], axis=1)
    along = state.centres[inner] / lengths[:, None]
    variances = [axis @ joints[j].covariance @ axis for axis, j in zip(along, inner, strict=True)]
    return SpatialFit(
        SpatialChain(tuple(joints), problem.segment, local, problem.on_glide, skin, skin_sd),
        evidence,
        np.sqrt(square.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)),
        lengths,
        np.sqrt(np.array(variances, dtype=np.float64)),
        bundle,
        covariance,
    )


def _anchor_skin(problem: BundleProblem, state: BundleState) -> FloatArray:
    """Return the fractions (M,) of axial rotation that the skin does not follow, changed to 0 beside the next joint.

    The motion determines the differences between markers, but hardly the mean of all markers of a segment. With the
    fraction c beside the next joint, 1 - s becomes (1 - s) / (1 - c). A last segment has no next joint.
    """
    skin: FloatArray = np.zeros_like(state.skin)
    for j, parent in enumerate(problem.parents):
        here = np.flatnonzero(problem.segment == parent)
        if parent > 0 and len(here):
            skin[here] = 1 - (1 - state.skin[here]) / (1 - np.clip(_common_share(problem, state, j), -0.5, 0.9))
    return skin


def _common_share(problem: BundleProblem, state: BundleState, j: int) -> float:
    """Return the mean fraction ``state.skin`` of the parent's two markers that are nearest to joint j."""
    here = np.flatnonzero(problem.segment == problem.parents[j])
    away = np.linalg.norm(state.local[here] - state.centres[j], axis=1)
    return float(state.skin[here[np.argsort(away)[:2]]].mean())


def find_implausible_skin(problem: BundleProblem, state: BundleState) -> frozenset[int]:
    """Return the segments whose fractions ``state.skin`` are impossible for skin and must describe another motion."""
    anchored = _anchor_skin(problem, state)
    segments = []
    for j, parent in enumerate(problem.parents):
        here = problem.segment == parent
        if parent > 0 and here.any():
            low, high = anchored[here].min(), anchored[here].max()
            if abs(_common_share(problem, state, j)) > _COMMON or low < _OPPOSITE or high > _WHOLE:
                segments.append(parent)
    return frozenset(segments)


def _centre_jacobian(problem: BundleProblem, j: int, segment: int) -> FloatArray:
    """Return the derivatives (3, P) of the vector from a segment's mean marker to joint ``j``, numbered from 0."""
    here = np.flatnonzero(problem.segment == segment)
    rows = np.zeros((3, problem.columns.size))
    if segment == problem.parents[j]:
        rows[:, problem.columns.centre[j]] = np.eye(3)
    for m in here:
        rows[:, 3 * m : 3 * m + 3] = -np.eye(3) / len(here)
    return rows


def align_offset(turn: FloatArray, axis: FloatArray, pin: FloatArray, cosine: float) -> FloatArray:
    """Return the rotation (3, 3) nearest to ``turn`` that brings ``axis`` and ``pin`` to the angle with this cosine.

    The unit axis (3,) is in the frame of the parent, and the unit pin (3,) in the frame of the child.
    """
    rotated_pin = turn @ pin
    normal = np.cross(axis, rotated_pin)
    size = float(np.linalg.norm(normal))
    if size < 1e-9:
        normal, size = tangents(axis)[:, 0], 1.0
    angle = np.arccos(np.clip(cosine, -1, 1)) - np.arccos(np.clip(rotated_pin @ axis, -1, 1))
    return np.asarray(so3.exp(angle * normal / size) @ turn)


def move_centre(fit: SpatialFit, joint: int, point: FloatArray, covariance: FloatArray) -> SpatialFit:
    """Return the fit, updated with another measurement of a joint centre, such as palpated landmarks.

    All parameters change according to their covariance (a Kalman update), so markers, centres and axes stay consistent.
    In a direction that the motion hardly determines, such as along a hinge, the centre follows the measured point.
    ``joint`` is the number of the joint's segment, 1 … n. The point (3,), m, is in the frame of the parent segment of
    ``fit.chain``, among its markers, and has the covariance (3, 3), m².
    """
    problem, state = fit.bundle.problem, fit.bundle.state
    about = _centre_jacobian(problem, joint - 1, problem.parents[joint - 1])
    known = about @ fit.covariance
    gain = np.linalg.solve(known @ about.T + covariance, known).T
    step = gain @ (point - state.centres[joint - 1])
    moved = apply_step(problem, state, step, -fit.bundle.gain @ step)
    return collect_result(replace(fit.bundle, state=moved), fit.evidence, fit.covariance - gain @ known)
