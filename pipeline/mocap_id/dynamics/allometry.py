"""Reference bodies from height, mass and sex: the tables of Winter (2009) and de Leva (1996).

The tables give fractions of body mass and of segment length; both legs are one segment here. A chain starts at the
ground, so a leg's segment begins at its lower joint; centres of mass, which the tables give from the upper joint, are
converted. Head, arms and trunk are one rigid segment, HAT. If the chain has a joint within the trunk, HAT is divided
into the pelvis and the rest so that both together, upright, are the table's HAT.
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
    """One segment of a reference table, as fractions.

    Parameters
    ----------
    mass : float
        Mass of both sides together, as a fraction of body mass.
    centre : float
        Distance of the centre of mass from the lower end (of the foot: from the heel), as a fraction of the length.
    gyration : float
        Radius of gyration about the transverse axis through the centre of mass, as a fraction of the length.
    length : float
        Length as a fraction of body height.
    """

    mass: float
    centre: float
    gyration: float
    length: float


@dataclass(frozen=True)
class ReferenceTable:
    """A table of a reference body.

    Parameters
    ----------
    name : str
    foot, shank, thigh, hat, pelvis : SegmentFractions
        ``pelvis`` is the part of ``hat`` below a joint within the trunk.
    ankle_height : float
        As a fraction of body height.
    """

    name: str
    foot: SegmentFractions
    shank: SegmentFractions
    thigh: SegmentFractions
    hat: SegmentFractions
    pelvis: SegmentFractions
    ankle_height: float


def reference_table(name: TableName, sex: Sex | None) -> ReferenceTable:
    """Return the reference table of this name.

    Parameters
    ----------
    name : {"winter", "de-leva"}
    sex : {"female", "male"} or None
        Used for de Leva's table only; None gives the mean of both sexes.
    """
    if name == "winter":
        return _winter()
    if sex is not None:
        return _de_leva(sex)
    female, male = _de_leva("female"), _de_leva("male")
    return ReferenceTable(
        "de-leva",
        foot=_mean(female.foot, male.foot),
        shank=_mean(female.shank, male.shank),
        thigh=_mean(female.thigh, male.thigh),
        hat=_mean(female.hat, male.hat),
        pelvis=_mean(female.pelvis, male.pelvis),
        ankle_height=(female.ankle_height + male.ankle_height) / 2,
    )


def height_from_legs(reference: ReferenceTable, shank: float, thigh: float) -> float:
    """Estimate the stature, m, from the lengths of shank and thigh, m."""
    return (shank + thigh) / (reference.shank.length + reference.thigh.length)


def full_parameters(
    reference: ReferenceTable,
    centres: FloatArray,
    height: float,
    mass: float,
    facing: int,
    *,
    standing: FloatArray | None = None,
) -> FloatArray:
    """Return the full planar parameters of a foot-shank-thigh-torso or foot-shank-thigh-pelvis-trunk chain.

    The lengths of shank, thigh and pelvis are those of the chain; those of foot and HAT follow from the height. The
    foot is flat on the ground, with a quarter of its length behind the ankle. HAT is upright while the person stands;
    the frame of the last segment follows its markers, which need not lie above the hip.

    Parameters
    ----------
    reference : ReferenceTable
    centres : (3, 2) or (4, 2) array
        Centre of each joint in the frame of the segment before it, m; segment frames have +Y towards the next joint.
    height, mass : float
        m, kg.
    facing : {-1, 1}
        Sign of the plane frame's x in front of the subject.
    standing : (n,) array, optional
        Angle of each segment's frame, without the base, in the plane frame while the person stands, rad; by default the
        frames from the hip on are upright.

    Returns
    -------
    (16,) or (20,) array
        m, mx, my, Izz of every segment about its frame's origin, base first.
    """
    if len(centres) not in (3, 4):
        raise ValueError(f"a reference body has 3 or 4 joints; this chain has {len(centres)}")
    foot_length = reference.foot.length * height
    heel = centres[0, 0] - facing * _HEEL * foot_length
    foot_centre = np.array([heel + facing * reference.foot.centre * foot_length, reference.ankle_height * height / 2])
    links = [_point_form(reference.foot.mass * mass, foot_centre, reference.foot.gyration * foot_length)]
    for link, end in ((reference.shank, centres[1]), (reference.thigh, centres[2])):
        length = float(np.linalg.norm(end))
        links.append(_point_form(link.mass * mass, link.centre * end, link.gyration * length))
    hat, angles = reference.hat, np.zeros(len(centres)) if standing is None else standing
    whole = _on_the_hip(hat.mass * mass, hat.centre, hat.gyration, hat.length * height)
    if len(centres) == 3:
        return np.concatenate([*links, _turned(whole, -angles[2])])
    lower = reference.pelvis
    pelvis = _on_the_hip(lower.mass * mass, lower.centre, lower.gyration, lower.length * height)
    lumbar = _turn(angles[2]) @ centres[3]
    return np.concatenate([*links, _turned(pelvis, -angles[2]), _turned(_shifted(whole - pelvis, -lumbar), -angles[3])])


_HEEL = 0.25  # of the foot's length: how far the ankle is in front of the heel


def _winter() -> ReferenceTable:
    """Return the table of Winter (2009, 4.1); the pelvis's radius of gyration is that of de Leva's lower trunk."""
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
_STATURE: dict[Sex, float] = {"female": 1735.0, "male": 1741.0}  # mm, of the people measured
_SHOULDER: dict[Sex, float] = {"female": 497.9, "male": 515.5}  # mm, mid-shoulder above mid-hip


def _de_leva(sex: Sex) -> ReferenceTable:
    """Return table 4 of de Leva (1996); in HAT, the arms hang from the shoulders."""
    rows, stature = _DE_LEVA[sex], _STATURE[sex]
    total = sum(rows[n][0] for n in ("head", "trunk")) + 2 * sum(
        rows[n][0] for n in ("upper arm", "forearm", "hand", "thigh", "shank", "foot")
    )  # 100 to rounding

    def link(name: str, sides: int = 2, *, from_top: bool = False) -> SegmentFractions:
        mass, length, centre, gyration = rows[name]
        fraction = centre / 100 if from_top else 1 - centre / 100
        return SegmentFractions(sides * mass / total, fraction, gyration / 100, length / stature)

    lower = link("lower trunk", 1)
    hat = _hat(rows, sex, total)
    return ReferenceTable(
        "de-leva",
        foot=link("foot", from_top=True),
        shank=link("shank"),
        thigh=link("thigh"),
        hat=hat,
        pelvis=SegmentFractions(
            lower.mass,
            lower.centre * lower.length / hat.length,
            lower.gyration * lower.length / hat.length,
            hat.length,
        ),
        ankle_height=0.039,  # Winter's: the table has none
    )


def arm_segment(name: Literal["forearm", "hand"], sex: Sex | None) -> SegmentFractions:
    """Return one forearm or hand of de Leva's table; the centre is measured from the upper end.

    Without a sex it is the mean of both.

    Examples
    --------
    >>> round(arm_segment("forearm", "male").mass, 4)
    0.0162
    """
    found = []
    for each in ("female", "male") if sex is None else (sex,):
        mass, length, centre, gyration = _DE_LEVA[each][name]
        found.append(SegmentFractions(mass / 100, centre / 100, gyration / 100, length / _STATURE[each]))
    return found[0] if len(found) == 1 else _mean(*found)


def _hat(rows: dict[str, tuple[float, float, float, float]], sex: Sex, total: float) -> SegmentFractions:
    """Return head, arms and trunk as one body above the hip, as long as from hip to shoulder (Winter's table)."""
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


def _mean(a: SegmentFractions, b: SegmentFractions) -> SegmentFractions:
    return SegmentFractions(*((getattr(a, f) + getattr(b, f)) / 2 for f in ("mass", "centre", "gyration", "length")))


def _point_form(mass: float, centre: FloatArray, gyration: float) -> FloatArray:
    """Return m, mx, my, Izz about the frame's origin from the centre of mass (2,) and the radius of gyration."""
    return np.array([mass, *(mass * centre), mass * (gyration**2 + float(centre @ centre))])


def _on_the_hip(mass: float, centre: float, gyration: float, length: float) -> FloatArray:
    """Return the parameters of a body upright above the hip; centre and radius of gyration are shares of the length."""
    return _point_form(mass, np.array([0.0, centre * length]), gyration * length)


def _turn(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _turned(parameters: FloatArray, angle: float) -> FloatArray:
    """Return the parameters of the body after a rotation about the origin."""
    return np.array([parameters[0], *(_turn(angle) @ parameters[1:3]), parameters[3]])


def _shifted(parameters: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the parameters of the body after a translation by ``shift`` (2,)."""
    mass, first = parameters[0], parameters[1:3]
    moved = first + mass * shift
    inertia = parameters[3] + 2 * float(first @ shift) + mass * float(shift @ shift)
    return np.array([mass, *moved, inertia])
