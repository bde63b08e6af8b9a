"""The YAML file of a prescription: a body, a person's strength, joints for springs, and postures to hold."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from mocap_id.config.parsing import Location, Source, parse, raise_mistakes, read_source
from mocap_id.config.trial import make_absolute
from mocap_id.stages.base import Settings

_MAX_JOINTS = 3
_Pair = tuple[float, float]


class Arm(Settings):
    """One joint with a weight on a lever (thesis figure 7.5), which hangs down at angle 0."""

    mass_kg: float = Field(gt=0, lt=1000, description="mass on the lever, kg")
    lever_m: float = Field(gt=0, lt=10, description="distance of the mass from the joint, m")
    inertia_kgm2: float | None = Field(
        None,
        gt=0,
        description="moment of inertia about the joint, for level sets, kg·m²; default: that of a point mass",
    )


class Segment(Settings):
    """A segment of a planar chain and the joint that moves it; if all angles are 0, every y axis points up."""

    name: str = Field(min_length=1, max_length=60, description="name of its joint")
    at_m: _Pair = Field((0.0, 0.0), description="the joint, in the frame of the previous segment, m")
    mass_kg: float = Field(gt=0, lt=1000, description="kg")
    centre_m: _Pair = Field(description="centre of mass in the segment's own frame, m")


class JointWish(Settings):
    """Limits of a joint and of the person's strength."""

    limits_deg: _Pair | None = Field(None, description="smallest and largest angle; default: range in the trial")
    strength_Nm: _Pair | None = Field(None, description="smallest and largest torque of the person, N·m")  # noqa: N815
    strength_share: float | _Pair | None = Field(
        None, description="strength as a share of the largest moment of gravity about the joint: 0.2, or [-0.2, 0.5]"
    )


class SpringWish(Settings):
    """Joints that a spring may cross, and limits of the spring."""

    joints: tuple[int, ...] = Field((1,), min_length=1, max_length=2, description="joints that it crosses, from 1")
    stiffest: float | None = Field(None, gt=0, description="largest stiffness, N·m/rad")
    rest_deg: _Pair = Field((-360.0, 360.0), description="smallest and largest rest angle, as the sum over its joints")
    device: Path | None = Field(None, description="YAML file of a pneumatic device that is the spring (docs/assist.md)")


class GivenSpring(Settings):
    """An existing spring."""

    stiffness: float = Field(ge=0, description="N·m/rad")
    rest_deg: float = Field(description="rest angle")
    damping: float = Field(0.0, ge=0, description="damping of a parallel damper, N·m·s/rad")


class LevelSet(Settings):
    """Settings of the reachable set of one joint over time."""

    horizons_s: tuple[float, ...] = Field((1.0, 2.0, 3.0, 4.0), min_length=1, description="times, ascending, s")
    angles: int = Field(121, ge=21, le=2001, description="number of grid nodes over the angle")
    velocities: int = Field(121, ge=21, le=2001, description="number of grid nodes over the velocity")
    order: Literal[1, 2] = Field(2, description="order of accuracy in space and time")
    scheme: Literal["upwind", "lax-friedrichs"] = Field("upwind", description="numerical Hamiltonian")
    spring: GivenSpring | None = Field(None, description="spring to use instead of the prescribed one")


class SearchGrid(Settings):
    """Grid of springs, each evaluated by its level set (thesis figure 7.9)."""

    stiffness_mNm_per_deg: tuple[float, float, float] = Field((5, 100, 5), description="first, last, step, mN·m/deg")  # noqa: N815
    rest_deg: tuple[float, float, float] = Field((180, 360, 10), description="first, last, step")
    horizon_s: float = Field(2.0, gt=0, description="s")
    angles: int = Field(101, ge=21, le=501, description="number of grid nodes over the angle")
    velocities: int = Field(101, ge=21, le=501, description="number of grid nodes over the velocity")


