"""Motion of bodies from their measured poses: pins where the joints hold, low-pass filters, derivatives.

A person's joints give way: hip and pelvis part by a centimetre and more. The measured poses hold that, and with it how
the mass really moved. Noise is taken out by a zero-phase low-pass of each coordinate of the pose; horizontal
position, vertical position and angle have a cut-off each, since the wrench needs them up to different frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.dynamics.lowpass import LowPass, known, runs
from mocap_id.dynamics.motion import Motion, point_acceleration
from mocap_id.geometry import planar

BRIDGED = 0.25  # s; a longer gap in a body's pose stays a gap
CUTOFFS = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
"""Cut-offs to choose from, Hz."""
USUAL = (3.0, 5.0, 4.0)
"""Cut-offs of x, y and angle where nothing shows better ones, Hz."""
_GAP_BAND = 3.0  # Hz, in which gaps are judged: camera noise is small there, movement is not
GIVES_WAY = 0.03
"""m/s² rms of a gap's acceleration; camera noise and skin of simulated people whose joints hold reach 0.02 to 0.05."""
SURELY = 0.1
"""m/s² rms: in simulated people whose joints hold, slipping skin shows at most 0.06."""


@dataclass(frozen=True)
class BodyPoses:
    """Poses of K bodies as they were measured, and how the chain's joints lie in them.

    Parameters
    ----------
    time : (T,) array
        s, even steps.
    position : (T, K, 2) array
        Centroid of each body's markers, plane frame, m; NaN where unknown.
    angle : (T, K) array
        Of the body's frame from the plane's, rad; NaN where unknown.
    centroid : (K, 2) array
        The same point in the body's frame, m.
    information : (K, 2) array
        Inverse variance of one frame's position, 1/m², and angle, 1/rad², up to a common factor.
    body : (n + 1,) int array
        The body of each segment of the chain.
    centres : (n, 2) array
        Centre of joint j in the frame of segment j - 1, m.
    """

    time: FloatArray
    position: FloatArray
    angle: FloatArray
    centroid: FloatArray
    information: FloatArray
    body: IntArray
    centres: FloatArray

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def joints(self) -> list[int]:
        """Joints, from 0, whose two sides are different bodies."""
        return [j for j in range(len(self.centres)) if self.body[j] != self.body[j + 1]]

    def one(self, body: int) -> BodyPoses:
        """One of the bodies by itself, without joints."""
        own = slice(body, body + 1)
        return BodyPoses(
            time=self.time,
            position=self.position[:, own],
            angle=self.angle[:, own],
            centroid=self.centroid[own],
            information=self.information[own],
            body=np.zeros(1, dtype=np.int64),
            centres=np.zeros((0, 2)),
        )

    @property
    def origin(self) -> FloatArray:
        """(T, K, 2) origins of the bodies' frames, m."""
        return np.asarray(self.position - planar.rotate(self.angle, self.centroid))

    def gap(self, joint: int) -> FloatArray:
        """(T, 2) from the joint's centre on the segment before it to that on the segment after it, m."""
        before, after = int(self.body[joint]), int(self.body[joint + 1])
        origin = self.origin
        return np.asarray(
            origin[:, after] - origin[:, before] - planar.rotate(self.angle[:, before], self.centres[joint])
        )

    def place_variance(self, joint: int) -> float:
        """Variance of a joint's place in the bodies on its two sides, m² a coordinate.

        The markers' residuals show how far a body is from rigid: where its markers move relative to each other, so does
        a joint.
        """
        found = 0.0
        for body, point in ((self.body[joint], self.centres[joint]), (self.body[joint + 1], np.zeros(2))):
            position, angle = self.information[body]
            arm = point - self.centroid[body]
            found += 0.5 / position + 0.25 * float(arm @ arm) / angle
        return float(found)


