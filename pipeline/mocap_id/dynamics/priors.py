"""Reference bodies from the tables of Winter (2009) and de Leva (1996), and their priors.

The tables give fractions of body mass and of segment length; here, both legs are one segment. A chain starts at the
ground, so a leg's segment begins at its lower joint. The tables measure centres of mass from the upper joint; here,
they are measured from the lower joint. Head, arms and trunk are one rigid segment, HAT. If the chain has a joint within
the trunk, HAT is divided into the pelvis and the rest. In the upright posture, both together equal the table's HAT.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import CompressedProblem

_HEEL = 0.25  # distance of the ankle from the heel, as a fraction of the foot's length
_ANKLE_HEIGHT = 0.039  # height of the ankle, as a fraction of body height, from Winter's table: de Leva's has none
TableName = Literal["winter", "de-leva"]
Sex = Literal["female", "male"]


@dataclass(frozen=True)
class SegmentFractions:
    """One segment of a reference table, as fractions."""

    mass: float  # mass of both sides together, as a fraction of body mass
    # distance of the centre of mass from the lower end (of the foot: from the heel), as a fraction of the length
    centre: float
    # radius of gyration about the transverse axis through the centre of mass, as a fraction of the length
    gyration: float
    length: float  # length, as a fraction of body height


@dataclass(frozen=True)
class ReferenceTable:
    """The segments of a reference body."""

    foot: SegmentFractions
    shank: SegmentFractions
    thigh: SegmentFractions
    hat: SegmentFractions
    pelvis: SegmentFractions  # part of `hat` below a joint within the trunk


def estimate_height(reference: ReferenceTable, shank: float, thigh: float) -> float:
    """Return the height of the body, m, estimated from the lengths of shank and thigh, m."""
    return (shank + thigh) / (reference.shank.length + reference.thigh.length)


def scale_reference(
    reference: ReferenceTable,
    centres: FloatArray,
    height: float,
    mass: float,
    facing: int,
    *,
    standing: FloatArray | None = None,
) -> FloatArray:
    """Return the full parameters of a reference body as a chain of 4 or 5 segments.

    The segments are foot, shank, thigh and torso; with 4 joints the torso is divided into pelvis and trunk. The lengths
    of shank, thigh and pelvis are taken from the chain, whose joint centres (3, 2) or (4, 2), m, have segment frames
    with +Y towards the next joint; the lengths of foot and HAT follow from the height, m. The foot is flat on the
    ground, with a quarter of its length behind the ankle. The person faces +x of the plane frame if ``facing`` is 1,
    and -x if it is -1. HAT is upright while the person stands: ``standing`` (n,) are the angles of the frames, except
    the base's, in this posture, rad; by default, those above the hip are upright.
    """
    if len(centres) not in (3, 4):
        raise ValueError(f"a reference body has 3 or 4 joints; this chain has {len(centres)}")
    foot_length = reference.foot.length * height
    heel = centres[0, 0] - facing * _HEEL * foot_length
    foot_centre = np.array([heel + facing * reference.foot.centre * foot_length, _ANKLE_HEIGHT * height / 2])
    links = [_compute_moments(reference.foot.mass * mass, foot_centre, reference.foot.gyration * foot_length)]
    for link, end in ((reference.shank, centres[1]), (reference.thigh, centres[2])):
        length = float(np.linalg.norm(end))
        links.append(_compute_moments(link.mass * mass, link.centre * end, link.gyration * length))
    hat, angles = reference.hat, np.zeros(len(centres)) if standing is None else standing

    def rotate(parameters: FloatArray, angle: float) -> FloatArray:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.array([parameters[0], *(turn @ parameters[1:3]), parameters[3]])

    def place_on_hip(part: SegmentFractions) -> FloatArray:
        length = part.length * height
        return _compute_moments(part.mass * mass, np.array([0.0, part.centre * length]), part.gyration * length)

    whole = place_on_hip(hat)
    if len(centres) == 3:
        return np.concatenate([*links, rotate(whole, -angles[2])])
    pelvis = place_on_hip(reference.pelvis)
    # the rest of HAT, with the joint within the trunk as the origin
    c, s = np.cos(angles[2]), np.sin(angles[2])
    shift = -(np.array([[c, -s], [s, c]]) @ centres[3])
    rest = whole - pelvis
    inertia = rest[3] + 2 * float(rest[1:3] @ shift) + rest[0] * float(shift @ shift)
    trunk = np.array([rest[0], *(rest[1:3] + rest[0] * shift), inertia])
    return np.concatenate([*links, rotate(pelvis, -angles[2]), rotate(trunk, -angles[3])])


# table 4.1 of Winter (2009), with the pelvis's radius of gyration from de Leva's lower trunk
_WINTER = ReferenceTable(
    foot=SegmentFractions(2 * 0.0145, 0.50, 0.475, 0.152),
    shank=SegmentFractions(2 * 0.0465, 1 - 0.433, 0.302, 0.246),
    thigh=SegmentFractions(2 * 0.100, 1 - 0.433, 0.323, 0.245),
    hat=SegmentFractions(0.678, 0.626, 0.496, 0.288),
    pelvis=SegmentFractions(0.142, 0.105, 0.151, 0.288),
)
_DE_LEVA: dict[Sex, dict[str, tuple[float, float, float, float]]] = {
    # mass % (one side), length mm, centre of mass % from the upper end, transverse radius of gyration %
    "female": {
        "head": (6.68, 243.7, 48.41, 29.5),  # vertex to cervicale
        "trunk": (42.57, 614.8, 49.64, 29.2),  # cervicale to mid-hip
        "lower trunk": (12.47, 181.5, 49.20, 40.2),  # omphalion to mid-hip
        "upper arm": (2.55, 275.1, 57.54, 26.0),
        "forearm": (1.38, 264.3, 45.59, 25.7),
        "hand": (0.56, 78.0, 74.74, 45.4),
        "thigh": (14.78, 368.5, 36.12, 36.4),
        "shank": (4.81, 432.3, 44.16, 26.7),
        "foot": (1.29, 228.3, 40.14, 27.9),
    },
    "male": {
        "head": (6.94, 242.9, 50.02, 31.5),
        "trunk": (43.46, 603.3, 51.38, 30.6),
        "lower trunk": (11.17, 145.7, 61.15, 55.1),
        "upper arm": (2.71, 281.7, 57.72, 26.9),
        "forearm": (1.62, 268.9, 45.74, 26.5),
        "hand": (0.61, 86.2, 79.00, 51.3),
        "thigh": (14.16, 422.2, 40.95, 32.9),
        "shank": (4.33, 434.0, 44.59, 24.9),
        "foot": (1.37, 258.1, 44.15, 24.5),
    },
}
_STATURE: dict[Sex, float] = {"female": 1735.0, "male": 1741.0}  # mm, of the people in the table
_SHOULDER: dict[Sex, float] = {"female": 497.9, "male": 515.5}  # mm, mid-shoulder above mid-hip


def look_up_table(name: TableName, sex: Sex | None) -> ReferenceTable:
    """Return the reference table of this name; if ``sex`` is None, de Leva's table is the mean of both sexes."""
    if name == "winter":
        return _WINTER
    if sex is not None:
        return _build_de_leva(sex)
    female, male = _build_de_leva("female"), _build_de_leva("male")
    names = ("foot", "shank", "thigh", "hat", "pelvis")
    means = {name: _average(getattr(female, name), getattr(male, name)) for name in names}
    return ReferenceTable(**means)


