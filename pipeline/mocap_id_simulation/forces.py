"""Exact state and forces of a simulated person or robot in the plane, by recursive dynamics in SE(3).

The body is the pinned chain of rigid segments, or a person with separate pelvis, trunk and arms, a foot that rotates
and a weight in the hands. Without a hip gap and without rotations of foot, lumbar joint and shoulders, the separate
bodies equal the pinned chain of four rigid segments exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mocap_id.arrays import GRAVITY, FloatArray, IntArray
from mocap_id.geometry import Chain, Revolute, inverse_dynamics, link_motion, planar, se3, spatial_inertia
from mocap_id_simulation.bodies import Link, MarkerSet, SimulatedBody
from mocap_id_simulation.options import PersonOptions
from mocap_id_simulation.sit_to_stand import (
    Chair,
    JointMotion,
    Plan,
    Schedule,
    balance_lean,
    motion_through,
    smoothstep,
)

UP = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
THIGH = 2  # the link that the chair pushes on
TRUNK = 3  # the link of the hand on the rail
HAND = (-0.30, 0.30)  # position of that hand in the trunk's frame, in front of the person, m


@dataclass(frozen=True)
class BodiesState:
    """True motion of a person's separate bodies at times (T,), in the plane frame, SI units."""

    pose: FloatArray  # (T, B, 3) position x, y of each body frame's origin, and angle of the frame
    velocity: FloatArray  # (T, B, 3) first derivative of the pose
    acceleration: FloatArray  # (T, B, 3) second derivative of the pose
    gap: FloatArray  # (T, 2) displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y
    # (T, 5) torques of ankle, knee, hip, lumbar joint and shoulder: the moment that the proximal body exerts on all
    # distal bodies, about the joint centre in the proximal body
    tau: FloatArray


@dataclass(frozen=True)
class TrueState:
    """True state and forces at times (T,), in the plane frame, SI units."""

    time: FloatArray  # (T,)
    q: FloatArray  # (T, n) joint angles
    qd: FloatArray  # (T, n) their derivatives, of order one to three
    qdd: FloatArray
    qddd: FloatArray
    seg_angle: FloatArray  # (T, n) angles of segments 1…n from the plane frame
    joint_xy: FloatArray  # (T, n, 2) joint centres
    com: FloatArray  # (T, 2) centre of mass of the whole body, including the base
    wrench_total: FloatArray  # (T, 3) Fx, Fy, tauz of ground, chair and rail together on the body
    chair_force: FloatArray  # (T, 2) force of the chair on the thigh
    chair_point: FloatArray  # (T, 2) its point of application; NaN without a chair
    wrench: FloatArray  # (T, 3) wrench of the ground alone, which the plate carries
    tau: FloatArray  # (T, n) torque of segment j - 1 on segment j
    # Separate bodies of a person who differs from the pinned chain. The angles are then those of shank, thigh and
    # trunk, and the joint centres are those in foot, shank and thigh.
    bodies: BodiesState | None = None

    @property
    def cop_x(self) -> FloatArray:
        """Centre of pressure on the ground, (T,) m."""
        return np.asarray(self.wrench[:, 2] / self.wrench[:, 1])


def compute_state(body: SimulatedBody, motion: JointMotion, chair: Chair | None, time: FloatArray) -> TrueState:
    """Return state and forces of the pinned chain at times (T,), s."""
    q, qd, qdd, qddd = motion.at(time)
    centres = body.centres
    angle, origin = planar.segment_poses(q, centres)
    loads = inverse_dynamics(planar.spatial_chain(centres), body.inertias, q, qd, qdd, base_acceleration=UP)
    total, tau = loads.base_wrench[:, [0, 1, 5]], loads.effort
    coms = planar.marker_positions(q, centres, np.arange(len(body.links)), body.coms)
    com = np.einsum("l,tlx->tx", body.masses / body.mass, coms)
    joints = origin[:, 1:], np.arange(1, len(centres) + 1)
    return _share_load(time, (q, qd, qdd, qddd), (angle, origin), joints, com, total, tau, chair)


