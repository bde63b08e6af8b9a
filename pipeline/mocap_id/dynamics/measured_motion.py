"""Motion of bodies from their measured poses, and the chain's parameters from those of the bodies.

A person's joints are not perfect pins, so the two sides of a joint have a gap: at the hip, thigh and trunk move apart
by a centimetre and more. The measured poses contain this motion, and therefore the real motion of the mass. Horizontal
position, vertical position and angle have different cut-offs, because the wrench depends on them up to different
frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_complete_rows, find_runs
from mocap_id.dynamics.preparation import LowPass, erode
from mocap_id.dynamics.priors import average_transform
from mocap_id.dynamics.regressor import BaseSet, PlanarMotion, point_acceleration, structural_base
from mocap_id.geometry import planar

BRIDGED = 0.25  # s: longest interval without a pose that is interpolated
CUTOFFS = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)  # Hz: cut-offs to choose from
USUAL = (3.0, 5.0, 4.0)  # Hz: default cut-offs of x, y and angle
_GAP_BAND = 3.0  # Hz: below this frequency, camera noise is small compared with movement
_NOISE_SD = 3.0  # standard deviations of its random error by which noise alone may exceed its mean square
_FREQUENCIES = 4096  # number of frequencies for the response to white noise


@dataclass(frozen=True)
class BodyPoses:
    """Measured poses of K bodies, and the positions of the chain's joints in them."""

    time: FloatArray  # (T,) sample times with constant step, s
    position: FloatArray  # (T, K, 2) centroid of each body's markers in the plane frame, m; NaN where missing
    angle: FloatArray  # (T, K) angle of each body's frame in the plane frame, rad; NaN where missing
    centroid: FloatArray  # (K, 2) centroid of the markers in the body's frame, m
    # (K, 2) inverse variance of the position, 1/m², and angle, 1/rad², in one frame of the cameras, up to a common
    # factor
    information: FloatArray
    body: IntArray  # (n + 1,) body of each segment of the chain
    centres: FloatArray  # (n, 2) centre of joint j in the frame of segment j - 1, m
    # (n, 2) correction of each joint's position for the torques, in the frame of segment j - 1, m. The error of the
    # joint fit is estimated from the body beyond the joint. Gaps are computed without this correction.
    shift: FloatArray | None = None
    beyond: FloatArray | None = None  # (n, 2) centre of joint j in the frame of segment j, m; its origin by default
    # (K, 2) variance of the position, m² per coordinate, and angle, rad², in one frame, due to the noise of the cameras
    # alone, which is independent in every frame; without noise by default
    camera: FloatArray | None = None

    @property
    def rate(self) -> float:
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def joints(self) -> list[int]:
        """Numbers of the joints, from 0, between two different bodies."""
        return [j for j in range(len(self.centres)) if self.body[j] != self.body[j + 1]]

    def select(self, body: int) -> BodyPoses:
        """Return the poses of one body alone, without joints."""
        own = slice(body, body + 1)
        series = self.time, self.position[:, own], self.angle[:, own], self.centroid[own], self.information[own]
        return BodyPoses(*series, body=np.zeros(1, dtype=np.int64), centres=np.zeros((0, 2)))

    @property
    def origin(self) -> FloatArray:
        """Origins (T, K, 2) of the bodies' frames, m."""
        return np.asarray(self.position - planar.rotate(self.angle, self.centroid))

    def sides(self, joint: int) -> tuple[tuple[int, FloatArray], tuple[int, FloatArray]]:
        """Return the bodies before and after a joint, and the joint's centre (2,) in the frame of each, m."""
        after = np.zeros(2) if self.beyond is None else self.beyond[joint]
        return (int(self.body[joint]), self.centres[joint]), (int(self.body[joint + 1]), after)

    def measure_gap(self, joint: int) -> FloatArray:
        """Return the vector (T, 2), m, from a joint's centre in the body before it to that in the body after it."""
        origin = self.origin
        before, after = (
            origin[:, body] + planar.rotate(self.angle[:, body], point) for body, point in self.sides(joint)
        )
        return np.asarray(after - before)