def _build_de_leva(sex: Sex) -> ReferenceTable:
    """Return table 4 of de Leva (1996) for one sex."""
    rows, stature = _DE_LEVA[sex], _STATURE[sex]
    both = ("upper arm", "forearm", "hand", "thigh", "shank", "foot")
    total = sum(rows[n][0] for n in ("head", "trunk")) + 2 * sum(rows[n][0] for n in both)  # 100, except for rounding

    def build_segment(name: str, sides: int = 2, *, from_top: bool = False) -> SegmentFractions:
        mass, length, centre, gyration = rows[name]
        fraction = centre / 100 if from_top else 1 - centre / 100
        return SegmentFractions(sides * mass / total, fraction, gyration / 100, length / stature)

    # head, arms and trunk as one segment above the hip; the arms hang from the shoulders, up to which its length is
    # measured, as in Winter
    length = _SHOULDER[sex]
    tops = {"head": rows["trunk"][1] + rows["head"][1], "trunk": rows["trunk"][1], "upper arm": length}
    tops["forearm"] = tops["upper arm"] - rows["upper arm"][1]
    tops["hand"] = tops["forearm"] - rows["forearm"][1]
    sides = {"head": 1, "trunk": 1, "upper arm": 2, "forearm": 2, "hand": 2}
    mass = np.array([sides[n] * rows[n][0] / total for n in tops])
    centre = np.array([top - rows[n][2] / 100 * rows[n][1] for n, top in tops.items()])
    gyration = np.array([rows[n][3] / 100 * rows[n][1] for n in tops])
    whole = float(mass @ centre / mass.sum())
    radius = float(np.sqrt(mass @ (gyration**2 + (centre - whole) ** 2) / mass.sum()))
    hat = SegmentFractions(float(mass.sum()), whole / length, radius / length, length / stature)
    lower = build_segment("lower trunk", 1)
    low, about = lower.centre * lower.length / hat.length, lower.gyration * lower.length / hat.length
    return ReferenceTable(
        foot=build_segment("foot", from_top=True),
        shank=build_segment("shank"),
        thigh=build_segment("thigh"),
        hat=hat,
        pelvis=SegmentFractions(lower.mass, low, about, hat.length),
    )


