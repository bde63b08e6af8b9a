"""Simulated bodies and their markers: a person with Winter's proportions, a one-joint robot, and the thesis's UR5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.anatomy.frames import draw_skin_motion
from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import spatial_inertia
from mocap_id_simulation.options import JointName, MarkerSetName, SimulatedSubject, Speed

WINTER: Mapping[str, float] = {
    "h_ankle": 0.039,
    "l_foot": 0.152,
    "l_shank": 0.246,
    "l_thigh": 0.245,
    "l_hat": 0.288,
    "m_foot": 0.029,
    "m_shank": 0.093,
    "m_thigh": 0.200,
    "m_hat": 0.678,
    "c_shank": 0.567,
    "c_thigh": 0.567,
    "c_hat": 0.626,
    "r_foot": 0.475,
    "r_shank": 0.302,
    "r_thigh": 0.323,
    "r_hat": 0.496,
}
"""Winter's fractions for both legs together: lengths and ankle height are fractions of stature, masses of body mass.
Centres of mass (from the lower joint) and radii of gyration (about these) are fractions of the segment's length."""

BEHIND_ANKLE = 0.24  # fraction of the foot's length behind the ankle
ANKLE = (-0.03, 0.03)  # m, range of the ankle's position from the plate's centre


@dataclass(frozen=True)
class Link:
    """One rigid segment, described in its own coordinate frame, with +y towards the next joint."""

    name: str
    joint: str | None  # joint at its origin; None for the base
    centre: tuple[float, float]  # centre of that joint in the previous link's frame, m
    length: float  # m
    mass: float  # kg
    com: tuple[float, float]  # centre of mass, m
    inertia: float  # moment of inertia about the centre of mass, kg·m²

    @property
    def about_origin(self) -> float:
        """Moment of inertia about the link's origin, kg·m²."""
        return self.inertia + self.mass * (self.com[0] ** 2 + self.com[1] ** 2)

    @property
    def inertial_parameters(self) -> dict[str, float]:
        """Inertial parameters by name, as in truth.json."""
        (cx, cy), m = self.com, self.mass
        return {"m": m, "mx": m * cx, "my": m * cy, "Izz": self.about_origin, "cx": cx, "cy": cy, "Ic": self.inertia}


@dataclass(frozen=True)
class SimulatedBody:
    """A chain of links on a base that stands on the ground."""

    links: tuple[Link, ...]  # base first
    support: tuple[float, float]  # extent of the base along x, m; the centre of pressure must stay inside
    scored_lengths: Mapping[str, float]  # lengths that marker data determine, by their names in summary.json, m
    description: Mapping[str, Any]  # entries of truth.json about the subject, as JSON values

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return sum(link.mass for link in self.links)

    @property
    def centres(self) -> FloatArray:
        """(n, 2) joint centres, each in the previous link's frame, m."""
        return np.array([link.centre for link in self.links[1:]])

    @property
    def coms(self) -> FloatArray:
        """(n + 1, 2) centres of mass in the links' frames, m."""
        return np.array([link.com for link in self.links])

    @property
    def masses(self) -> FloatArray:
        """(n + 1,) masses, kg."""
        return np.array([link.mass for link in self.links])

    @property
    def inertias(self) -> FloatArray:
        """(n + 1, 6, 6) spatial inertia matrices of the links."""
        about = np.zeros((len(self.links), 3, 3))
        about[:, 2, 2] = [link.inertia for link in self.links]
        return spatial_inertia(self.masses, np.column_stack([self.coms, np.zeros(len(self.links))]), about)

    def base_parameters(self) -> tuple[list[str], list[float]]:
        """Return names and values of the base parameters that determine the contact wrench of the chain (eq. 6.1)."""
        names, values = ["sum m"], [self.mass]
        for i, link in enumerate(self.links):
            beyond = sum(other.mass for other in self.links[i + 1 :])
            x, y = self.links[i + 1].centre if beyond else (0.0, 0.0)
            tail = f" + p{i + 2}{{}}*sum m{i + 2}.." if beyond else ""
            names.append(f"mx{i + 1}" + tail.format("x"))
            values.append(link.mass * link.com[0] + x * beyond)
            if i > 0:
                square = f" + |p{i + 2}|^2*sum m{i + 2}.." if beyond else ""
                names += [f"my{i + 1}" + tail.format("y"), f"I{i + 1}" + square]
                values += [link.mass * link.com[1] + y * beyond, link.about_origin + (x**2 + y**2) * beyond]
        return names, values


