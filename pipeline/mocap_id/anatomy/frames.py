"""Anatomical frames of the upper limb from landmarks (ISB: Wu 2005), with their uncertainty.

All frames are defined for a right arm: X forward, Y up along the segment, Z to the right. The landmarks of a left arm
are mirrored first (:func:`mirror_points`). At the end, skin that moves over the bone, for simulated markers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.geometry import so3
from mocap_id.verdict import Reason

PALPATION = 0.005
"""Standard deviation of a palpated landmark along each axis, m."""

_MIRROR = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class FrameDefinition:
    """Definition of an anatomical frame by weighted sums of landmarks."""

    origin: Mapping[str, float]  # weights of landmarks in the origin
    up: Mapping[str, float]  # weights in the vector along +Y
    across: Mapping[str, float]  # weights in a second vector, whose part normal to Y is the third axis
    third: Literal["x", "z"]  # name of this third axis

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Landmarks that define the frame."""
        return tuple(dict.fromkeys((*self.origin, *self.up, *self.across)))


_ELBOW = {"EL": 0.5, "EM": 0.5}
_WRIST = {"RS": 0.5, "US": 0.5}

THORAX = FrameDefinition({"IJ": 1.0}, {"IJ": 0.5, "C7": 0.5, "PX": -0.5, "T8": -0.5}, {"IJ": 1.0, "C7": -1.0}, "x")
UPPER_ARM = FrameDefinition({"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"EL": 1.0, "EM": -1.0}, "z")
UPPER_ARM_2 = FrameDefinition(
    {"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"US": 1.0, "EL": -0.5, "EM": -0.5}, "x"
)
"""Option 2 of the ISB, for landmarks in a pose with a bent elbow."""
FOREARM = FrameDefinition(_ELBOW, {"EL": 0.5, "EM": 0.5, "US": -1.0}, {"RS": 1.0, "US": -1.0}, "z")
HAND = FrameDefinition(_WRIST, {"RS": 0.5, "US": 0.5, "MCP2": -0.5, "MCP5": -0.5}, {"MCP2": 1.0, "MCP5": -1.0}, "z")
"""Frame of the hand from its landmarks. Without them, see :func:`build_straight_hand`."""

DEFINITIONS = {"thorax": THORAX, "upper_arm": UPPER_ARM, "forearm": FOREARM, "hand": HAND}


@dataclass(frozen=True)
class SegmentFrame:
    """Anatomical frame, constant or for every sample.

    If a landmark is displaced by d (m, in the axes of the landmarks), the frame rotates by the vector J d (rad, in its
    own axes). The matrices J are the sensitivities.
    """

    origin: FloatArray  # (..., 3) m
    rotation: FloatArray  # (..., 3, 3) frame to the axes of the landmarks
    sensitivity: dict[str, FloatArray]  # landmark to its matrix J, (..., 3, 3)


def mirror_points(points: FloatArray) -> FloatArray:
    """Return points (..., 3) of the trial's frame (y up), mirrored from z to -z.

    A left arm becomes a right one, so frames and angles have the same definitions on both sides. In the mirror image, a
    rotation R is S R S with S = diag(1, 1, -1), and an angular velocity (x, y, z) is (-x, -y, z).
    """
    return np.asarray(points * _MIRROR)


def build_frame(definition: FrameDefinition, points: Mapping[str, FloatArray]) -> SegmentFrame:
    """Build an anatomical frame from the positions (..., 3) of landmarks, m.

    The positions of a left arm must be mirrored first (:func:`mirror_points`).

    Raises
    ------
    RecordingError
        A landmark is missing, or the landmarks lie on one line.

    Examples
    --------
    >>> at = {"US": [0, 0, 0], "RS": [0, 0, 0.05], "EL": [0, 0.2, 0.03], "EM": [0, 0.2, -0.03]}
    >>> build_frame(FOREARM, {k: np.array(v, dtype=float) for k, v in at.items()}).rotation.tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    missing = [name for name in definition.landmarks if name not in points]
    if missing:
        raise RecordingError(f"the landmarks {', '.join(missing)} are missing; name them under `landmarks:`")
    up, across = _sum_weighted(definition.up, points), _sum_weighted(definition.across, points)
    length = np.linalg.norm(up, axis=-1)
    y = up / np.where(length > 0, length, np.nan)[..., None]
    lean = np.einsum("...i,...i->...", across, y)
    normal = across - lean[..., None] * y
    reach = np.linalg.norm(normal, axis=-1)
    if np.any(reach < 0.01) or np.any(length < 0.01):
        raise RecordingError(f"the landmarks {', '.join(definition.landmarks)} lie on one line; check their names")
    third = normal / reach[..., None]
    x, z = (third, np.cross(third, y)) if definition.third == "x" else (np.cross(y, third), third)
    rotation = np.stack([x, y, z], axis=-1)

    # Derivatives (..., 3, 3) of the frame's rotation vector r by ``up`` and ``across``: r moves Y by r × Y, hence
    # r_x = Z · dY and r_z = -X · dY. The rotation about Y follows from the third axis, which ``across`` and Y define.
    along_x, along_z, zero = z / length[..., None], -x / length[..., None], np.zeros_like(x)
    if definition.third == "z":
        about_y_up, about_y_across = (lean / reach)[..., None] * along_z, x / reach[..., None]
    else:
        about_y_up, about_y_across = (lean / reach)[..., None] * along_x, -z / reach[..., None]
    turn_up = np.stack([along_x, about_y_up, along_z], axis=-2)
    turn_across = np.stack([zero, about_y_across, zero], axis=-2)
    sensitivity = {
        name: definition.up.get(name, 0.0) * turn_up + definition.across.get(name, 0.0) * turn_across
        for name in dict.fromkeys((*definition.up, *definition.across))
    }
    return SegmentFrame(_sum_weighted(definition.origin, points), rotation, sensitivity)


def build_straight_hand(forearm: SegmentFrame, points: Mapping[str, FloatArray]) -> SegmentFrame:
    """Return the frame of a hand that is straight in the landmarks' pose: the forearm's axes at the wrist."""
    return SegmentFrame(_sum_weighted(_WRIST, points), forearm.rotation, forearm.sensitivity)


def has_bent_elbow(points: Mapping[str, FloatArray]) -> BoolArray:
    """Return whether the elbow is bent by 60 to 120°, (...); otherwise, option 2 of the upper arm is poorly defined."""
    upper, lower = _sum_weighted(UPPER_ARM.up, points), _sum_weighted(FOREARM.up, points)
    cosine = np.einsum("...i,...i->...", upper, lower)
    size = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    return np.asarray(np.abs(cosine) <= 0.5 * size)


def frame_covariance(
    frames: tuple[SegmentFrame, ...], covariances: Mapping[str, FloatArray | float] | None = None
) -> FloatArray:
    """Return the common covariance (..., 3 n, 3 n), rad², of the orientation errors of n frames that share landmarks.

    The errors are the rotation vectors of the frames, each in its own axes. ``covariances`` contains covariances (3, 3)
    of landmarks, m², in axes that all frames share, or their standard deviations along each axis, m. Other landmarks
    have the standard deviation :data:`PALPATION`.
    """
    known = covariances or {}
    names = dict.fromkeys(name for frame in frames for name in frame.sensitivity)
    total: FloatArray | None = None
    for name in names:
        spread = np.asarray(known.get(name, PALPATION), dtype=np.float64)
        spread = spread**2 * np.eye(3) if spread.ndim == 0 else spread
        zero = np.zeros_like(frames[0].rotation)
        turn = np.concatenate([frame.sensitivity.get(name, zero) for frame in frames], axis=-2)
        part = turn @ spread @ np.swapaxes(turn, -1, -2)
        total = part if total is None else total + part
    return np.zeros((3 * len(frames),) * 2) if total is None else total


def _sum_weighted(weights: Mapping[str, float], points: Mapping[str, FloatArray]) -> FloatArray:
    """Return a weighted sum of landmark positions."""
    total: FloatArray = np.asarray(sum(w * np.asarray(points[name], dtype=np.float64) for name, w in weights.items()))
    return total


@dataclass(frozen=True)
class ClusterPoses:
    """Poses of all clusters at one moment."""

    rotations: FloatArray  # (S, 3, 3) cluster to trial
    origins: FloatArray  # (S, 3) m

    def place(self, local: FloatArray, segment: int) -> FloatArray:
        """Return the position (3,) in the trial, m, of the point ``local`` (3,), m, in the frame of a cluster."""
        return np.asarray(self.rotations[segment] @ local + self.origins[segment])


@dataclass(frozen=True)
class AnatomicalFrames:
    """Anatomical frames relative to the clusters of their segments.

    The sensitivities of the frames refer to displacements of landmarks in the axes of the landmarks' own segments.
    """

    frames: dict[str, SegmentFrame]  # thorax, upper_arm, forearm, hand
    covariances: Mapping[str, FloatArray | float]  # (3, 3), m², or standard deviation, m, of landmarks
    reasons: tuple[Reason, ...]  # why frames could not be built

    def covariance(self, parent: str, child: str) -> FloatArray:
        """Return the covariance (6, 6) of the errors of two frames, each in its own axes, rad²."""
        return frame_covariance((self.frames[parent], self.frames[child]), self.covariances)


def fit_segment_frames(
    places: Mapping[str, FloatArray],
    segment: Mapping[str, int],
    still: ClusterPoses,
    *,
    covariances: Mapping[str, FloatArray | float] | None = None,
    bent: ClusterPoses | None = None,
) -> AnatomicalFrames:
    """Return the anatomical frames of the segments from landmarks in the frames of clusters.

    Frames that use landmarks of two segments (the forearm uses the elbow centre) are built in the still pose.

    ``places`` are the positions (3,) of the landmarks in the frames of their segments' clusters, m. GH is the centre of
    the shoulder joint, in the frame of the upper arm. ``segment`` is the number of the segment of each landmark, and of
    ``thorax``, ``upper_arm``, ``forearm`` and ``hand``. ``covariances`` are those of landmarks as in
    :class:`AnatomicalFrames`; other landmarks have the standard deviation of palpation. ``bent`` is a pose with the
    elbow near 90°, for option 2 of the upper arm; without it, option 1 is used.
    """
    reasons: list[Reason] = []
    frames: dict[str, SegmentFrame] = {}
    standing = {name: still.place(local, segment[name]) for name, local in places.items()}
    for name, definition in DEFINITIONS.items():
        if name not in segment:
            continue
        missing = [each for each in definition.landmarks if each not in places]
        if not missing:
            frame = _express_in_segment(build_frame(definition, standing), name, segment, still)
            if name == "thorax":
                frame = rotate_to_midline(frame, places)
            elif name == "upper_arm" and bent is not None:
                points = {each: bent.place(local, segment[each]) for each, local in places.items()}
                if all(each in places for each in UPPER_ARM_2.landmarks) and bool(has_bent_elbow(points)):
                    frame = _express_in_segment(build_frame(UPPER_ARM_2, points), name, segment, bent)
                else:
                    message = "option 2 of the upper arm needs US and a pose with the elbow bent by 60 to 120°, so "
                    reasons.append(Reason("elbow-not-bent", f"{message}option 1 was used"))
            frames[name] = frame
        elif name == "hand" and "forearm" in frames:
            frames[name] = _express_in_segment(
                build_straight_hand(build_frame(FOREARM, standing), standing), name, segment, still
            )
            message = (
                f"the hand has no landmarks {', '.join(missing)}; the wrist is assumed to be straight in the still pose"
            )
            reasons.append(Reason("wrist-at-rest", message, level="ok"))
        else:
            message = f"the {name.replace('_', ' ')} has no ISB frame: the landmarks {', '.join(missing)} are missing"
            reasons.append(Reason("no-isb-frame", f"{message}; name them under `landmarks:`"))
    return AnatomicalFrames(frames, covariances or {}, tuple(reasons))


def rotate_to_midline(thorax: SegmentFrame, places: Mapping[str, FloatArray]) -> SegmentFrame:
    """Return the thorax frame, rotated so that Z is normal to the plane that fits IJ, C7, PX and T8 best.

    The four landmarks lie in the sagittal plane. The ISB defines Z by IJ, C7 and the mean of PX and T8, so its
    direction depends strongly on IJ and C7, which are only 0.1 m apart. The error about Y is half as large with a
    least-squares plane through all four landmarks. In the ISB's frame, the plane is z = a x + b y + c, with the normal
    (-a, -b, 1). See docs/concepts/isb-frames.md. Frame and landmarks, m, are in the axes of the thorax's cluster.
    """
    names = tuple(THORAX.up)
    at = np.array([places[name] for name in names]) @ thorax.rotation
    slopes = np.linalg.pinv(np.column_stack([at[:, :2], np.ones(len(at))]))[:2]  # (2, 4) d(a, b)/dz
    along_x, along_y = slopes @ at[:, 2]
    steep = float(np.hypot(along_x, along_y))
    turn = np.array([along_y, -along_x, 0.0]) * (np.arctan(steep) / steep if steep else 1.0)
    turned = thorax.rotation @ so3.exp(turn)
    sensitivity = {}
    for name, (by_x, by_y) in zip(names, slopes.T, strict=True):
        across = np.outer([by_y, -by_x, 0.0], thorax.rotation[:, 2])
        sensitivity[name] = across + np.diag([0.0, 0.0, 1.0]) @ thorax.sensitivity[name]
    return SegmentFrame(thorax.origin, turned, sensitivity)


AXIS_SPREAD = np.radians(4.7)
"""Standard deviation of the angle between elbow axis and epicondyle line in each of two planes, rad (total: 6.6°)."""

_AXIS = "elbow axis"


def rotate_to_elbow_axis(
    anatomical: AnatomicalFrames, direction: FloatArray, covariance: FloatArray
) -> AnatomicalFrames:
    """Return the frames, with the frame of the upper arm rotated about Y towards the flexion axis of the elbow.

    The line of the palpated epicondyles and the axis from the motion are both near Z. Their mean is weighted by their
    inverse variances; the variance of the axis includes :data:`AXIS_SPREAD`. ``direction`` (3,) is a unit vector along
    the axis in the frame of the upper arm's cluster, and ``covariance`` (3, 3) its covariance.
    """
    frame = anatomical.frames["upper_arm"]
    x, y, z = frame.rotation.T
    direction = direction * np.sign(direction @ z)
    angle = float(np.arctan2(direction @ x, direction @ z))
    palpated = float(frame_covariance((frame,), anatomical.covariances)[1, 1])
    across = np.cross(y, direction)
    shown = float(across @ covariance @ across) / max(float(across @ across), 0.1) + AXIS_SPREAD**2
    share = palpated / (palpated + shown)
    turned = frame.rotation @ so3.exp(np.array([0.0, share * angle, 0.0]))
    less = np.diag([1.0, 1.0 - share, 1.0])
    sensitivity = {name: less @ part for name, part in frame.sensitivity.items()}
    sensitivity[_AXIS] = np.diag([0.0, share, 0.0])
    upper = SegmentFrame(frame.origin, turned, sensitivity)
    covariances = {**anatomical.covariances, _AXIS: float(np.sqrt(shown))}
    return AnatomicalFrames({**anatomical.frames, "upper_arm": upper}, covariances, anatomical.reasons)


def set_middle_covariance(
    anatomical: AnatomicalFrames, pair: tuple[str, str], covariance: FloatArray
) -> AnatomicalFrames:
    """Return the frames with the uncertainty of two landmarks (such as EL and EM) whose midpoint is a joint centre.

    The landmarks were moved together, so that their midpoint is the centre. The covariance (3, 3), m², of the centre is
    in the axes of the landmarks' segment.
    """
    middle, apart = f"middle of {pair[0]} and {pair[1]}", f"half from {pair[0]} to {pair[1]}"
    frames = {}
    for name, frame in anatomical.frames.items():
        sensitivity = dict(frame.sensitivity)
        one, other = (sensitivity.pop(each, np.zeros((3, 3))) for each in pair)
        sensitivity |= {middle: one + other, apart: one - other}
        frames[name] = SegmentFrame(frame.origin, frame.rotation, sensitivity)
    half = np.mean([np.mean(np.square(anatomical.covariances.get(each, PALPATION))) for each in pair]) / 2
    known = {**anatomical.covariances, middle: covariance, apart: float(np.sqrt(half))}
    return AnatomicalFrames(frames, known, anatomical.reasons)


def _express_in_segment(frame: SegmentFrame, name: str, segment: Mapping[str, int], pose: ClusterPoses) -> SegmentFrame:
    """Return a frame relative to its segment, with sensitivities to displacements of landmarks in their segments."""
    k = segment[name]
    turn = pose.rotations[k]
    return SegmentFrame(
        turn.T @ (frame.origin - pose.origins[k]),
        turn.T @ frame.rotation,
        {each: part @ pose.rotations[segment[each]] for each, part in frame.sensitivity.items()},
    )


WANDER = 0.15  # size of the slow drift relative to the largest displacement
_PERIODS = (4.0, 20.0)  # s, of the drift


def draw_skin_motion(
    rng: np.random.Generator,
    link: IntArray,
    softness: FloatArray,
    q: FloatArray,
    time: FloatArray,
    *,
    wander: np.random.Generator,
    middle: FloatArray,
) -> FloatArray:
    """Return the displacement (T, M, 3) of every marker in its link's frame, m.

    ``rng`` draws the slides and ``wander`` the drifts. The joint with the number of a marker's ``link`` (M,) moves the
    next link. ``softness`` (M,) is the largest displacement of each marker, m, ``q`` (T, n) are the joint angles, rad,
    ``middle`` (n,) the angles at which the slide is near zero, and ``time`` (T,) is in s.
    """
    moved = np.zeros((len(time), len(link), 3))
    for i, (own, size) in enumerate(zip(link, softness, strict=True)):
        moved[:, i] = size * (draw_slide(rng, int(own), q, middle) + WANDER * draw_wander(wander, time))
    return moved


def draw_centred_skin_motion(
    rng: np.random.Generator, link: IntArray, softness: FloatArray, q: FloatArray, time: FloatArray
) -> FloatArray:
    """Return the displacement (T, M, 3) with a mean of zero, m; parameters as for :func:`draw_skin_motion`.

    The slide is near zero in the middle of each joint's range in this trial. The mean displacement over the trial is
    removed, so that a marker's position on its link is its mean position.
    """
    moved = draw_skin_motion(rng, link, softness, q, time, wander=rng, middle=mid_range(q))
    return np.asarray(moved - moved.mean(axis=0))


def mid_range(q: FloatArray) -> FloatArray:
    """Return the middle (n,) of the range of each joint angle (T, n), rad."""
    return np.asarray((q.max(axis=0) + q.min(axis=0)) / 2)


def draw_slide(rng: np.random.Generator, link: int, q: FloatArray, middle: FloatArray) -> FloatArray:
    """Return a slide (T, 3) with a length of about 1 at the ends of the motion."""
    total = np.zeros((len(q), 3))
    for joint, weight in ((link - 1, rng.uniform(0.3, 1.0)), (link, rng.uniform(0.3, 1.0))):
        direction = rng.normal(size=3)
        bend, shift = rng.uniform(0.8, 1.3), rng.uniform(-0.3, 0.3)
        if 0 <= joint < q.shape[1]:
            along = np.sin(bend * (q[:, joint] - middle[joint] + shift))
            total += weight * along[:, None] * direction / np.linalg.norm(direction)
    return total


def draw_wander(rng: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return a drift (T, 3) of unit variance."""
    period = rng.uniform(*_PERIODS, (6, 3))
    phase = rng.uniform(0, 2 * np.pi, (6, 3))
    waves = np.sin(2 * np.pi * time[:, None, None] / period + phase)
    return np.asarray(waves.sum(axis=1) / np.sqrt(3))