def look_up_arm(name: Literal["forearm", "hand"], sex: Sex | None) -> SegmentFractions:
    """Return one forearm or hand of de Leva's table, with the centre measured from the upper end.

    If ``sex`` is None, the result is the mean of both sexes.

    Examples
    --------
    >>> round(look_up_arm("forearm", "male").mass, 4)
    0.0162
    """
    segments = []
    for each in ("female", "male") if sex is None else (sex,):
        mass, length, centre, gyration = _DE_LEVA[each][name]
        segments.append(SegmentFractions(mass / 100, centre / 100, gyration / 100, length / _STATURE[each]))
    return segments[0] if len(segments) == 1 else _average(*segments)


def _average(a: SegmentFractions, b: SegmentFractions) -> SegmentFractions:
    return SegmentFractions(*((getattr(a, f) + getattr(b, f)) / 2 for f in ("mass", "centre", "gyration", "length")))


def _compute_moments(mass: float, centre: FloatArray, gyration: float) -> FloatArray:
    """Return m, mx, my, Izz about the frame's origin from mass, centre of mass (2,) and radius of gyration."""
    return np.array([mass, *(mass * centre), mass * (gyration**2 + float(centre @ centre))])


FOOT_MOMENT = 1  # column of the foot's mx among the full parameters
_LEAST = 1e-6  # SI: least standard deviation, for parameters that are zero
_APART = 3.0  # difference above which data and prior contradict each other, in standard deviations
_OPEN = 10.0  # relative standard deviation of parameters that are left to the data


def compute_reference_sd(reference: FloatArray, relative: float) -> FloatArray:
    """Return the sd (4(n + 1),) of a reference: a fraction of each segment's m, |(mx, my)| and Izz."""
    blocks = np.abs(reference.reshape(-1, 4))
    first = np.hypot(blocks[:, 1], blocks[:, 2])
    scale = relative * np.column_stack([blocks[:, 0], first, first, blocks[:, 3]])
    return np.maximum(scale, _LEAST).reshape(-1)


def compute_foot_sd(reference: FloatArray, first_moment: float, relative: float) -> FloatArray:
    """Return the standard deviations (4(n + 1),) of a reference that is used only for the foot, the first segment.

    The mass of the foot is small, so its first moment differs little between people. Given this moment, the torque of
    the ankle follows from the centre of pressure and the position of the joint, and not from the masses above.
    ``first_moment`` is the standard deviation of the foot's mx, kg·m, and ``relative`` that of its mass, as a fraction.
    """
    deviations = compute_reference_sd(reference, _OPEN)
    deviations[:2] = relative * reference[0], first_moment
    return np.maximum(deviations, _LEAST)