@dataclass(frozen=True)
class JointGap:
    """Relative motion of the two sides of a joint: of its centre in the body before it and in the body after it."""

    size: float  # rms change of the gap, m; NaN without samples
    acceleration: float  # rms acceleration of the gap below 3 Hz, m/s²; NaN if no interval is long enough
    noise: float = 0.0  # largest acceleration that the noise of the cameras alone gives, m/s², rms below 3 Hz
    holds: bool = False  # the forces show that the joint holds, although the acceleration of its gap is above the noise

    @property
    def above_noise(self) -> float:
        """Rms acceleration of the gap that the noise of the cameras does not give, m/s²; 0 if unknown."""
        square = self.acceleration**2 - self.noise**2
        return float(np.sqrt(square)) if square > 0.0 else 0.0

    @property
    def pinned(self) -> bool:
        """Whether the gap is within the noise or unknown, or the forces show that the joint holds."""
        return self.holds or self.above_noise == 0.0


@dataclass(frozen=True)
class Stretch:
    """Change of a segment's length, from the joint on the body before it to the joint on the body after it.

    If both joints hold, the length is constant. The markers of the segment itself, whose skin moves most, do not count.
    """

    acceleration: FloatArray  # (T,) second derivative of the length below 3 Hz, m/s²; NaN where unknown
    # rms change of the length, m, of its velocity, m/s, and of its acceleration, m/s², below 3 Hz
    visible: tuple[float, float, float]
    noise: float  # largest rms acceleration that the noise of the cameras alone gives, m/s²

    @property
    def above_noise(self) -> float:
        """Rms acceleration that the noise of the cameras does not give, m/s²; 0 if unknown."""
        known = self.acceleration[np.isfinite(self.acceleration)]
        square = float(np.mean(known**2)) - self.noise**2 if len(known) else 0.0
        return float(np.sqrt(max(square, 0.0)))


def fill_gaps(poses: BodyPoses) -> tuple[BodyPoses, BoolArray]:
    """Return the poses with short gaps interpolated, and a mask (T,) of the samples with all poses measured."""
    series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)  # (T, K, 3)
    longest = round(BRIDGED * poses.rate)
    observed = find_complete_rows(series)
    filled = series.copy()
    for k in range(series.shape[1]):
        there = np.isfinite(series[:, k]).all(axis=1)
        samples = np.flatnonzero(there)
        for hole in find_runs(~there):
            inside = len(samples) and hole.start > samples[0] and hole.stop <= samples[-1]
            if inside and hole.stop - hole.start <= longest:
                at = np.arange(hole.start, hole.stop)
                for c in range(3):
                    filled[hole, k, c] = np.interp(at, samples, series[samples, k, c])
    return replace(poses, position=filled[..., :2], angle=filled[..., 2]), observed


def measure_gaps(poses: BodyPoses, samples: BoolArray) -> dict[int, JointGap]:
    """Return the gap of each joint (from 0) between two bodies, over the marked samples (T,)."""
    lowpass = LowPass(min(_GAP_BAND, poses.rate / 5), poses.rate)
    factor, share = _respond_to_noise(lowpass)
    gaps = {}
    for joint in poses.joints:
        gap = poses.measure_gap(joint)
        acceleration = _differentiate(lowpass(gap), poses.rate)[1]
        use = samples & find_complete_rows(gap)
        # the low-pass keeps the noise of the first and the last sample of an interval
        moving = use & find_complete_rows(acceleration) & erode(find_complete_rows(gap), lowpass.reach_samples)
        size = float(np.sqrt(np.sum(np.var(gap[use], axis=0)))) if use.any() else float("nan")
        rms = float(np.sqrt(np.mean(np.sum(acceleration[moving] ** 2, axis=1)))) if moving.any() else float("nan")
        independent = max(share * np.count_nonzero(moving), 1.0)  # most of a gap's noise is in one direction
        variance = 0.0  # of the gap in one frame due to the noise of the cameras, m² per coordinate
        if poses.camera is not None:
            arms = [(body, point - poses.centroid[body]) for body, point in poses.sides(joint)]
            of_arms = (poses.camera[body, 0] + 0.5 * (arm @ arm) * poses.camera[body, 1] for body, arm in arms)
            variance = float(sum(of_arms))
        noise = 2 * factor**2 * variance * (1 + _NOISE_SD * np.sqrt(2 / independent))
        gaps[joint] = JointGap(size, rms, float(np.sqrt(noise)))
    return gaps