def _share_load(  # noqa: PLR0917
    time: FloatArray,
    coordinates: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    segments: tuple[FloatArray, FloatArray],
    joints: tuple[FloatArray, IntArray],
    com: FloatArray,
    total: FloatArray,
    tau: FloatArray,
    chair: Chair | None,
) -> TrueState:
    """Return the state after dividing the wrench ``total`` (T, 3) between ground, chair and rail.

    ``coordinates`` are the angles (T, n) and their derivatives. ``segments`` are angles (T, n + 1) and origins (T, n +
    1, 2) of the chain's segments, base first; ``joints`` are the centres (T, J, 2) and, for each joint, the first
    segment distal to it (J,). The torques ``tau`` (T, J) are corrected.
    """
    (angle, origin), (centres, distal) = segments, joints
    force, point = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    ground = total
    if chair is not None:
        point = origin[:, THIGH] + planar.rotate(angle[:, THIGH], np.array(chair.point))
        vertical = chair.load(time) * total[:, 1]
        force = np.column_stack([chair.friction * vertical, vertical])
        # the plate and the joints below the point of contact do not carry the chair's part of the load
        tau = tau - np.where(distal <= THIGH, _moment(point[:, None] - centres, force), 0)
        ground = total - np.column_stack([force, _moment(point[:, None], force)])
        if chair.rail > 0:
            hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(HAND))
            on_rail = np.column_stack([np.zeros(len(time)), chair.rail_load(time) * total[:, 1]])
            tau = tau - np.where(distal <= TRUNK, _moment(hand[:, None] - centres, on_rail), 0)
            ground = ground - np.column_stack([on_rail, _moment(hand[:, None], on_rail)])
    return TrueState(
        time,
        *coordinates,
        seg_angle=angle[:, 1:],
        joint_xy=centres[:, : angle.shape[1] - 1],
        com=com,
        wrench_total=total,
        chair_force=force,
        chair_point=point,
        wrench=ground,
        tau=tau,
    )


def _moment(arm: FloatArray, force: FloatArray) -> FloatArray:
    """Return the moments about z (T, k) of forces (T, 2) with lever arms (T, k, 2)."""
    return arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]


# --- a person of several bodies

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


SEATED_KNEE, SEATED_HIP = -1.9, 2.2  # rad, typical extremes of a sit-to-stand
LEANING = 0.8  # rad, typical largest lean of the trunk
DRIFTS = ("gap x", "gap y", "lumbar", "arms")
PERIODS = (0.8, 6.0)  # s, periods of the drift's sine waves
WAVES = 5