@dataclass(frozen=True)
class ReferencePrior:
    """A reference body as a normal distribution of the full parameters.

    In the methods, ``covariance`` (b, b) is the covariance of base parameters that were fitted to data, and
    ``regrouping`` (b, f) is the matrix M of eq. 4.24 from f = 4(n + 1) full parameters to b base parameters.
    """

    # mean, sd: (4(n + 1),) full parameters and their standard deviations
    mean: FloatArray
    sd: FloatArray

    def add_to(
        self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, rest: float
    ) -> CompressedProblem:
        """Return the least-squares problem of data and prior in the full parameters.

        The cost of full parameters φ is (M φ - base)ᵀ covariance⁻¹ (M φ - base) + ‖(φ - mean) / sd‖² + rest, where
        ``base`` (b,) are the base parameters of the fit without constraint or prior.
        """
        root = np.linalg.cholesky(covariance)
        rows = np.vstack([solve_triangular(root, regrouping, lower=True), np.diag(1 / self.sd)])
        target = np.concatenate([solve_triangular(root, base, lower=True), self.mean / self.sd])
        return CompressedProblem.of(rows, target, rest)

    def gain(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the weight (b, b) of the data in the base parameters; the prior has the remaining weight."""
        spread = self._spread(regrouping)
        return np.asarray(np.linalg.solve(spread + covariance, spread).T)

    def contradicts(self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, parameter: int) -> bool:
        """Return whether the prior would change a base parameter by more than 3 standard deviations of the change."""
        rest = np.eye(len(base)) - self.gain(covariance, regrouping)
        moved, variance = rest @ (base - regrouping @ self.mean), np.diag(rest @ covariance)
        return bool(moved[parameter] ** 2 > _APART**2 * variance[parameter])

    def covariance(self, gain: FloatArray, regrouping: FloatArray, of_data: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of base parameters from the prior and from data with covariance ``of_data``."""
        rest = np.eye(len(gain)) - gain
        return np.asarray(gain @ of_data @ gain.T + rest @ self._spread(regrouping) @ rest.T)

    def complete(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (f, f) of the full parameters; what the base leaves open has the prior's covariance."""
        spread = np.diag(self.sd**2)
        follow = np.linalg.solve(self._spread(regrouping), regrouping @ spread).T
        return np.asarray(follow @ covariance @ follow.T + spread - follow @ regrouping @ spread)

    def _spread(self, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of the prior's base parameters."""
        return np.asarray(regrouping @ np.diag(self.sd**2) @ regrouping.T)


OTHERS_SHARE = 0.1  # mass of both arms, on which most markers without a segment are, as a fraction of the body's mass
_FOOT_SPREAD = 1 / 2.8
_MASS, _CENTRE, _INERTIA = 0.5, 0.10, 1.0
_ARMS_MASS = 0.25
_FOOT_MASS, _FOOT_CENTRE = 0.3, 0.05
_GYRATION = 0.15  # m: radius of gyration of a body that no table describes
_UNKNOWN_MASS, _UNKNOWN_CENTRE, _UNKNOWN_INERTIA = 1.0, 0.15, 5.0
_LEAST_MASS = 1e-3  # kg: least mass


@dataclass(frozen=True)
class BodyPrior:
    """Normal distribution of the full parameters of K bodies."""

    mean: FloatArray  # (4K,) full parameters
    covariance: FloatArray  # (4K, 4K) covariance of the full parameters
    source: str  # source of the mean, in words
    # (r, 2) first and last time of every repetition, s; errors of the poses recur in each repetition
    spans: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    # standard deviation of the errors of the first body's mean, as a fraction of the prior's standard deviation
    foot_spread: float = 1.0

    @property
    def spread(self) -> FloatArray:
        """Standard deviations (4K,) of the errors of the rows of :meth:`rows`; 1, except for the foot."""
        return np.concatenate([np.full(4, self.foot_spread), np.ones(len(self.mean) - 4)])

    def rows(self, columns: int) -> tuple[FloatArray, FloatArray]:
        """Return least-squares rows (4K, columns) and right-hand side (4K,); columns after the first 4K are zero."""
        root = np.linalg.cholesky(self.covariance)
        own = solve_triangular(root, np.eye(len(self.mean)), lower=True)
        return np.pad(own, ((0, 0), (0, columns - len(self.mean)))), own @ self.mean


def build_table_prior(mean: FloatArray, source: str, others: bool = False) -> BodyPrior:
    """Return the prior whose mean (4K,) is from a table, foot first and, with ``others``, arms and head last."""
    spread = [(_FOOT_MASS, _FOOT_CENTRE, _INERTIA), *[(_MASS, _CENTRE, _INERTIA)] * (len(mean) // 4 - 1)]
    if others:
        spread[-1] = (_ARMS_MASS, _CENTRE, _INERTIA)
    blocks = [_compute_covariance(body, *sd) for body, sd in zip(mean.reshape(-1, 4), spread, strict=True)]
    return BodyPrior(mean, block_diag(*blocks), source, foot_spread=_FOOT_SPREAD)


def build_even_prior(mass: float, centroid: FloatArray) -> BodyPrior:
    """Return the prior if no table applies: equal parts of ``mass``, kg, at the markers' centroids (K, 2), m."""
    own = mass / len(centroid)
    inertia = own * (_GYRATION**2 + np.sum(centroid**2, axis=1))
    mean = np.column_stack([np.full(len(centroid), own), own * centroid, inertia])
    blocks = [_compute_covariance(body, _UNKNOWN_MASS, _UNKNOWN_CENTRE, _UNKNOWN_INERTIA) for body in mean]
    return BodyPrior(mean.reshape(-1), block_diag(*blocks), "an even division of the mass")


def split_torso(torso: FloatArray, angle: FloatArray, shift: FloatArray, mass: float) -> tuple[FloatArray, FloatArray]:
    """Split a table's head, arms and trunk (4,) into the torso (4,) and the body (4,) of the markers on no segment.

    On average over the samples, the two bodies together equal the given body. ``angle`` (T,), rad, and ``shift`` (T,
    2), m, are the pose of the second body's frame in the torso's frame; its origin is the centroid of the markers on no
    segment. ``mass`` is that of the whole body, kg.
    """
    own = min(OTHERS_SHARE * mass, 0.5 * torso[0])
    others = np.array([own, 0.0, 0.0, own * _GYRATION**2])
    rest = torso - average_transform(angle, shift) @ others
    centre = rest[1:3] / rest[0]
    floor = rest[0] * (float(centre @ centre) + _GYRATION**2)
    return np.array([*rest[:3], max(rest[3], floor)]), others


def average_transform(angle: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the mean over samples of the matrix (4, 4) that transforms a body's parameters into another frame."""
    c, s, (x, y) = np.cos(angle), np.sin(angle), shift.T  # pose (T,) and (T, 2) of the body's frame in the other one
    move = np.zeros((len(angle), 4, 4))
    move[:, 0, 0] = move[:, 3, 3] = 1.0
    move[:, 1, 0], move[:, 1, 1], move[:, 1, 2] = x, c, -s
    move[:, 2, 0], move[:, 2, 1], move[:, 2, 2] = y, s, c
    move[:, 3, 0] = x * x + y * y
    move[:, 3, 1], move[:, 3, 2] = 2 * (x * c + y * s), 2 * (y * c - x * s)
    return np.asarray(move.mean(axis=0))


def _compute_covariance(body: FloatArray, mass_sd: float, centre_sd: float, inertia_sd: float) -> FloatArray:
    """Return the covariance (4, 4) of m, mx, my, Izz for independent errors of mass, centre and central moment."""
    mass = max(float(body[0]), _LEAST_MASS)
    x, y = body[1:3] / mass
    own = max(float(body[3]) - mass * (x * x + y * y), mass * (0.2 * _GYRATION) ** 2)
    gain = np.diag([1.0, mass, mass, 1.0])
    gain[1:, 0], gain[3, 1:3] = (x, y, x * x + y * y), (2 * mass * x, 2 * mass * y)
    sd = np.array([mass_sd * mass, centre_sd, centre_sd, inertia_sd * own])
    return np.asarray((gain * sd) @ (gain * sd).T)