@dataclass(frozen=True)
class Gap:
    """How far a joint gives way.

    Parameters
    ----------
    size : float
        rms of the gap's change, m.
    acceleration : float
        rms of the gap's acceleration below 3 Hz, m/s²; NaN where no stretch is long enough.
    place : float
        Variance of the joint's place in the bodies on its two sides, m² a coordinate.
    """

    size: float
    acceleration: float
    place: float

    @property
    def pinned(self) -> bool:
        """The gap is at the noise: the joint holds. Where it is not known, it counts as holding."""
        return not self.acceleration > GIVES_WAY

    @property
    def centre_variance(self) -> float:
        """Variance of the joint's centre that gap and bodies leave, m² a coordinate; 0 where the gap is not known."""
        return self.size**2 / 2 + self.place if np.isfinite(self.size) else 0.0


def bridged(poses: BodyPoses) -> tuple[BodyPoses, BoolArray]:
    """Fill short gaps of the poses linearly.

    Returns
    -------
    BodyPoses
    observed : (T,) bool array
        Samples on which every pose was measured.
    """
    series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)  # (T, K, 3)
    longest = round(BRIDGED * poses.rate)
    observed = known(series)
    filled = series.copy()
    for k in range(series.shape[1]):
        there = np.isfinite(series[:, k]).all(axis=1)
        samples = np.flatnonzero(there)
        for hole in runs(~there):
            inside = len(samples) and hole.start > samples[0] and hole.stop <= samples[-1]
            if inside and hole.stop - hole.start <= longest:
                at = np.arange(hole.start, hole.stop)
                for c in range(3):
                    filled[hole, k, c] = np.interp(at, samples, series[samples, k, c])
    return replace(poses, position=filled[..., :2], angle=filled[..., 2]), observed


def gaps(poses: BodyPoses, samples: BoolArray) -> dict[int, Gap]:
    """How far each joint between two bodies gives way.

    Parameters
    ----------
    poses : BodyPoses
        Without short gaps.
    samples : (T,) bool array
        Those to judge on.

    Returns
    -------
    dict of int to Gap
        By the joint, from 0.
    """
    lowpass = LowPass(min(_GAP_BAND, poses.rate / 5), poses.rate)
    found = {}
    for joint in poses.joints:
        gap = poses.gap(joint)
        acceleration = _derivatives(lowpass(gap), poses.rate)[1]
        use = samples & known(gap)
        moving = samples & known(acceleration)
        size = float(np.sqrt(np.sum(np.var(gap[use], axis=0)))) if use.any() else float("nan")
        felt = float(np.sqrt(np.mean(np.sum(acceleration[moving] ** 2, axis=1)))) if moving.any() else float("nan")
        found[joint] = Gap(size, felt, poses.place_variance(joint))
    return found


def pinned(poses: BodyPoses, joints: Sequence[int]) -> BodyPoses:
    """Close the gaps of some joints by the smallest change of the poses.

    With W the information of the poses, J the gaps' Jacobian and g the gaps, the change is -W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹ g; a
    second step removes the rest, which comes from the bodies' rotation.

    Parameters
    ----------
    poses : BodyPoses
    joints : sequence of int
        From 0, each between two bodies.
    """
    if not joints:
        return poses
    for _ in range(2):
        gap = np.stack([poses.gap(joint) for joint in joints], axis=1)
        step = np.concatenate([_closing(poses, joints, poses.angle[s], gap[s]) for s in chunks(len(gap))])
        poses = replace(poses, position=poses.position + step[..., :2], angle=poses.angle + step[..., 2])
    return poses


def _closing(poses: BodyPoses, joints: Sequence[int], angle: FloatArray, gap: FloatArray) -> FloatArray:
    """Change (f, K, 3) of position and angle that closes gaps (f, j, 2) at angles (f, K); 0 where one is unknown."""
    size, bodies = angle.shape
    weak = 1.0 / np.concatenate([np.repeat(poses.information[:, :1], 2, axis=1), poses.information[:, 1:]], axis=1)
    jacobian = np.zeros((size, len(joints), 2, bodies, 3))
    for row, joint in enumerate(joints):
        for sign, body, point in (
            (-1.0, int(poses.body[joint]), poses.centres[joint]),
            (1.0, int(poses.body[joint + 1]), np.zeros(2)),
        ):
            arm = planar.rotate(angle[:, body], point - poses.centroid[body])
            jacobian[:, row, 0, body, 0] = jacobian[:, row, 1, body, 1] = sign
            jacobian[:, row, 0, body, 2], jacobian[:, row, 1, body, 2] = -sign * arm[:, 1], sign * arm[:, 0]
    flat = jacobian.reshape(size, 2 * len(joints), 3 * bodies)
    good = np.isfinite(flat).all(axis=(1, 2)) & np.isfinite(gap).all(axis=(1, 2))
    spread = flat[good] * weak.reshape(-1)  # J W⁻¹
    solved = np.linalg.solve(spread @ np.swapaxes(flat[good], 1, 2), gap[good].reshape(-1, 2 * len(joints), 1))
    step = np.zeros((size, bodies, 3))
    step[good] = -(np.swapaxes(spread, 1, 2) @ solved).reshape(-1, bodies, 3)
    return step


