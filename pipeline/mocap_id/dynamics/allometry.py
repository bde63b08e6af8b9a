"""Reference bodies from height, mass and sex: the tables of Winter (2009) and de Leva (1996).

The tables give fractions of body mass and of segment length; here, both legs are one segment. A chain starts at the
ground, so a leg's segment begins at its lower joint. The tables measure centres of mass from the upper joint; here,
they are measured from the lower joint. Head, arms and trunk are one rigid segment, HAT. If the chain has a joint within
the trunk, HAT is divided into the pelvis and the rest. In the upright posture, both together equal the table's HAT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import FloatArray

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

    name: str  # name of the table
    foot: SegmentFractions
    shank: SegmentFractions
    thigh: SegmentFractions
    hat: SegmentFractions
    pelvis: SegmentFractions  # part of `hat` below a joint within the trunk
    ankle_height: float  # height of the ankle, as a fraction of body height


def look_up_table(name: TableName, sex: Sex | None) -> ReferenceTable:
    """Return the reference table of this name; if ``sex`` is None, de Leva's table is the mean of both sexes."""
    if name == "winter":
        return _build_winter()
    if sex is not None:
        return _build_de_leva(sex)
    female, male = _build_de_leva("female"), _build_de_leva("male")
    names = ("foot", "shank", "thigh", "hat", "pelvis")
    means = {name: _average(getattr(female, name), getattr(male, name)) for name in names}
    return ReferenceTable("de-leva", **means, ankle_height=female.ankle_height)


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
    of shank, thigh and pelvis are taken from the chain; the lengths of foot and HAT follow from the height. The foot is
    flat on the ground, with a quarter of its length behind the ankle. HAT is upright while the person stands.

    Parameters
    ----------
    reference : ReferenceTable
        Reference table of the person.
    centres : (3, 2) or (4, 2) array
        Centre of each joint in the frame of the segment before it, m. Segment frames have +Y towards the next joint.
    height, mass : float
        Height, m, and mass, kg, of the body.
    facing : {-1, 1}
        1 if the person faces +x of the plane frame, -1 if the person faces -x.
    standing : (n,) array, optional
        Angle of each segment's frame, except the base's, in the plane frame while the person stands, rad. By default,
        the frames above the hip are upright.
    """
    if len(centres) not in (3, 4):
        raise ValueError(f"a reference body has 3 or 4 joints; this chain has {len(centres)}")
    foot_length = reference.foot.length * height
    heel = centres[0, 0] - facing * _HEEL * foot_length
    foot_centre = np.array([heel + facing * reference.foot.centre * foot_length, reference.ankle_height * height / 2])
    links = [_compute_moments(reference.foot.mass * mass, foot_centre, reference.foot.gyration * foot_length)]
    for link, end in ((reference.shank, centres[1]), (reference.thigh, centres[2])):
        length = float(np.linalg.norm(end))
        links.append(_compute_moments(link.mass * mass, link.centre * end, link.gyration * length))
    hat, angles = reference.hat, np.zeros(len(centres)) if standing is None else standing
    whole = _place_on_hip(hat, height, mass)
    if len(centres) == 3:
        return np.concatenate([*links, _rotate(whole, -angles[2])])
    pelvis = _place_on_hip(reference.pelvis, height, mass)
    lumbar = _build_rotation(angles[2]) @ centres[3]
    trunk = _rotate(_shift(whole - pelvis, -lumbar), -angles[3])
    return np.concatenate([*links, _rotate(pelvis, -angles[2]), trunk])


_HEEL = 0.25  # distance of the ankle from the heel, as a fraction of the foot's length


def _build_winter() -> ReferenceTable:
    """Return the table of Winter (2009, 4.1), with the pelvis's radius of gyration from de Leva's lower trunk."""
    return ReferenceTable(
        "winter",
        foot=SegmentFractions(2 * 0.0145, 0.50, 0.475, 0.152),
        shank=SegmentFractions(2 * 0.0465, 1 - 0.433, 0.302, 0.246),
        thigh=SegmentFractions(2 * 0.100, 1 - 0.433, 0.323, 0.245),
        hat=SegmentFractions(0.678, 0.626, 0.496, 0.288),
        pelvis=SegmentFractions(0.142, 0.105, 0.151, 0.288),
        ankle_height=0.039,
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


def _build_de_leva(sex: Sex) -> ReferenceTable:
    """Return table 4 of de Leva (1996) for one sex; in HAT, the arms hang from the shoulders."""
    rows, stature = _DE_LEVA[sex], _STATURE[sex]
    total = sum(rows[n][0] for n in ("head", "trunk")) + 2 * sum(
        rows[n][0] for n in ("upper arm", "forearm", "hand", "thigh", "shank", "foot")
    )  # 100, except for rounding

    def build_segment(name: str, sides: int = 2, *, from_top: bool = False) -> SegmentFractions:
        mass, length, centre, gyration = rows[name]
        fraction = centre / 100 if from_top else 1 - centre / 100
        return SegmentFractions(sides * mass / total, fraction, gyration / 100, length / stature)

    lower = build_segment("lower trunk", 1)
    hat = _combine_hat(rows, sex, total)
    return ReferenceTable(
        "de-leva",
        foot=build_segment("foot", from_top=True),
        shank=build_segment("shank"),
        thigh=build_segment("thigh"),
        hat=hat,
        pelvis=SegmentFractions(
            lower.mass,
            lower.centre * lower.length / hat.length,
            lower.gyration * lower.length / hat.length,
            hat.length,
        ),
        ankle_height=0.039,  # from Winter's table: de Leva's has none
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


def _combine_hat(rows: dict[str, tuple[float, float, float, float]], sex: Sex, total: float) -> SegmentFractions:
    """Return head, arms and trunk as one segment above the hip; its length is from hip to shoulder, as in Winter."""
    tops = {"head": rows["trunk"][1] + rows["head"][1], "trunk": rows["trunk"][1], "upper arm": _SHOULDER[sex]}
    tops["forearm"] = tops["upper arm"] - rows["upper arm"][1]
    tops["hand"] = tops["forearm"] - rows["forearm"][1]
    sides = {"head": 1, "trunk": 1, "upper arm": 2, "forearm": 2, "hand": 2}
    mass = np.array([sides[n] * rows[n][0] / total for n in tops])
    centre = np.array([top - rows[n][2] / 100 * rows[n][1] for n, top in tops.items()])
    gyration = np.array([rows[n][3] / 100 * rows[n][1] for n in tops])
    whole = float(mass @ centre / mass.sum())
    radius = float(np.sqrt(mass @ (gyration**2 + (centre - whole) ** 2) / mass.sum()))
    length = _SHOULDER[sex]
    return SegmentFractions(float(mass.sum()), whole / length, radius / length, length / _STATURE[sex])


def _average(a: SegmentFractions, b: SegmentFractions) -> SegmentFractions:
    return SegmentFractions(*((getattr(a, f) + getattr(b, f)) / 2 for f in ("mass", "centre", "gyration", "length")))


def _compute_moments(mass: float, centre: FloatArray, gyration: float) -> FloatArray:
    """Return m, mx, my, Izz about the frame's origin from mass, centre of mass (2,) and radius of gyration."""
    return np.array([mass, *(mass * centre), mass * (gyration**2 + float(centre @ centre))])


def _place_on_hip(fractions: SegmentFractions, height: float, mass: float) -> FloatArray:
    """Return the parameters of an upright segment above the hip, for a body of this height and mass."""
    length = fractions.length * height
    centre = np.array([0.0, fractions.centre * length])
    return _compute_moments(fractions.mass * mass, centre, fractions.gyration * length)


def _build_rotation(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _rotate(parameters: FloatArray, angle: float) -> FloatArray:
    """Return the parameters of a body after a rotation about the origin."""
    return np.array([parameters[0], *(_build_rotation(angle) @ parameters[1:3]), parameters[3]])


def _shift(parameters: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the parameters of a body after a translation (2,), m."""
    mass, first = parameters[0], parameters[1:3]
    moved = first + mass * shift
    inertia = parameters[3] + 2 * float(first @ shift) + mass * float(shift @ shift)
    return np.array([mass, *moved, inertia])