def draw_person(
    rng: np.random.Generator, subject: SimulatedSubject | None = None, feet: np.random.Generator | None = None
) -> SimulatedBody:
    """Draw a person who stands on both feet and faces -x: foot, shank, thigh, and one segment for head, arms and trunk.

    Each fraction of :data:`WINTER` varies by up to 10 %, and the mass fractions still sum to one. Height and mass are
    those of ``subject``, if given. The generator ``feet``, if given, draws the position of the feet in this trial.
    """
    used = {name: value * rng.uniform(0.9, 1.1) for name, value in WINTER.items()}
    names = [name for name in WINTER if name.startswith("m_")]
    share = np.array([WINTER[name] for name in names])
    off = rng.uniform(-0.1, 0.1, len(names))
    off -= share @ off  # keep the sum of the masses
    off *= min(1.0, 0.1 / np.abs(off).max())
    used |= dict(zip(names, (share * (1 + off)).tolist(), strict=True))
    height, mass = rng.uniform(1.55, 1.9), rng.uniform(52.0, 92.0)
    ankle_x = rng.uniform(*ANKLE)
    if subject is not None:
        height, mass = subject.height, subject.mass
    ankle = (ankle_x if feet is None else feet.uniform(*ANKLE), used["h_ankle"] * height)
    length = {name: used[f"l_{name}"] * height for name in ("foot", "shank", "thigh", "hat")}
    foot = length["foot"]
    heel, toe = ankle[0] + BEHIND_ANKLE * foot, ankle[0] - (1 - BEHIND_ANKLE) * foot
    base_com = ((heel + toe) / 2, ankle[1] / 2)
    shares = {name: used[f"m_{name}"] * mass for name in ("foot", "shank", "thigh", "hat")}
    radii = {name: used[f"r_{name}"] * length[name] for name in length}
    links = [Link("foot", None, (0, 0), foot, shares["foot"], base_com, shares["foot"] * radii["foot"] ** 2)]
    centre = ankle
    for name, label, joint in (("shank", "shank", "ankle"), ("thigh", "thigh", "knee"), ("hat", "torso", "hip")):
        com = (rng.uniform(-0.012, 0.012), used[f"c_{name}"] * length[name])
        links.append(Link(label, joint, centre, length[name], shares[name], com, shares[name] * radii[name] ** 2))
        centre = (0.0, length[name])
    description = {
        "height_m": height,
        "mass_kg": mass,
        "fractions_used": used,
        "winter_fractions": dict(WINTER),
        "ankle_x_m": ankle[0],
        "ankle_height_m": ankle[1],
        "heel_x_m": heel,
        "toe_x_m": toe,
    }
    scored = {"shank": length["shank"], "thigh": length["thigh"]}
    return SimulatedBody(tuple(links), (toe, heel), scored, {"subject": description})


def draw_robot(rng: np.random.Generator) -> SimulatedBody:
    """Draw a robot with one revolute joint that is fixed to the plate; its dimensions and masses vary by up to 10 %."""
    off = rng.uniform(0.9, 1.1, 7)
    base_mass, mass = 21.0 * off[0], 5.2 * off[1]
    reach, length = 0.52 * off[2], 0.50 * off[3]
    base = Link("base", None, (0, 0), reach, base_mass, (0.0, 0.26 * off[4]), 0.11 * off[4])
    arm = Link("link", "joint", (0.0, reach), length, mass, (rng.uniform(-0.01, 0.01), 0.36 * off[5]), 0.07 * off[6])
    return SimulatedBody((base, arm), (-0.2, 0.2), {"l1": reach}, {})


# --- the thesis's robot (ch. 5): a UR5 on a bracket, stretched upwards, with one swinging joint
#
# The parameters come from the reference rows of table 5.2 (Kufieta's model), the distances from ch. 5.3.2. The motion
# is that of ch. 5.2: five periods of amplitude pi/4 at 0.25 or 0.5 Hz. The moving mass, which the table does not list,
# is the sum of the manufacturer's link masses. The fixed base has the remaining mass.

TOTAL = 26.633  # kg
AMPLITUDE = np.pi / 4
FREQUENCY: Mapping[Speed, float] = {"slow": 0.25, "fast": 0.5}  # Hz
LEAD = 1.0  # s of rest before and after the motion


REFERENCE: Mapping[JointName, tuple[float, float, float, float]] = {
    "shoulder": (0.101, 13.2939, 5.540, 3.760),
    "elbow": (0.526, 4.9009, 1.760, 0.700),
    "wrist": (0.918, 2.6259, 0.110, 0.010),
}
"""Distance of each joint from the plate's centre, m, and of the part distal to it the mass, kg, the first moment, kg·m,
and the moment of inertia, kg·m², both about the joint."""