def measure_stretch(poses: BodyPoses, joint: int) -> Stretch:
    """Return the stretch of the segment between a joint (from 0) and the joint before it."""
    (before, start), (_, _) = poses.sides(joint - 1)
    (_, _), (after, end) = poses.sides(joint)
    lowpass = LowPass(min(_GAP_BAND, poses.rate / 5), poses.rate)
    arms = [planar.rotate(poses.angle[:, k], point - poses.centroid[k]) for k, point in ((before, start), (after, end))]
    line = poses.position[:, after] + arms[1] - poses.position[:, before] - arms[0]
    length = np.linalg.norm(line, axis=1)
    variance = 0.0
    if poses.camera is not None:
        for k, arm in zip((before, after), arms, strict=True):
            across = np.nanmean(((arm[:, 1] * line[:, 0] - arm[:, 0] * line[:, 1]) / length) ** 2)
            variance += float(poses.camera[k, 0] + across * poses.camera[k, 1])
    known = erode(np.isfinite(length), lowpass.reach_samples)  # the low-pass keeps the noise of an interval's ends
    slow = lowpass(length[:, None])
    velocity, acceleration = _differentiate(slow, poses.rate)
    course = np.where(known[:, None], np.column_stack([slow - np.nanmean(slow), velocity, acceleration]), np.nan)
    visible = np.sqrt(np.nanmean(course**2, axis=0)) if np.isfinite(course).all(axis=1).any() else np.zeros(3)
    factor, share = _respond_to_noise(lowpass)
    independent = max(share * np.count_nonzero(known), 1.0)
    noise = factor * np.sqrt(variance * (1 + _NOISE_SD * np.sqrt(2 / independent)))
    return Stretch(course[:, 2], (float(visible[0]), float(visible[1]), float(visible[2])), float(noise))


def _respond_to_noise(lowpass: LowPass) -> tuple[float, float]:
    """Return the standard deviation, 1/s², of the filtered second derivative of white noise of 1, and a fraction.

    This fraction of the filtered samples is independent, because neighbouring samples are correlated.
    """
    cycles = (np.arange(_FREQUENCIES) + 0.5) / (2 * _FREQUENCIES)
    turn = 2 * np.pi * cycles
    derivative = lowpass.rate**2 * (30 - 32 * np.cos(turn) + 2 * np.cos(2 * turn)) / 12
    power = (lowpass.gain(cycles) * derivative) ** 2
    return float(np.sqrt(np.mean(power))), float(np.mean(power) ** 2 / np.mean(power**2))


