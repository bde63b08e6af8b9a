"""Kinds and axes of joints in space, and the chain of an arm with constant lengths from a skeleton (thesis 7.2.3).

The joints from a depth camera have noise, and errors of some centimetres that persist for the whole trial. The
persistent error of the elbow relative to the shoulder can be estimated, because the elbow moves on a sphere about
another point than the measured shoulder. The centre of this sphere is the shoulder of the chain. The persistent error
of the wrist relative to the elbow is estimated in the same way and removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import Refused
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind
from mocap_id.kinematics.space.bodies import mean_rotation, rigid_poses
from mocap_id.kinematics.space.bundle import tangents

_EXPLAINED: dict[JointKind, float] = {"hinge": 1.15, "two-axis": 3.4, "ball": np.inf}
"""Largest unexplained rotation of a kind, relative to the noise of the clusters. Soft tissue affects two axes more."""
_PIN_EXPLAINED = 6.0  # the same for a likely second axis; a wrong axis leaves far more
SHOWN = float(np.radians(10))
"""Least arc, rad, that determines the kind of a joint."""
_LEAST_NOISE = np.radians(0.15)
PARALLEL = 0.75
"""Largest cosine of the angle between the axes of a two-axis joint."""
_UPRIGHT = 0.05  # weight of a right angle between two axes during the search, relative to the motion
_TURNS = 40
_STARTS = 12


@dataclass(frozen=True)
class JointEvidence:
    """Evidence from the motion for the kind of a joint."""

    kind: JointKind  # kind in use
    likely: JointKind  # simplest kind that explains the rotation; a ball if the joint hardly rotates
    ratio: dict[JointKind, float]  # rms rotation left unexplained, relative to the noise of the clusters
    arc: float  # 2.5 to 97.5 % range of the rotation about its main direction, rad


JointAxes: TypeAlias = tuple[FloatArray, FloatArray, float]
"""Axis in the parent's frame, axis in the child's frame, and the cosine of the angle between them."""


def weigh_kinds(turn: FloatArray, noise: FloatArray, arc: float, kind: JointKind | None = None) -> JointEvidence:
    """Return the evidence for the kind of a joint; ``kind`` is the kind that the user has chosen, if any.

    ``turn`` (F, 3, 3) is the rotation of the child in the parent, and ``noise`` (3, 3) the covariance of its error at
    one time, in the parent's axes, rad². ``arc`` is the range of the rotation between the clusters, rad.
    """
    noise = noise + _LEAST_NOISE**2 * np.eye(3)
    (first, second, _), pair = fit_hinge(turn), fit_two_axes(turn)
    across = tangents(first)
    tilt = np.cross(first, turn @ second) @ across
    noise_across = across.T @ noise @ across
    over = np.linalg.eigvals(np.linalg.solve(noise_across, tilt.T @ tilt / len(turn))).real.max()
    gap, size = _measure_gap(turn, pair, noise)
    ratio: dict[JointKind, float] = {
        "hinge": float(np.sqrt(over)),
        "two-axis": float(np.sqrt(np.mean(gap**2 / size))),
        "ball": 0.0,
    }
    fits: list[JointKind] = [each for each in ratio if ratio[each] <= _EXPLAINED[each]]
    likely: JointKind = fits[0] if arc >= SHOWN else "ball"
    return JointEvidence(kind or likely, likely, ratio, arc)


def _measure_gap(turn: FloatArray, pair: JointAxes, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the angle that two axes leave unexplained (F,), rad, and the variance of its noise, rad²."""
    first, second, cosine = pair
    rotated = turn @ second
    normal = np.cross(first, rotated)
    gap = (rotated @ first - cosine) / np.sqrt(max(1 - cosine**2, 1e-6))
    return gap, np.einsum("fi,ij,fj->f", normal, noise, normal) / np.maximum((normal**2).sum(axis=1), 1e-9)