_UR5_SITES = (
    ("BAS1", 0.060, 0.045, 0.065),
    ("BAS2", -0.055, 0.060, 0.070),
    ("BAS3", 0.005, 0.080, -0.080),
    ("UPA1", 0.050, 0.165, 0.110),
    ("UPA2", -0.050, 0.225, 0.120),
    ("UPA3", 0.048, 0.290, 0.095),
    ("UPA4", -0.046, 0.355, 0.115),
    ("UPA5", 0.044, 0.420, 0.125),
    ("UPA6", -0.052, 0.480, 0.105),
    ("FOA1", 0.045, 0.580, 0.050),
    ("FOA2", -0.040, 0.650, 0.060),
    ("FOA3", 0.038, 0.720, 0.020),
    ("FOA4", -0.042, 0.790, 0.065),
    ("FOA5", 0.036, 0.860, 0.035),
    ("WRI1", 0.050, 0.955, 0.045),
    ("WRI2", -0.048, 0.985, 0.055),
    ("WRI3", 0.040, 1.015, 0.025),
    ("WRI4", -0.034, 1.040, 0.070),
)
"""Eighteen markers: label, x, height above the plate and depth, m, while the arm is stretched upwards."""


def ur5_body(joint: JointName, speed: Speed) -> SimulatedBody:
    """Return the thesis's robot with all joints locked except one."""
    distance, mass, moment, inertia = REFERENCE[joint]
    com = moment / mass
    base = Link("base", None, (0, 0), distance, TOTAL - mass, (0.0, distance / 2), 0.1)
    arm = Link(
        "link",
        joint,
        (0.0, distance),
        _UR5_SITES[-1][2] - distance,
        mass,
        (0.0, com),
        inertia - moment * com,
    )
    description = {
        "joint": joint,
        "speed": speed,
        "table_5_2_reference": {
            "m1_plus_m2": TOTAL,
            "mx1_Txm2": 0.0,
            "mx2": 0.0,
            "my2": moment,
            "Izz2": inertia,
        },
    }
    return SimulatedBody((base, arm), (-0.2, 0.2), {"l1": distance}, description)


# --- markers

PLACEMENT = 0.006  # m, standard deviation of a marker's placement


@dataclass(frozen=True)
class MarkerSet:
    """M markers in the coordinate frames of their links."""

    labels: tuple[str, ...]
    link: IntArray  # (M,) link of each marker; 0 is the base
    local: FloatArray  # (M, 3) x, y in the link's frame and distance z from the body's mid-plane, m
    softness: FloatArray  # (M,) largest displacement by skin motion, m
    hidden: BoolArray  # (M,) whether the cameras may lose sight of the marker
    on_plate: BoolArray  # (M,) whether the marker is on the plate
    at_joint: tuple[str | None, ...]  # joint whose axis passes through the marker; None for other markers


@dataclass(frozen=True)
class _Site:
    """Nominal position of a marker: y in link lengths, x and z in m."""

    name: str
    link: int
    x: float
    y: float
    z: float
    soft_mm: float
    paired: bool = True  # whether both sides of the body have this marker
    hidden: bool = False
    at_joint: str | None = None


_PERSON = (
    _Site("FHD", 3, -0.080, 1.74, 0.070, 1.0, hidden=True),
    _Site("BHD", 3, 0.070, 1.70, 0.070, 1.0, hidden=True),
    _Site("C7", 3, 0.065, 1.17, 0.0, 2.0, paired=False, hidden=True),
    _Site("T10", 3, 0.100, 0.72, 0.0, 3.0, paired=False, hidden=True),
    _Site("CLAV", 3, -0.075, 1.02, 0.0, 2.0, paired=False, hidden=True),
    _Site("STRN", 3, -0.110, 0.74, 0.0, 3.0, paired=False, hidden=True),
    _Site("RBAK", 3, 0.095, 0.95, -0.080, 3.0, paired=False, hidden=True),
    _Site("SHO", 3, 0.0, 1.07, 0.185, 3.0, hidden=True),
    _Site("UPA", 3, -0.050, 0.86, 0.220, 3.0, hidden=True),
    _Site("ELB", 3, -0.110, 0.62, 0.230, 3.0, hidden=True),
    _Site("FRM", 3, -0.190, 0.63, 0.180, 3.0, hidden=True),
    _Site("WRA", 3, -0.250, 0.70, 0.100, 3.0, hidden=True),
    _Site("WRB", 3, -0.225, 0.63, 0.095, 3.0, hidden=True),
    _Site("FIN", 3, -0.265, 0.74, 0.030, 2.0, hidden=True),
    _Site("ASI", 3, -0.090, 0.17, 0.125, 4.0, hidden=True),
    _Site("THI", 2, -0.065, 0.38, 0.155, 4.0),
    _Site("THI2", 2, -0.055, 0.70, 0.185, 4.0),
    _Site("THI3", 2, 0.010, 0.54, 0.205, 4.0),
    _Site("TIB", 1, -0.035, 0.76, 0.115, 2.0),
    _Site("TIB2", 1, -0.022, 0.44, 0.125, 2.0),
    _Site("TIB3", 1, 0.020, 0.62, 0.140, 2.0),
    _Site("ANK", 1, 0.0, 0.0, 0.150, 1.0, at_joint="ankle"),
    _Site("HEE", 0, 0.11, 0.20, 0.120, 0.3),
    _Site("TOE", 0, -0.14, 0.16, 0.135, 0.3),
)