class Task(Settings):
    """A task of the person, whose postures must all be held."""

    name: str = Field(pattern=r"^\w[\w .+-]*$", max_length=60, description="name, such as feeding or drinking")
    group: str | None = Field(None, description="tasks of one group share a sub-workspace; default: a group of its own")
    angles_deg: _Pair | None = Field(None, description="for one joint: smallest and largest angle")
    box_m: tuple[_Pair, _Pair] | None = Field(
        None, description="for several joints: two corners of a box for the tip, plane frame, m"
    )
    point_m: _Pair | None = Field(None, description="or a point for the tip, m")


class ControllerRules(Settings):
    """Rules of the controller that changes the device's pressures between tasks, and of the tour that tests it."""

    margin_deg: float = Field(
        2.0, gt=0, description="the pressures change at this distance from the end of a sub-workspace"
    )
    hysteresis_deg: float = Field(3.0, gt=0, description="movement before the pressures may change back")
    speed_deg_s: float = Field(60.0, gt=0, le=1000, description="largest speed of the tour")
    hold_s: float = Field(1.0, ge=0, le=60, description="time for which the ends of a task are held, s")
    tremor_deg: float = Field(0.2, ge=0, le=10, description="for one joint: amplitude of the person's tremor, at 5 Hz")


class PrescriptionFile(Settings):
    """Keys of a prescription's file."""

    prescription: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the prescription")
    arm: Arm | None = Field(None, description="one joint with a weight")
    chain: tuple[Segment, ...] | None = Field(
        None, min_length=1, max_length=_MAX_JOINTS, description="or a planar chain, from the base to the tip"
    )
    trial: Path | None = Field(None, description="or a trial with identified dynamics: YAML file or run folder")
    tip: str | None = Field(
        None, description="marker of the trial's last segment that is the tip; default: the farthest"
    )
    tip_m: _Pair | None = Field(None, description="the chain's tip, in the last segment's frame, m")
    joints: tuple[JointWish, ...] = Field(
        min_length=1, max_length=_MAX_JOINTS, description="joints from the base to the tip"
    )
    springs: tuple[SpringWish, ...] | None = Field(
        None, max_length=_MAX_JOINTS, description="springs that may be used; default: one on every joint"
    )
    required_deg: tuple[float, ...] = Field((), description="for one joint: angles that must be held")
    required_m: tuple[_Pair, ...] = Field((), description="for several joints: points at which the tip must be held, m")
    penalty: float = Field(1e-4, ge=0, description="cost of stiffness: δ of eq. 7.10")
    gravity: float = Field(9.81, gt=0, description="m/s²")
    level_set: LevelSet | None = Field(None, description="for one joint: the reachable set over time")
    search: SearchGrid | None = Field(None, description="for one joint: a map of springs by level sets")
    tasks: tuple[Task, ...] = Field((), max_length=50, description="tasks for a graph of sub-workspaces")
    controller: ControllerRules | None = Field(None, description="with a device and tasks: simulate the controller")
    postures: int = Field(4096, ge=256, le=1 << 17, description="for several joints: number of sampled postures")
    boxes: int = Field(20_000, ge=1, description="for several joints: largest number of boxes of springs in the search")
    seed: int = Field(0, ge=0, description="seed of the sampled postures")


@dataclass(frozen=True)
class PrescriptionConfig:
    """The checked configuration of a prescription, and its source for messages."""

    wishes: PrescriptionFile
    source: Source

    def where(self, *location: str | int) -> str:
        """Return ``FILE, line N`` of a key."""
        return self.source.where(tuple(location))


