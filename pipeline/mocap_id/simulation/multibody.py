"""A person with separate pelvis, trunk and arms, a foot that rotates and a weight in the hands.

Without a hip gap and without rotations of foot, lumbar joint and shoulders, they equal the pinned chain of four rigid
segments exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import Chain, Revolute, se3, spatial_inertia
from mocap_id.simulation.body import Link, SimulatedBody
from mocap_id.simulation.markers import MarkerSet

LINKS = {"foot": 1, "shank": 2, "thigh": 3, "pelvis": 5, "trunk": 6, "arms": 7, "weight": 7}
"""Link of the chain to which each body belongs; link 0 (ground) and link 4 (translation in the hip) are massless."""

SLIDE = 4
TORSO = 3  # segment of the pinned chain that is divided into several bodies

# positions and lengths relative to the torso's length, masses relative to body mass (Winter: pelvis, both whole arms)
PELVIS_MASS, PELVIS_CENTRE, PELVIS_RADIUS = 0.142, 0.10, 0.18
ARMS_MASS, ARMS_CENTRE, ARMS_RADIUS = 0.100, (-0.22, 0.76), 0.26
LUMBAR, SHOULDER = 0.20, 1.00
HANDS = (-0.265, 0.74)  # m, fraction of the torso's length: position of the finger markers
WEIGHT_RADIUS = 0.05  # m, radius of gyration

ON_ARMS = ("UPA", "ELB", "FRM", "WRA", "WRB", "FIN")
ON_PELVIS = ("ASI",)


@dataclass(frozen=True)
class _CommutingJoint:
    """A joint with commuting twists: its pose is the exponential of their sum, and its motion subspace is constant."""

    along: tuple[tuple[float, ...], ...]  # the twists (vx, vy, vz, wx, wy, wz)

    @property
    def dimension(self) -> int:
        return len(self.along)

    @property
    def twists(self) -> FloatArray:
        return np.array(self.along).T

    def subspace(self, q: FloatArray) -> FloatArray:
        return np.broadcast_to(self.twists, (*q.shape[:-1], 6, self.dimension))

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        return np.zeros((*q.shape[:-1], 6, self.dimension))


@dataclass(frozen=True)
class DividedBody:
    """The separate bodies of a person.

    The frame of the foot equals the plane frame while the foot is flat. The weight is fixed to the arms.
    """

    # Foot, shank, thigh, pelvis, trunk, arms and, if present, the weight; `centre` is the origin of a part's frame in
    # the previous part.
    parts: tuple[Link, ...]
    toe: float  # position on the ground of the point about which the foot rotates, m

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(part.name for part in self.parts)

    @cached_property
    def chain(self) -> Chain:
        """Kinematic chain from the ground to the arms.

        Its coordinates are foot, ankle, knee (rad), hip gap along both axes of the thigh (m), hip, lumbar joint and
        shoulder (rad).
        """
        foot, shank, thigh, pelvis, trunk, arms = self.parts[:6]
        hinge = Revolute((0.0, 0.0, 1.0))
        slide = _CommutingJoint(((1.0, 0, 0, 0, 0, 0), (0, 1.0, 0, 0, 0, 0)))
        about_toe = _CommutingJoint(((0.0, -self.toe, 0, 0, 0, 1.0),))
        centres = [foot.centre, shank.centre, thigh.centre, pelvis.centre, (0.0, 0.0), trunk.centre, arms.centre]
        placements = se3.pose(np.eye(3), np.array([(x, y, 0.0) for x, y in centres]))
        return Chain((about_toe, hinge, hinge, slide, hinge, hinge, hinge), placements)

    @cached_property
    def inertias(self) -> FloatArray:
        """(8, 6, 6) inertia matrices of the chain's links."""
        total = np.zeros((8, 6, 6))
        for part, link, offset in zip(self.parts, self.links, self.offsets, strict=True):
            about = np.zeros((3, 3))
            about[2, 2] = part.inertia
            centre = np.array([*(offset + np.array(part.com)), 0.0])
            total[link] += spatial_inertia(np.array(part.mass), centre, about)
        return total

    @property
    def links(self) -> IntArray:
        """(B,) link of the chain to which each part belongs."""
        return np.array([LINKS[name] for name in self.names])

    @property
    def offsets(self) -> FloatArray:
        """(B, 2) origin of each part's frame in its link's frame, m; zero except for the weight."""
        return np.array([part.centre if part.name == "weight" else (0.0, 0.0) for part in self.parts])

    @property
    def in_segment(self) -> FloatArray:
        """(B, 2) origin of each part's frame in its segment of the pinned chain, without joint displacements, m."""
        origins = np.zeros((len(self.parts), 2))
        for i in range(TORSO + 1, len(self.parts)):
            origins[i] = origins[i - 1] + self.parts[i].centre
        return origins

    def part_of(self, markers: MarkerSet) -> IntArray:
        """Return the index (M,) of the part that carries each marker; -1 for the plate."""
        names = self.names
        part = np.where(markers.on_plate, -1, markers.link)
        for i, label in enumerate(markers.labels):
            if markers.link[i] == TORSO:
                site = label[1:]
                part[i] = names.index("arms" if site in ON_ARMS else "pelvis" if site in ON_PELVIS else "trunk")
        return part

    def local(self, markers: MarkerSet) -> FloatArray:
        """Return the markers' positions (M, 3) in the frames of their parts, m; in the plane frame for the plate."""
        part, local = self.part_of(markers), markers.local.copy()
        local[:, :2] -= np.where(part[:, None] >= 0, self.in_segment[part], 0.0)
        return local