_ROBOT = (
    _Site("BAS1", 0, 0.060, 0.10, 0.065, 0.0, paired=False),
    _Site("BAS2", 0, -0.055, 0.12, 0.070, 0.0, paired=False),
    _Site("BAS3", 0, 0.005, 0.14, -0.080, 0.0, paired=False),
    _Site("UPA1", 0, 0.050, 0.28, 0.110, 0.0, paired=False),
    _Site("UPA2", 0, -0.050, 0.40, 0.120, 0.0, paired=False),
    _Site("UPA3", 0, 0.048, 0.52, 0.095, 0.0, paired=False),
    _Site("UPA4", 0, -0.046, 0.65, 0.115, 0.0, paired=False),
    _Site("UPA5", 0, 0.044, 0.79, 0.125, 0.0, paired=False),
    _Site("UPA6", 0, -0.052, 0.90, 0.105, 0.0, paired=False),
    _Site("FOA1", 1, 0.045, 0.10, 0.050, 0.0, paired=False, hidden=True),
    _Site("FOA2", 1, -0.040, 0.24, 0.060, 0.0, paired=False, hidden=True),
    _Site("FOA3", 1, 0.038, 0.37, 0.020, 0.0, paired=False, hidden=True),
    _Site("FOA4", 1, -0.042, 0.49, 0.065, 0.0, paired=False, hidden=True),
    _Site("FOA5", 1, 0.036, 0.61, 0.035, 0.0, paired=False, hidden=True),
    _Site("WRI1", 1, 0.050, 0.78, 0.045, 0.0, paired=False, hidden=True),
    _Site("WRI2", 1, -0.048, 0.85, 0.055, 0.0, paired=False, hidden=True),
    _Site("WRI3", 1, 0.040, 0.92, 0.025, 0.0, paired=False, hidden=True),
    _Site("WRI4", 1, -0.034, 0.98, 0.070, 0.0, paired=False, hidden=True),
)

_ALSO_CONVENTIONAL = ("C7", "T10", "CLAV", "STRN", "SHO", "ASI")
_CONVENTIONAL = (
    *(site for site in _PERSON if site.name in _ALSO_CONVENTIONAL),
    _Site("PSI", 3, 0.100, 0.20, 0.050, 3.0, hidden=True),
    _Site("THI", 2, -0.020, 0.45, 0.170, 4.0),
    _Site("KNE", 2, 0.0, 0.0, 0.140, 4.0, at_joint="knee"),
    _Site("TIB", 1, -0.020, 0.50, 0.130, 2.0),
    _Site("ANK", 1, 0.0, 0.0, 0.130, 1.0, at_joint="ankle"),
    _Site("HEE", 0, 0.09, 0.55, 0.100, 0.3),
    _Site("TOE", 0, -0.14, 0.50, 0.130, 0.3),
)
_WANDS = ("THI", "TIB")
_JOINTS = ("HEE", "TOE", "ANK", "KNE", "ASI", "SHO")
MARKER_SETS: Mapping[MarkerSetName, tuple[_Site, ...]] = {
    "clusters": _PERSON,
    "plug-in-gait": _CONVENTIONAL,
    "plug-in-gait-without-wands": tuple(site for site in _CONVENTIONAL if site.name not in _WANDS),
    "joints": tuple(site for site in _CONVENTIONAL if site.name in _JOINTS),
}
"""Nominal positions of each marker set of a person."""