def close_gaps(poses: BodyPoses, joints: Sequence[int]) -> BodyPoses:
    """Return the poses, changed as little as possible so that the gaps of some joints (from 0) are zero.

    With the information W of the poses, the gaps g and their Jacobian J, the change is -W⁻¹ Jᵀ (J W⁻¹ Jᵀ)⁻¹ g. A second
    iteration removes the remainder, which is due to the rotation of the bodies.
    """
    if not joints:
        return poses
    for _ in range(2):
        gap = np.stack([poses.measure_gap(joint) for joint in joints], axis=1)
        step = np.zeros((*poses.angle.shape, 3))  # 0 where a value is missing
        for part in chunks(len(gap)):
            flat, spread = differentiate_gaps(poses, joints, poses.angle[part])
            good = np.isfinite(flat).all(axis=(1, 2)) & np.isfinite(gap[part]).all(axis=(1, 2))
            flat, spread = flat[good], spread[good]
            right = gap[part][good].reshape(-1, 2 * len(joints), 1)
            solved = np.linalg.solve(spread @ np.swapaxes(flat, 1, 2), right)
            step[part][good] = -(np.swapaxes(spread, 1, 2) @ solved).reshape(-1, step.shape[1], 3)
        poses = replace(poses, position=poses.position + step[..., :2], angle=poses.angle + step[..., 2])
    return poses


