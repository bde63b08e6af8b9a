"""Simulated bodies: a person with Winter's proportions, varied by up to 10 %, and a one-joint robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import spatial_inertia

GRAVITY = 9.81  # m/s²

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

Sex: TypeAlias = Literal["female", "male"]
_SEXES: tuple[Sex, ...] = ("female", "male")
_HEIGHT = {"female": (1.52, 1.76), "male": (1.64, 1.92)}  # m
_BODY_MASS_INDEX = (19.0, 29.0)  # kg/m²


@dataclass(frozen=True)
class Subject:
    """A person who performs several trials with the same body, markers and skin."""

    name: str
    seed: int  # seed of the body's proportions, the markers' positions and the sliding of the skin
    sex: Sex
    height: float  # m
    mass: float  # kg


def draw_subject(seed: int, number: int) -> Subject:
    """Draw person ``number`` of a cohort, counted from 1; odd numbers are female. The cohort's size has no effect."""
    source = np.random.SeedSequence([seed, number])
    rng = np.random.default_rng(source)
    sex = _SEXES[(number - 1) % len(_SEXES)]
    height = float(rng.uniform(*_HEIGHT[sex]))
    mass = float(rng.uniform(*_BODY_MASS_INDEX)) * height**2
    return Subject(f"s{number:02d}", int(source.generate_state(2)[1]), sex, height, mass)


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
    rng: np.random.Generator, subject: Subject | None = None, feet: np.random.Generator | None = None
) -> SimulatedBody:
    """Draw a person who stands on both feet and faces -x: foot, shank, thigh, and one segment for head, arms and trunk.

    Each fraction of :data:`WINTER` varies by up to 10 %, and the mass fractions still sum to one. Height and mass are
    those of ``subject``, if given. The generator ``feet``, if given, draws the position of the feet in this trial.
    """
    used = {name: value * rng.uniform(0.9, 1.1) for name, value in WINTER.items()} | _draw_mass_shares(rng)
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


def _draw_mass_shares(rng: np.random.Generator) -> dict[str, float]:
    """Return each segment's fraction of the body's mass, by its key in :data:`WINTER`."""
    names = [name for name in WINTER if name.startswith("m_")]
    share = np.array([WINTER[name] for name in names])
    off = rng.uniform(-0.1, 0.1, len(names))
    off -= share @ off  # keep the sum of the masses
    off *= min(1.0, 0.1 / np.abs(off).max())
    return dict(zip(names, (share * (1 + off)).tolist(), strict=True))


def draw_robot(rng: np.random.Generator) -> SimulatedBody:
    """Draw a robot with one revolute joint that is fixed to the plate; its dimensions and masses vary by up to 10 %."""
    off = rng.uniform(0.9, 1.1, 7)
    base_mass, mass = 21.0 * off[0], 5.2 * off[1]
    reach, length = 0.52 * off[2], 0.50 * off[3]
    base = Link("base", None, (0, 0), reach, base_mass, (0.0, 0.26 * off[4]), 0.11 * off[4])
    arm = Link("link", "joint", (0.0, reach), length, mass, (rng.uniform(-0.01, 0.01), 0.36 * off[5]), 0.07 * off[6])
    return SimulatedBody((base, arm), (-0.2, 0.2), {"l1": reach}, {})