PLATE = ((-0.28, -0.18), (-0.24, 0.20), (-0.06, 0.24), (0.05, -0.22), (0.19, 0.18), (0.27, -0.14), (0.23, 0.02))


def place_body_markers(
    rng: np.random.Generator,
    body: SimulatedBody,
    name: MarkerSetName = "clusters",
    without: str = "",
    joint: JointName | None = None,
) -> MarkerSet:
    """Place the body's markers with random placement errors; the set ``clusters`` adds seven markers on the plate.

    ``name`` is the marker set of a person; a robot has a fixed one, and the thesis's robot with the moving ``joint``
    eighteen markers. ``without`` lists markers to leave out, separated by commas: on both sides (``KNE``), on one side
    (``LKNE``), or all of one side (``R*``).
    """
    if joint is not None:
        distance, count = REFERENCE[joint][0], len(_UR5_SITES)
        link = np.array([height > distance for _, _, height, _ in _UR5_SITES]).astype(np.int64)
        local = np.array([(x, height - distance * (height > distance), z) for _, x, height, z in _UR5_SITES])
        labels = tuple(label for label, *_ in _UR5_SITES)
        softness, at_joint = np.zeros(count), (None,) * count
        return add_plate_markers(rng, labels, link, local, softness=softness, hidden=link > 0, at_joint=at_joint)
    person = len(body.links) > 2
    left_out = {each.strip() for each in without.split(",")}
    sites: list[_Site] = []
    for site in MARKER_SETS[name] if person else _ROBOT:
        # both sides of the body; left is +z, because the person faces -x
        pair = replace(site, name=f"L{site.name}"), replace(site, name=f"R{site.name}", z=-site.z)
        for one in pair if site.paired else (site,):
            side = f"{one.name[0]}*" if site.paired else site.name
            sites += [] if {site.name, one.name, side} & left_out else [one]
    ankle = body.links[1].centre[0]  # for the base, x of a site is measured from the first joint
    nominal = [(s.x + ankle if s.link == 0 else s.x, s.y * body.links[s.link].length, s.z) for s in sites]
    return add_plate_markers(
        rng,
        tuple(site.name for site in sites),
        np.array([site.link for site in sites]),
        np.array(nominal),
        softness=np.array([site.soft_mm for site in sites]) / 1e3,
        hidden=np.array([site.hidden for site in sites]),
        at_joint=tuple(site.at_joint for site in sites),
        plate=PLATE if name == "clusters" else (),
    )


def add_plate_markers(
    rng: np.random.Generator,
    labels: tuple[str, ...],
    link: IntArray,
    local: FloatArray,
    *,
    softness: FloatArray,
    hidden: BoolArray,
    at_joint: tuple[str | None, ...],
    plate: Sequence[tuple[float, float]] = PLATE,
) -> MarkerSet:
    """Return a marker set with further markers at ``plate`` (x, z), m, and random placement errors of all markers.

    The other parameters are the fields of :class:`MarkerSet` without the markers on the plate.
    """
    count = len(plate)
    on_plate = np.arange(len(labels) + count) >= len(labels)
    local = np.concatenate([local, np.array([(x, 0.004, z) for x, z in plate]).reshape(-1, 3)])
    local += rng.normal(0, PLACEMENT, local.shape) * np.where(on_plate[:, None], (1.0, 0.1, 1.0), 1.0)
    return MarkerSet(
        labels=(*labels, *(f"PLT{i + 1}" for i in range(count))),
        link=np.concatenate([link, np.zeros(count, dtype=np.int64)]),
        local=local,
        softness=np.concatenate([softness, np.zeros(count)]),
        hidden=np.concatenate([hidden, np.zeros(count, dtype=np.bool_)]),
        on_plate=on_plate,
        at_joint=at_joint + (None,) * count,
    )


MIDDLE = np.array([0.35, -1.12, 1.10])  # rad, mid-range of ankle, knee and hip in sit-to-stands


def draw_subject_skin_motion(
    rng: np.random.Generator, wander: np.random.Generator, markers: MarkerSet, q: FloatArray, time: FloatArray
) -> tuple[FloatArray, MarkerSet]:
    """Return the displacement (T, M, 3) of a subject's markers, m, and the markers at their mean positions.

    The slide is the same function of the angles in all trials of the person; the drift differs. The mean displacement
    over the trial is added to the markers' positions instead. Parameters as for :func:`draw_skin_motion`.
    """
    moved = draw_skin_motion(rng, markers.link, markers.softness, q, time, wander=wander, middle=MIDDLE)
    mean = moved.mean(axis=0)
    return moved - mean, replace(markers, local=markers.local + mean)