def draw_additional_motion(
    person: np.random.Generator, trial: np.random.Generator, people: PersonOptions, schedule: Schedule, foot: float
) -> Callable[[FloatArray, FloatArray], JointMotion]:
    """Draw a person's motion in addition to the chain's angles: hip gap, bending spine, swinging arms, lifted heels.

    Return a function from evenly spaced times (T,), s, and angles (T, 3) of ankle, knee and hip, rad, to the motion of
    the divided body. The generator ``person`` draws the motion that depends on the posture, which is the same at the
    same angles in all trials; ``trial`` draws variations between repetitions, and drifts. ``foot`` is the length from
    toe to heel, m.
    """
    repetitions, shape = len(schedule.repetitions), (len(DRIFTS), WAVES)
    sink = float(person.uniform(-0.3, 0.3))  # unevenness of the torso's sinking during the rise
    periods_x, periods_y = person.uniform(1.0, 1.8, 2)  # over the rise, of the gap's oscillation
    phase_x, phase_y = person.uniform(0, 2 * np.pi, 2)
    forward = float(person.uniform(0.3, 0.5))  # amplitude of the gap along the thigh's x, as a fraction of its range
    slump = float(person.uniform(0.4, 0.6))  # fraction of the bend that depends on the knee; the rest on the lean
    swing = trial.uniform(0.75, 1.25, (repetitions, 3))  # size while rising, while sitting down, and while standing
    late = trial.uniform(-0.12, 0.12, (repetitions, 2))  # delay of the first two swings, s
    heel = trial.uniform(0.8, 1.2, repetitions)  # size of the heel's lift
    frequency = 1 / np.exp(trial.uniform(np.log(PERIODS[0]), np.log(PERIODS[1]), shape))  # Hz
    phase = trial.uniform(0, 2 * np.pi, shape)

    def move(time: FloatArray, angles: FloatArray) -> JointMotion:
        drift = {
            name: np.sin(2 * np.pi * frequency[i] * time[:, None] + phase[i]).sum(axis=1) * np.sqrt(2 / WAVES)
            for i, name in enumerate(DRIFTS)
        }  # with unit variance
        # the gap along the thigh's axes, (T, 2) m: the torso sinks and oscillates during the rise
        risen, bent = 1 - angles[:, 1] / SEATED_KNEE, angles[:, 2] / SEATED_HIP
        sinking = risen + sink * risen * (1 - risen)
        y = -0.7 * sinking + 0.1 * np.sin(2 * np.pi * periods_y * risen + phase_y)
        x = forward * np.sin(np.pi * periods_x * bent + phase_x)
        drifted = np.column_stack([0.05 * drift[name] for name in ("gap x", "gap y")])
        gap = 1e-3 * people.hip_gap_mm * (np.column_stack([x, y]) + drifted)
        # the trunk's rotation relative to the pelvis, forwards positive
        seated, lean = angles[:, 1] / SEATED_KNEE, angles.sum(axis=1) / LEANING
        bending = slump * seated + (1 - slump) * np.tanh(lean) / np.tanh(1.0)
        bend = np.radians(people.lumbar_deg) * (0.9 * bending + 0.04 * drift["lumbar"])
        # the arms swing forwards (negative) on rising and sitting down, and backwards in between; the foot rotates
        # about the toe, most between seat-off and standing
        arms, lift = 0.02 * drift["arms"], np.zeros_like(time)
        for each, (up, down, rest), (late_up, late_down), size in zip(
            schedule.repetitions, swing, late, heel, strict=True
        ):
            rise, sit = each.rise_end - each.legs_start, each.legs_end - each.sit_start
            arms -= 0.6 * up * _bump(time, (each.legs_start + each.rise_end) / 2 + late_up, 1.6 * rise)
            arms -= 0.35 * down * _bump(time, (each.sit_start + each.legs_end) / 2 + late_down, 1.6 * sit)
            standing = smoothstep((time - each.seat_off) / rise) - smoothstep((time - each.sit_start) / sit)
            arms += 0.25 * rest * standing
            length = each.rise_end - each.seat_off
            lift += size * _bump(time, each.seat_off + length / 2, 1.3 * length)
        turned = np.arcsin(1e-3 * people.heel_lift_mm / foot * lift)
        columns = [turned, angles[:, 0] - turned, angles[:, 1], gap[:, 0], gap[:, 1], angles[:, 2] - bend, bend]
        columns.append(np.radians(people.arm_swing_deg) * arms)
        return motion_through(time, np.column_stack(columns), schedule.duration)

    return move


def _bump(time: FloatArray, middle: float, width: float) -> FloatArray:
    """Return a smooth bump (T,) of height 1 around ``middle``, s, with the total duration ``width``, s."""
    step = smoothstep((time - middle) / width + 0.5)
    return 4 * step * (1 - step)


_DISTAL = np.array([1, 2, 3, 3, 4])  # first segment distal to ankle, knee, hip, lumbar joint, shoulder; 4: the arms
_ROTATING = [LINKS[name] for name in ("foot", "shank", "thigh", "pelvis", "trunk", "arms")]
ROUNDS = 30
SETTLED = 1e-7  # rad


def balance_divided(
    body: SimulatedBody, divided: DividedBody, plan: Plan, additional: Callable[[FloatArray, FloatArray], JointMotion]
) -> tuple[JointMotion, tuple[float, ...], JointMotion]:
    """Return motion and seated angles of the chain, and the bodies' motion, which balances about the plan's ``push``.

    The difference between the moments of the bodies and of the chain depends slightly on the lean. The difference and
    the lean are therefore computed in turn until the angles settle.

    NumericalError is raised if no lean of the trunk balances the body.
    """
    motion, seated = balance_lean(body, plan)
    angles = motion.at(plan.time)[0]
    for _ in range(ROUNDS):
        difference = (
            compute_divided_state(divided, additional(plan.time, angles), None, plan.time).wrench_total
            - compute_state(body, motion, None, plan.time).wrench_total
        )
        motion, seated = balance_lean(body, plan, difference[:, 2] - plan.push * difference[:, 1])
        before, angles = angles, motion.at(plan.time)[0]
        if np.abs(angles - before).max() < SETTLED:
            break
    return motion, seated, additional(plan.time, angles)