class PoseFilter:
    """Poses ready to be filtered with any cut-offs; every coordinate is filtered with each cut-off once.

    Parameters
    ----------
    poses : BodyPoses
        Pinned and bridged as they are to be used.
    """

    def __init__(self, poses: BodyPoses) -> None:
        self._poses = poses
        self._series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)  # (T, K, 3)
        self._known: dict[tuple[int, float], tuple[FloatArray, FloatArray, FloatArray]] = {}

    def motion(self, bands: tuple[float, float, float]) -> Motion:
        """Filtered motion of the bodies; a joint's centre is the mean of those on its two sides.

        Parameters
        ----------
        bands : (x, y, angle)
            Cut-offs, Hz.
        """
        poses = self._poses
        (x, _, ddx), (y, _, ddy), (angle, omega, alpha) = (self._smooth(c, bands[c]) for c in range(3))
        arm = planar.rotate(angle, -poses.centroid)  # from the centroid to the frame's origin
        origin = np.stack([x, y], axis=-1) + arm
        acceleration = np.stack([ddx, ddy], axis=-1) + point_acceleration(arm, omega, alpha)
        place = np.full(angle.shape[1], len(poses.body))  # bodies of no segment are beyond every joint
        place[poses.body[::-1]] = np.arange(len(poses.body))[::-1]
        beyond: BoolArray = place > np.arange(len(poses.centres))[:, None]
        return Motion(angle, omega, alpha, origin, acceleration, joint_centres(poses, angle, origin), beyond)

    def _smooth(self, coordinate: int, cutoff: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """One coordinate of all bodies (T, K) and its two derivatives."""
        key = coordinate, cutoff
        if key not in self._known:
            lowpass = LowPass(min(cutoff, self._poses.rate / 5), self._poses.rate)
            columns = self._series[..., coordinate].T
            smooth = np.stack([lowpass(column) for column in columns], axis=1)
            self._known[key] = (smooth, *_derivatives(smooth, self._poses.rate))
        return self._known[key]


def joint_centres(poses: BodyPoses, angle: FloatArray, origin: FloatArray) -> FloatArray:
    """(T, n, 2) means of the joints' places on their two sides, m; NaN where both sides are one body.

    Parameters
    ----------
    poses : BodyPoses
        How the joints lie in the bodies.
    angle, origin : (T, K) and (T, K, 2) arrays
        Of the bodies' frames, rad and m.
    """
    joint = np.full((len(angle), len(poses.centres), 2), np.nan)
    for j in poses.joints:
        before, after = int(poses.body[j]), int(poses.body[j + 1])
        near = origin[:, before] + planar.rotate(angle[:, before], poses.centres[j])
        joint[:, j] = (near + origin[:, after]) / 2
    return joint


def measured_motion(poses: BodyPoses, bands: tuple[float, float, float]) -> Motion:
    """Motion of the bodies, filtered with cut-offs of x, y and angle, Hz: :meth:`PoseFilter.motion`."""
    return PoseFilter(poses).motion(bands)


def _derivatives(values: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """First and second time derivative by central differences of fourth order; NaN at the ends of a stretch."""
    first, second = np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    back, before, now, after, ahead = (values[k : len(values) - 4 + k] for k in range(5))
    first[2:-2] = (back - 8 * before + 8 * after - ahead) * (rate / 12)
    second[2:-2] = (-back + 16 * before - 30 * now + 16 * after - ahead) * (rate**2 / 12)
    return first, second