def differentiate_gaps(poses: BodyPoses, joints: Sequence[int], angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Jacobian J (f, 2j, 3K) of j gaps for angles (f, K), rad, and J W⁻¹ with the information W."""
    size, bodies = angle.shape
    weak = 1.0 / np.concatenate([np.repeat(poses.information[:, :1], 2, axis=1), poses.information[:, 1:]], axis=1)
    jacobian = np.zeros((size, len(joints), 2, bodies, 3))  # x and y of each gap by x, y and angle of each body
    for row, joint in enumerate(joints):
        for sign, (body, point) in zip((-1.0, 1.0), poses.sides(joint), strict=True):
            arm = planar.rotate(angle[:, body], point - poses.centroid[body])
            jacobian[:, row, 0, body, 0] = jacobian[:, row, 1, body, 1] = sign
            jacobian[:, row, 0, body, 2], jacobian[:, row, 1, body, 2] = -sign * arm[:, 1], sign * arm[:, 0]
    flat = jacobian.reshape(size, 2 * len(joints), 3 * bodies)
    return flat, flat * weak.reshape(-1)


class PoseFilter:
    """Low-pass filter of poses that filters every coordinate only once with each cut-off.

    It neither interpolates poses (:func:`fill_gaps`) nor closes gaps (:func:`close_gaps`).
    """

    def __init__(self, poses: BodyPoses) -> None:
        self._poses = poses
        self._series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)  # (T, K, 3)
        self._filtered: dict[tuple[int, float], tuple[FloatArray, FloatArray, FloatArray]] = {}

    def motion(self, bands: tuple[float, float, float]) -> PlanarMotion:
        """Return the filtered motion of the bodies for cut-offs of x, y and angle, Hz."""
        poses = self._poses
        (x, _, ddx), (y, _, ddy), (angle, omega, alpha) = (self._smooth(c, bands[c]) for c in range(3))
        arm = planar.rotate(angle, -poses.centroid)  # from the centroid to the frame's origin
        origin = np.stack([x, y], axis=-1) + arm
        acceleration = np.stack([ddx, ddy], axis=-1) + point_acceleration(arm, omega, alpha)
        place = np.full(angle.shape[1], len(poses.body))  # bodies without a segment are beyond every joint
        place[poses.body[::-1]] = np.arange(len(poses.body))[::-1]
        beyond: BoolArray = place > np.arange(len(poses.centres))[:, None]
        # a joint is at the mean of its positions in the bodies before and after it, plus the correction of its position
        joint = np.full((len(angle), len(poses.centres), 2), np.nan)
        for j in poses.joints:
            sides = [origin[:, body] + planar.rotate(angle[:, body], point) for body, point in poses.sides(j)]
            joint[:, j] = (sides[0] + sides[1]) / 2
            if poses.shift is not None:
                joint[:, j] += planar.rotate(angle[:, int(poses.body[j])], poses.shift[j])
        return PlanarMotion(omega, alpha, origin, acceleration, joint, beyond, angle)

    def _smooth(self, coordinate: int, cutoff: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return one filtered coordinate of all bodies (T, K), and its first and second time derivative."""
        key = coordinate, cutoff
        if key not in self._filtered:
            lowpass = LowPass(min(cutoff, self._poses.rate / 5), self._poses.rate)
            columns = self._series[..., coordinate].T
            smooth = np.stack([lowpass(column) for column in columns], axis=1)
            self._filtered[key] = (smooth, *_differentiate(smooth, self._poses.rate))
        return self._filtered[key]


def filter_motion(poses: BodyPoses, bands: tuple[float, float, float]) -> PlanarMotion:
    """Return the motion of the bodies, filtered with cut-offs of x, y and angle, Hz."""
    return PoseFilter(poses).motion(bands)


def _differentiate(values: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return first and second time derivative from central differences of fourth order; NaN in two samples per end."""
    first, second = np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    back, before, now, after, ahead = (values[k : len(values) - 4 + k] for k in range(5))
    first[2:-2] = (back - 8 * before + 8 * after - ahead) * (rate / 12)
    second[2:-2] = (-back + 16 * before - 30 * now + 16 * after - ahead) * (rate**2 / 12)
    return first, second


_STEP = 1e-5  # m: step of numerical derivatives
_SHARES = 21  # number of divisions of a body that are tried, from the table's division to an even one
_ROUNDING = 1e-9  # relative rounding error of m·Izz


@dataclass(frozen=True)
class ChainMap:
    """Linear map from the full parameters of the bodies to those of the chain: ``matrix @ bodies + constant``."""

    matrix: FloatArray  # (4(n + 1), 4K) linear part of the map
    constant: FloatArray  # (4(n + 1),) constant part of the map
    open: FloatArray  # (4(n + 1), 4(n + 1)) covariance of the division of bodies between two segments
    halves: FloatArray  # (4(n + 1), 4K) linear map that divides every body evenly between its segments

    def apply(self, full: FloatArray) -> FloatArray:
        """Return physically possible full parameters (4(n + 1),) of the chain from those of the bodies (4K,).

        If the table's division of a body gives an impossible segment, the division is changed towards an even one as
        far as necessary; the sum does not change. If no division is possible, the table's division is returned.
        """
        likely, even = self.matrix @ full + self.constant, self.halves @ full
        for share in np.linspace(0.0, 1.0, _SHARES):
            chain = (1.0 - share) * likely + share * even
            mass, mx, my, inertia = chain.reshape(-1, 4).T  # m ≥ 0 and m·Izz ≥ mx² + my² in every possible segment
            if np.all((mass >= 0) & (mass * inertia * (1 + _ROUNDING) >= mx**2 + my**2)):
                return np.asarray(chain)
        return np.asarray(likely)


def map_to_chain(
    poses: BodyPoses, q: FloatArray, samples: BoolArray, reference: FloatArray, reference_sd: FloatArray
) -> ChainMap:
    """Compute the map from the bodies to the segments of the chain.

    ``samples`` (T,) are those over which the mean position of the bodies is computed. ``reference`` and
    ``reference_sd`` (4(n + 1),) are the full parameters of a table and their standard deviations; NaN if none applies.
    """
    count, bodies = len(poses.body), poses.angle.shape[1]
    matrix, constant, spread = np.zeros((4 * count, 4 * bodies)), np.zeros(4 * count), np.zeros((4 * count, 4 * count))
    halves = np.zeros_like(matrix)
    for body in range(bodies):
        own = np.flatnonzero(poses.body == body)
        columns = slice(4 * body, 4 * body + 4)
        if len(own) == 1:
            matrix[4 * own[0] : 4 * own[0] + 4, columns] = halves[4 * own[0] : 4 * own[0] + 4, columns] = np.eye(4)
        elif len(own) > 1:
            rows = np.concatenate([np.arange(4 * k, 4 * k + 4) for k in own])
            total = merge_segments(poses.centres, q, samples, own)
            halves[rows, columns] = np.concatenate(
                [np.linalg.inv(total[:, 4 * k : 4 * k + 4]) / len(own) for k in range(len(own))]
            )
            # the sum is divided as in the table; without a table, it is all in the first segment
            table = reference[rows]
            if np.isfinite(table).all():
                own_spread: FloatArray = np.diag(reference_sd[rows] ** 2)
                gain = np.asarray(np.linalg.solve(total @ own_spread @ total.T, total @ own_spread).T)
                matrix[rows, columns] += gain
                constant[rows] += table - gain @ total @ table
                spread[np.ix_(rows, rows)] += own_spread - gain @ total @ own_spread
            else:
                matrix[rows[:4], columns] += np.eye(4)
    last = int(poses.body[-1])
    for body in np.setdiff1d(np.arange(bodies), poses.body):
        angle, shift = measure_relative_pose(poses, int(body), last, samples)
        transform = average_transform(angle, shift)
        columns = slice(4 * body, 4 * body + 4)
        for each in (matrix, halves):
            each[:, columns] += each[:, 4 * last : 4 * last + 4] @ transform
    return ChainMap(matrix, constant, spread, halves)


def measure_relative_pose(poses: BodyPoses, body: int, other: int, samples: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return angle (S,), rad, and origin (S, 2), m, of a body's frame in another's, in the S samples with both."""
    origin, angle = poses.origin, poses.angle
    known = samples & np.isfinite(angle[:, [body, other]]).all(axis=1)
    shift = planar.rotate(-angle[known, other], origin[known, body] - origin[known, other])
    return np.asarray(angle[known, body] - angle[known, other]), shift


def merge_segments(centres: FloatArray, q: FloatArray, samples: BoolArray, segments: IntArray) -> FloatArray:
    """Return the matrix (4, 4s) that maps parameters of s adjacent segments to their sum in the first one's frame."""
    known = samples & np.isfinite(q).all(axis=1)
    blocks, angle, shift = [np.eye(4)], np.zeros(int(known.sum())), np.zeros((int(known.sum()), 2))
    for segment in segments[1:]:
        shift = shift + planar.rotate(angle, centres[segment - 1])
        angle = angle + q[known, segment - 1]
        blocks.append(average_transform(angle, shift))
    return np.concatenate(blocks, axis=1)


def propagate_to_base(chain_map: ChainMap, base: BaseSet, own: FloatArray) -> FloatArray:
    """Return the covariance (b, b) of the chain's base parameters from ``own`` (4K, 4K), that of the bodies."""
    known = chain_map.matrix @ own @ chain_map.matrix.T + chain_map.open
    return np.asarray(base.regrouping @ known @ base.regrouping.T)


def propagate_centres(base: BaseSet, centres: FloatArray, q: FloatArray, chain: FloatArray) -> FloatArray:
    """Return the derivative (b, n, 2) of the base parameters by each joint centre in the frame before it, per metre.

    A displaced joint changes the regrouping of the masses beyond it and the origin for the parameters of the next
    segment. ``q`` (n,) are the mean joint angles, rad, and ``chain`` (4(n + 1),) the full parameters of the chain.
    """
    out: FloatArray = np.zeros((len(base.kept), *centres.shape))
    undisturbed = structural_base(centres)
    regroups = np.array_equal(undisturbed.kept, base.kept)
    for joint in range(len(centres)):
        for axis in range(2):
            shift = np.zeros_like(centres)
            shift[joint, axis] = _STEP
            after = chain.copy()
            block = slice(4 * joint + 4, 4 * joint + 8)
            own = planar.rotate(-q[joint], shift[joint])  # in the frame of the segment after the joint
            after[block] = average_transform(np.zeros(1), -own[None]) @ chain[block]
            if joint + 1 < len(centres):  # the next joint stays where it is
                shift[joint + 1] = -own
            moved = base.regrouping @ (after - chain)
            if regroups:
                moved += (structural_base(centres + shift).regrouping - undisturbed.regrouping) @ chain
            out[:, joint, axis] = moved / _STEP
    return out