def load_prescription(file: Path) -> PrescriptionConfig:
    """Read and check a prescription's YAML file.

    Raises ConfigError with one line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read_source(file.absolute())
    parsed = parse(source, PrescriptionFile, "keys such as `prescription:`, `arm:` and `joints:`", _fill_empty_sections)
    raise_mistakes(_find_mistakes(parsed, source))
    return PrescriptionConfig(make_absolute(parsed, source.file.parent), source)


def _fill_empty_sections(data: dict[str, Any]) -> dict[str, Any]:
    """Replace empty sections by empty mappings."""
    return {
        key: {} if value is None and key in ("level_set", "search", "controller") else value
        for key, value in data.items()
    }


def _find_mistakes(wishes: PrescriptionFile, source: Source) -> list[str]:
    """Return a line for every contradiction between keys."""
    bodies = [name for name in ("arm", "chain", "trial") if getattr(wishes, name) is not None]
    mistakes = []
    if len(bodies) != 1:
        found = f"`{'` and `'.join(bodies)}` are given" if bodies else "no body is given"
        mistakes.append(f"{source.where(())}: {found}: expected one of `arm:`, `chain:` and `trial:`")
    if wishes.chain is not None and wishes.tip_m is None:
        mistakes.append(
            f"{source.where(('chain',))}: `tip_m` is missing (the chain's tip in the frame of its last segment, m)"
        )
    count = 1 if wishes.arm is not None else len(wishes.chain) if wishes.chain is not None else None
    if count is not None and len(wishes.joints) != count:
        mistakes.append(f"{source.where(('joints',))}: {len(wishes.joints)} joints are given, the body has {count}")
    for index, joint in enumerate(wishes.joints):
        mistakes += _joint_mistakes(joint, index, wishes.trial is not None, source)
    for index, spring in enumerate(wishes.springs or ()):
        where = source.where(("springs", index))
        if not all(1 <= joint <= len(wishes.joints) for joint in spring.joints):
            mistakes.append(f"{where}: a spring may cross joints 1 to {len(wishes.joints)}, not {list(spring.joints)}")
        if spring.rest_deg[0] > spring.rest_deg[1]:
            mistakes.append(
                f"{where}: the first rest angle, {spring.rest_deg[0]:g}°, is above the second, {spring.rest_deg[1]:g}°"
            )
    one = len(wishes.joints) == 1
    for key, given, several in (
        ("required_deg", wishes.required_deg, False),
        ("required_m", wishes.required_m, True),
        ("level_set", wishes.level_set, False),
        ("search", wishes.search, False),
    ):
        if given and one == several:
            use = "several joints" if several else "one joint"
            mistakes.append(f"{source.where((key,))}: `{key}` is for {use}, and {len(wishes.joints)} are given")
    if wishes.controller is not None and not (wishes.tasks and any(spring.device for spring in wishes.springs or ())):
        mistakes.append(f"{source.where(('controller',))}: `controller` needs `tasks:` and a spring with a `device:`")
    for index, task in enumerate(wishes.tasks):
        mistakes += _task_mistakes(task, index, one, source)
    return mistakes


def _joint_mistakes(joint: JointWish, index: int, observed: bool, source: Source) -> list[str]:
    place: Location = ("joints", index)
    mistakes = []
    if joint.limits_deg is None and not observed:
        mistakes.append(
            f"{source.where(place)}: `limits_deg` of joint {index + 1} is missing: without a trial there is no default"
        )
    if joint.limits_deg is not None and joint.limits_deg[0] >= joint.limits_deg[1]:
        low, high = joint.limits_deg
        where = source.where((*place, "limits_deg"))
        mistakes.append(f"{where}: the lower limit of joint {index + 1}, {low:g}°, is not below the upper, {high:g}°")
    if (joint.strength_Nm is None) == (joint.strength_share is None):
        mistakes.append(f"{source.where(place)}: give one of `strength_Nm` and `strength_share` for joint {index + 1}")
        return mistakes
    given = joint.strength_Nm if joint.strength_Nm is not None else joint.strength_share
    low, high = given if isinstance(given, tuple) else (-float(given or 0.0), float(given or 0.0))
    if low >= high:
        where = source.where(place)
        mistakes.append(f"{where}: the lower strength of joint {index + 1}, {low:g}, is not below the upper, {high:g}")
    return mistakes


def _task_mistakes(task: Task, index: int, one: bool, source: Source) -> list[str]:
    where = source.where(("tasks", index))
    given = [key for key in ("angles_deg", "box_m", "point_m") if getattr(task, key) is not None]
    fitting = ["angles_deg"] if one else ["box_m", "point_m"]
    if len(given) != 1 or given[0] not in fitting:
        return [f"{where}: the task `{task.name}` needs {' or '.join(f'`{key}`' for key in fitting)}"]
    if task.angles_deg is not None and task.angles_deg[0] > task.angles_deg[1]:
        return [f"{where}: the first angle of the task `{task.name}` is above the second"]
    return []