def fit_pin_axes(turn: FloatArray, noise: FloatArray, pin: FloatArray) -> JointAxes | None:
    """Return two axes of which the second is ``pin`` (3,); None if these do not explain the rotation."""
    middle = turn.mean(axis=0)
    rotated = turn @ pin
    spread = rotated - middle @ pin
    pull = _UPRIGHT * np.sum(spread**2) / len(turn)
    first = _smallest_eigenvectors(spread.T @ spread / len(turn) + pull * np.outer(middle @ pin, middle @ pin))
    pair = first, pin, float(first @ middle @ pin)
    gap, size = _measure_gap(turn, pair, noise + _LEAST_NOISE**2 * np.eye(3))
    return pair if np.sqrt(np.mean(gap**2 / size)) <= _PIN_EXPLAINED else None


def rotation_arc(turn: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of rotations (F, 3, 3) about their main direction, rad."""
    vectors = so3.log(np.swapaxes(mean_rotation(turn), 0, 1) @ turn)
    vectors = vectors - vectors.mean(axis=0)
    main = np.linalg.eigh(vectors.T @ vectors)[1][:, -1]
    low, high = np.quantile(vectors @ main, [0.025, 0.975])
    return float(high - low)


def fit_hinge(turn: FloatArray) -> JointAxes:
    """Return the axis that best keeps its direction in both bodies."""
    left, _, right = np.linalg.svd(turn.mean(axis=0))
    return left[:, 0], right[0], 1.0


def fit_two_axes(turn: FloatArray) -> JointAxes:
    """Return the two axes, one in each body, whose angle changes least.

    The cosine of the angle is a · Q b. Its variance is a quadratic form in each axis, so the axes are improved
    alternately.
    """
    middle = turn.mean(axis=0)
    spread = (turn - middle).reshape(len(turn), 9)
    form = (spread.T @ spread / len(turn)).reshape(3, 3, 3, 3)
    size = float(np.trace(spread.T @ spread)) / len(turn)
    at = np.arange(_STARTS) + 0.5  # starts are spread over a half sphere
    height, around = at / _STARTS, np.pi * (1 + np.sqrt(5)) * at
    flat = np.sqrt(1 - height**2)
    second = np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=1)
    for pull in (*[_UPRIGHT * size] * _TURNS, *[1e-3 * size] * _TURNS):
        rotated = second @ middle.T
        upright = pull * (rotated[:, :, None] * rotated[:, None, :])
        first = _smallest_eigenvectors(np.einsum("ijkl,sj,sl->sik", form, second, second) + upright)
        rotated = first @ middle
        upright = pull * (rotated[:, :, None] * rotated[:, None, :])
        second = _smallest_eigenvectors(np.einsum("ijkl,si,sk->sjl", form, first, first) + upright)
    cosine = np.einsum("si,ij,sj->s", first, middle, second)
    value = np.einsum("ijkl,si,sj,sk,sl->s", form, first, second, first, second) / np.maximum(1 - cosine**2, 1e-6)
    best = int(np.argmin(value + (np.abs(cosine) > PARALLEL) * size))
    return first[best], second[best], float(cosine[best])


def _smallest_eigenvectors(form: FloatArray) -> FloatArray:
    """Return the eigenvectors (..., 3) of the smallest eigenvalues of forms (..., 3, 3)."""
    return np.asarray(np.linalg.eigh(form)[1][..., 0])


LASTING_SD = 0.02
"""Standard deviation of the persistent error of a joint along each axis, m."""

_ROUNDS = 3
_OUTLIER = 3.0  # standard deviations of a distance; farther samples have little weight
_LEAST_SD = 2e-3  # m; least standard deviation
_LEAST_FRAMES = 20
_ITERATIONS = 30
_MOST, _OF_NORMAL = 0.85, 1.44  # quantile of the size of noise, and its value for unit variance
_POSTURE, _POSTURE_SD = 0.8, 0.008  # s, m; duration of a posture, and error of a distance common to its samples
_SHORTEST = 0.03  # m, of a segment
_LAGS = (1, 4)  # frames; lags at which the autocorrelation is measured


@dataclass(frozen=True)
class Trunk:
    """Trunk as a rigid body, in anatomical axes (x forward, y up, z right) with the origin between the shoulders."""

    roles: tuple[str, ...]  # roles of the T joints
    local: FloatArray  # (T, 3) positions of the joints, m
    residual: FloatArray  # (T,) standard deviation of one coordinate of each joint, m
    rotations: FloatArray  # (F, 3, 3) trunk to trial; NaN where unknown
    origins: FloatArray  # (F, 3) m; NaN where unknown


@dataclass(frozen=True)
class Bone:
    """Segment of constant length from a fixed centre."""

    centre: FloatArray  # (3,) centre of the sphere in the trunk's axes, m
    length: float  # m
    covariance: FloatArray  # (4, 4) covariance of centre and length, m²
    noise: float  # standard deviation of the distance, m


def fit_trunk(points: Mapping[str, FloatArray]) -> Trunk:
    """Fit the trunk to its joints; ``points`` maps their roles (right arm) to their trajectories (F, 3), m.

    A skeleton without two shoulders, or without a joint below them, is refused.
    """
    roles = tuple(points)
    below = [name for name in ("pelvis", "near_hip", "far_hip", "spine") if name in roles]
    if not {"near_shoulder", "far_shoulder"} <= set(roles) or not below:
        raise Refused(
            "skeleton-incomplete",
            "the thorax needs both shoulders and a joint of the spine or the hips; the skeleton has "
            f"{', '.join(roles) or 'none of them'}.",
        )
    tracks = np.stack([points[name] for name in roles], axis=1)

    # the first shape is that of the frame whose joint distances are closest to their medians
    seen = np.isfinite(tracks).all(axis=(1, 2))
    if not seen.any():
        seen = np.isfinite(tracks).all(axis=2).sum(axis=1) >= 3
    if not seen.any():
        raise Refused("skeleton-incomplete", "no frame of the skeleton contains three joints of the trunk.")
    some = tracks[seen]
    shape = some - np.nanmean(some, axis=1, keepdims=True)
    distance = np.linalg.norm(shape[:, :, None] - shape[:, None], axis=3)
    off = np.nansum((distance - np.nanmedian(distance, axis=0)) ** 2, axis=(1, 2))
    local, weight = np.asarray(shape[int(np.argmin(off))]), np.ones(len(roles))
    for _ in range(_ROUNDS):
        rotations, origins = _fit_poses(tracks, local, weight)
        back = np.einsum("fji,fkj->fki", rotations, tracks - origins[:, None])
        local = np.nanmedian(back, axis=0)
        residual = np.sqrt(np.mean(_robust_sd(back - local) ** 2, axis=1))
        weight = 1 / residual**2

    # anatomical axes from the shape of the trunk
    at = dict(zip(roles, local, strict=True))

    def middle(*names: str) -> FloatArray | None:
        here = [at[name] for name in names if name in at]
        return np.mean(here, axis=0) if len(here) == len(names) else None

    shoulders = (at["near_shoulder"] + at["far_shoulder"]) / 2
    tops = (middle("spine_top"), middle("neck"))
    top = next((each for each in tops if each is not None), shoulders)
    bottoms = (middle("pelvis"), middle("near_hip", "far_hip"), middle("spine"))
    bottom = next((each for each in bottoms if each is not None), np.mean([at[n] for n in at if "hip" in n], axis=0))
    y = (top - bottom) / np.linalg.norm(top - bottom)
    across = at["near_shoulder"] - at["far_shoulder"]
    if {"near_hip", "far_hip"} <= at.keys():
        across = across + at["near_hip"] - at["far_hip"]
    z = across - (across @ y) * y
    z /= np.linalg.norm(z)
    local = (local - shoulders) @ np.stack([np.cross(y, z), y, z], axis=1)
    rotations, origins = _fit_poses(tracks, local, weight)
    share = np.clip(1 - 2 * weight / weight.sum(), 0.3, 1.0)  # the pose follows a joint by up to six of 3 T coordinates
    return Trunk(roles, local, residual / np.sqrt(share), rotations, origins)


def _fit_poses(tracks: FloatArray, local: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotations and origins of the trunk in every frame."""
    seen = np.isfinite(tracks).all(axis=2) & np.isfinite(local).all(axis=1)
    rotations, origins, _ = rigid_poses(tracks, local, seen * weight / weight.max())
    return rotations, origins


def fit_bone(tips: FloatArray, expected: FloatArray, expected_sd: float, *, rate: float) -> Bone:
    """Fit a sphere to the positions of a bone's end.

    The positions ``tips`` (F, 3) are in the trunk's axes, m, NaN where missing; ``rate`` is in frames per second.
    ``expected`` (3,) is the measured centre, m, and ``expected_sd`` the standard deviation of its persistent error
    along each axis, m.
    A joint in fewer than 20 frames is refused.
    """
    tips = tips[np.isfinite(tips).all(axis=1)]
    if len(tips) < _LEAST_FRAMES:
        raise Refused(
            "skeleton-incomplete", f"fewer than {_LEAST_FRAMES} frames contain shoulder, elbow and wrist together."
        )
    together = max(_POSTURE * rate, 1.0)
    centre, length = expected.copy(), float(np.median(np.linalg.norm(tips - expected, axis=1)))
    noise = 0.01
    information = np.eye(4)
    for _ in range(_ITERATIONS):
        arm = tips - centre
        distance = np.maximum(np.linalg.norm(arm, axis=1), _SHORTEST)
        off = distance - length
        noise = float(_robust_sd(off - np.median(off)))
        weight = 1 / (1 + (off / (_OUTLIER * noise)) ** 2) ** 2 / (noise**2 + _POSTURE_SD**2) / together
        rows = np.column_stack([-arm / distance[:, None], -np.ones(len(tips))])
        information = np.einsum("fi,f,fj->ij", rows, weight, rows)
        information[:3, :3] += np.eye(3) / expected_sd**2
        pull = np.einsum("fi,f,f->i", rows, weight, off)
        pull[:3] += (centre - expected) / expected_sd**2
        step = np.linalg.solve(information + 1e-9 * np.eye(4), pull)
        centre, length = centre - step[:3], length - float(step[3])
        if np.abs(step).max() < 1e-6:
            break
    return Bone(centre, length, np.asarray(np.linalg.inv(information), dtype=np.float64), noise)


def _robust_sd(off: FloatArray) -> FloatArray:
    """Return the standard deviation over the first axis, m, without outliers but with the noise of fast movement."""
    size = np.abs(off)
    usual, large = 1.4826 * np.nanmedian(size, axis=0), np.nanquantile(size, _MOST, axis=0) / _OF_NORMAL
    return np.asarray(np.maximum(np.maximum(usual, large), _LEAST_SD))


def fit_sensor_noise(residuals: FloatArray, rate: float) -> tuple[float, float]:
    """Return the noise of the sensor from the autocorrelation of residuals (F, K), m; NaN where missing.

    The results are the fraction of the variance that is white, and the time in which the autocorrelation of the rest
    decays to 1/e, s.
    """
    off = residuals - np.nanmedian(residuals, axis=0)
    off = np.where(np.abs(off) < _OUTLIER * _robust_sd(off), off, np.nan)
    total = np.nanmean(off**2)
    short, long = (float(np.nanmean(off[lag:] * off[:-lag]) / total) for lag in _LAGS)
    if not (short > 0.05 and 0.01 < long < short):
        return 1.0, 1 / rate
    frames = (_LAGS[1] - _LAGS[0]) / np.log(short / long)
    slow = min(short * float(np.exp(_LAGS[0] / frames)), 0.98)
    return 1 - slow, float(np.clip(frames / rate, 1 / rate, 2.0))


def sensor_noise_power(white: float, memory: float, frequency: FloatArray, dt: float) -> FloatArray:
    """Return the power of the noise of :func:`fit_sensor_noise`, relative to white noise of the same variance.

    The frequencies (K,) are in Hz, and ``dt`` is the time between samples, s.
    """
    fades = float(np.exp(-dt / memory))
    turned = 1 - 2 * fades * np.cos(2 * np.pi * frequency * dt) + fades**2
    return np.asarray(white + (1 - white) * (1 - fades**2) / turned)