def divide_body(rng: np.random.Generator, body: SimulatedBody, held_mass: float) -> tuple[DividedBody, SimulatedBody]:
    """Divide a person into bodies with masses and positions that vary by up to 10 %.

    Return the bodies, and the pinned chain with the weight of ``held_mass``, kg, in the hands.
    """
    torso = body.links[TORSO]
    length = torso.length
    off = rng.uniform(0.9, 1.1, 9)
    pelvis_com = (float(rng.uniform(-0.01, 0.01)), PELVIS_CENTRE * off[0] * length)
    arms_com = (ARMS_CENTRE[0] * off[1] * length, ARMS_CENTRE[1] * length * (1 + (off[2] - 1) / 2))
    pelvis_mass, arms_mass = PELVIS_MASS * off[3] * body.mass, ARMS_MASS * off[4] * body.mass
    pelvis = replace(torso, name="pelvis", mass=pelvis_mass, com=pelvis_com)
    pelvis = replace(pelvis, inertia=pelvis_mass * (PELVIS_RADIUS * off[5] * length) ** 2)
    arms = replace(torso, name="arms", mass=arms_mass, com=arms_com)
    arms = replace(arms, inertia=arms_mass * (ARMS_RADIUS * off[6] * length) ** 2)
    trunk = _sum_bodies("trunk", torso, [(1, torso), (-1, pelvis), (-1, arms)])
    lumbar, shoulder = (0.0, LUMBAR * off[7] * length), (0.0, SHOULDER * length)
    hands = (HANDS[0], HANDS[1] * length)
    reach = float(np.hypot(hands[0] - shoulder[0], hands[1] - shoulder[1]))
    parts = [
        *body.links[:TORSO],
        replace(pelvis, length=lumbar[1]),
        _move_frame(trunk, "lumbar", (0.0, 0.0), lumbar, length - lumbar[1]),
        _move_frame(arms, "shoulder", lumbar, shoulder, reach),
    ]
    if held_mass > 0:
        weight = Link("weight", None, hands, 0.0, held_mass, hands, held_mass * WEIGHT_RADIUS**2)
        parts.append(_move_frame(weight, None, shoulder, hands, 0.0))
        loaded = _sum_bodies("torso", torso, [(1, torso), (1, weight)])
        body = replace(body, links=(*body.links[:TORSO], loaded))
    return DividedBody(tuple(parts), body.support[0]), body


def _sum_bodies(name: str, like: Link, signed: Sequence[tuple[int, Link]]) -> Link:
    """Return the sum of rigid bodies in one frame; bodies with sign -1 are subtracted."""
    mass = sum(sign * link.mass for sign, link in signed)
    com = np.sum([sign * link.mass * np.array(link.com) for sign, link in signed], axis=0) / mass
    about = sum(sign * link.about_origin for sign, link in signed)
    return replace(
        like, name=name, mass=mass, com=(float(com[0]), float(com[1])), inertia=about - mass * float(com @ com)
    )


def _move_frame(
    link: Link, joint: str | None, before: tuple[float, float], origin: tuple[float, float], length: float
) -> Link:
    """Return a link with its frame moved to ``origin`` in the torso; the previous part's origin is at ``before``."""
    centre = (origin[0] - before[0], origin[1] - before[1])
    com = (link.com[0] - origin[0], link.com[1] - origin[1])
    return replace(link, joint=joint, centre=centre, com=com, length=length)