def compute_divided_state(body: DividedBody, motion: JointMotion, chair: Chair | None, time: FloatArray) -> TrueState:
    """Return state and forces of a person of several bodies at times (T,), s."""
    coordinates = motion.at(time)
    loads = inverse_dynamics(body.chain, body.inertias, *coordinates[:3], base_acceleration=UP)
    total, effort, gap = loads.base_wrench[:, [0, 1, 5]], loads.effort, coordinates[0][:, 3:5]
    fx, fy, about_pelvis = loads.joint_wrench[:, SLIDE - 1, [0, 1, 5]].T
    about_thigh = about_pelvis + gap[:, 0] * fy - gap[:, 1] * fx
    torques = np.column_stack([effort[:, 1], effort[:, 2], about_thigh, effort[:, 6], effort[:, 7]])
    pose, velocity, acceleration = _body_motion(body, *coordinates[:3])
    # the shank's angle is the sum of foot and ankle; the trunk's angle from the thigh the sum of hip and lumbar joint
    q, qd, qdd, qddd = (np.column_stack([c[:, 0] + c[:, 1], c[:, 2], c[:, 5] + c[:, 6]]) for c in coordinates)
    angle = np.cumsum(q, axis=1)
    # ankle, knee, hip, lumbar joint and shoulder in the proximal bodies
    joints = pose[:, :5, :2] + planar.rotate(pose[:, :5, 2], np.array([part.centre for part in body.parts[1:6]]))
    angles = np.column_stack([np.zeros(len(time)), angle])
    origins = np.concatenate([np.zeros((len(time), 1, 2)), joints[:, :3]], axis=1)
    masses = np.array([part.mass for part in body.parts])
    coms = pose[..., :2] + planar.rotate(pose[..., 2], np.array([part.com for part in body.parts]))
    com = np.einsum("b,tbx->tx", masses / masses.sum(), coms)
    state = _share_load(time, (q, qd, qdd, qddd), (angles, origins), (joints, _DISTAL), com, total, torques, chair)
    return replace(state, tau=state.tau[:, :3], bodies=BodiesState(pose, velocity, acceleration, gap, state.tau))


def _body_motion(
    body: DividedBody, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pose, velocity and acceleration of every body's frame, (T, B, 3) each."""
    links, chain = body.links, body.chain
    _, velocities, accelerations = link_motion(chain, q, dq, ddq, np.zeros(6))
    origin = chain.poses(q)[..., :2, 3][:, links]
    # continuous angles: cumulative sums of all rotations
    rotation = np.cumsum(q[:, [0, 1, 2, 5, 6, 7]], axis=1)
    angle = rotation[:, [_ROTATING.index(link) for link in links]]
    twist, change = velocities[:, links], accelerations[:, links]
    spin, spin_rate = twist[..., 5], change[..., 5]
    velocity = planar.rotate(angle, twist[..., :2])
    # the derivative of a body velocity lacks the contribution of the frame's rotation
    acceleration = planar.rotate(angle, change[..., :2]) + spin[..., None] * _cross_z(velocity)
    offset = planar.rotate(angle, body.offsets)
    return (
        np.concatenate([origin + offset, angle[..., None]], axis=-1),
        np.concatenate([velocity + spin[..., None] * _cross_z(offset), spin[..., None]], axis=-1),
        np.concatenate(
            [
                acceleration + spin_rate[..., None] * _cross_z(offset) - spin[..., None] ** 2 * offset,
                spin_rate[..., None],
            ],
            axis=-1,
        ),
    )


def _cross_z(vector: FloatArray) -> FloatArray:
    """Return z × vectors (..., 2)."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
