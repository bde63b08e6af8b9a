"""Reference bodies from height, mass and sex: the tables of Winter (2009) and de Leva (1996).

Both are fractions of body mass and of segment length; both legs are one segment here. A chain is read from the ground
up, so a leg's segment begins at its lower joint: centres of mass, which the tables give from the upper one, are
turned round. Head, arms and trunk are one rigid segment, HAT; where the chain has a joint within the trunk, its mass
and inertia are shared between pelvis and the rest so that the upright whole stays the table's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import FloatArray

TableName = Literal["winter", "de-leva"]
Sex = Literal["female", "male"]


@dataclass(frozen=True)
class Link:
    """One segment of a table.

    Parameters
    ----------
    mass : float
        Of the body's, both sides together.
    centre : float
        Centre of mass from the lower end, of the segment's length; the foot's from the heel.
    gyration : float
        Radius of gyration about the centre of mass and the transverse axis, of the segment's length.
    length : float
        Of the body's height.
    """

    mass: float
    centre: float
    gyration: float
    length: float


@dataclass(frozen=True)
class Table:
    """A reference body.

    Parameters
    ----------
    name : str
    foot, shank, thigh, hat, pelvis : Link
        ``pelvis`` is the part of ``hat`` below a joint within the trunk.
    ankle_height : float
        Of the body's height.
    """

    name: str
    foot: Link
    shank: Link
    thigh: Link
    hat: Link
    pelvis: Link
    ankle_height: float


def table(name: TableName, sex: Sex | None) -> Table:
    """The reference body of one table.

    Parameters
    ----------
    name : {"winter", "de-leva"}
    sex : {"female", "male"} or None
        De Leva's table depends on it; without it the mean of both is taken. Winter's does not.
    """
    if name == "winter":
        return _winter()
    if sex is not None:
        return _de_leva(sex)
    female, male = _de_leva("female"), _de_leva("male")
    return Table(
        "de-leva",
        foot=_mean(female.foot, male.foot),
        shank=_mean(female.shank, male.shank),
        thigh=_mean(female.thigh, male.thigh),
        hat=_mean(female.hat, male.hat),
        pelvis=_mean(female.pelvis, male.pelvis),
        ankle_height=(female.ankle_height + male.ankle_height) / 2,
    )


def height_from_legs(reference: Table, shank: float, thigh: float) -> float:
    """Stature, m, that the lengths of shank and thigh, m, suggest."""
    return (shank + thigh) / (reference.shank.length + reference.thigh.length)


def full_parameters(
    reference: Table,
    centres: FloatArray,
    height: float,
    mass: float,
    facing: int,
    *,
    standing: FloatArray | None = None,
) -> FloatArray:
    """Full planar parameters of a foot-shank-thigh-torso chain, or foot-shank-thigh-pelvis-trunk.

    The lengths of shank, thigh and pelvis are the chain's own; those of foot and HAT come from the height. The foot
    lies flat under the ankle, a quarter of its length behind it. HAT is upright while the person stands: the last
    segment's own frame follows its markers, which need not lie above the hip.

    Parameters
    ----------
    reference : Table
    centres : (3, 2) or (4, 2) array
        Joint centres in the segment before, m; segment frames have +Y towards the next joint.
    height, mass : float
        m, kg.
    facing : {-1, 1}
        Sign of the plane frame's x in front of the subject.
    standing : (n,) array, optional
        Angle of each segment's frame from the plane's while the person stands, base left out, rad; by default the
        frames from the hip on are taken to be upright.

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


def _winter() -> Table:
    """Winter (2009), table 4.1; his pelvis has no radius of gyration, and takes de Leva's lower trunk's."""
    return Table(
        "winter",
        foot=Link(2 * 0.0145, 0.50, 0.475, 0.152),
        shank=Link(2 * 0.0465, 1 - 0.433, 0.302, 0.246),
        thigh=Link(2 * 0.100, 1 - 0.433, 0.323, 0.245),
        hat=Link(0.678, 0.626, 0.496, 0.288),
        pelvis=Link(0.142, 0.105, 0.151, 0.288),
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


def _de_leva(sex: Sex) -> Table:
    """De Leva (1996), table 4; HAT is composed with the arms hanging from the shoulders."""
    rows, stature = _DE_LEVA[sex], _STATURE[sex]
    total = sum(rows[n][0] for n in ("head", "trunk")) + 2 * sum(
        rows[n][0] for n in ("upper arm", "forearm", "hand", "thigh", "shank", "foot")
    )  # 100 to rounding

    def link(name: str, sides: int = 2, *, from_top: bool = False) -> Link:
        mass, length, centre, gyration = rows[name]
        fraction = centre / 100 if from_top else 1 - centre / 100
        return Link(sides * mass / total, fraction, gyration / 100, length / stature)

    lower = link("lower trunk", 1)
    hat = _hat(rows, sex, total)
    return Table(
        "de-leva",
        foot=link("foot", from_top=True),
        shank=link("shank"),
        thigh=link("thigh"),
        hat=hat,
        pelvis=Link(
            lower.mass,
            lower.centre * lower.length / hat.length,
            lower.gyration * lower.length / hat.length,
            hat.length,
        ),
        ankle_height=0.039,  # Winter's: the table has none
    )


def _hat(rows: dict[str, tuple[float, float, float, float]], sex: Sex, total: float) -> Link:
    """Head, arms and trunk as one body above the hip; its length is hip to shoulder, as in Winter's table."""
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
    return Link(float(mass.sum()), whole / length, radius / length, length / _STATURE[sex])


def _mean(a: Link, b: Link) -> Link:
    return Link(*((getattr(a, f) + getattr(b, f)) / 2 for f in ("mass", "centre", "gyration", "length")))


def _point_form(mass: float, centre: FloatArray, gyration: float) -> FloatArray:
    """m, mx, my, Izz about the frame's origin of a body with this centre of mass (2,) and radius of gyration."""
    return np.array([mass, *(mass * centre), mass * (gyration**2 + float(centre @ centre))])


def _on_the_hip(mass: float, centre: float, gyration: float, length: float) -> FloatArray:
    """A body upright above the hip; centre of mass and radius of gyration as fractions of a length."""
    return _point_form(mass, np.array([0.0, centre * length]), gyration * length)


def _turn(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _turned(parameters: FloatArray, angle: float) -> FloatArray:
    """Parameters of the same body after a turn about the origin."""
    return np.array([parameters[0], *(_turn(angle) @ parameters[1:3]), parameters[3]])


def _shifted(parameters: FloatArray, shift: FloatArray) -> FloatArray:
    """Parameters of the same body after a move by ``shift`` (2,)."""
    mass, first = parameters[0], parameters[1:3]
    moved = first + mass * shift
    inertia = parameters[3] + 2 * float(first @ shift) + mass * float(shift @ shift)
    return np.array([mass, *moved, inertia])
