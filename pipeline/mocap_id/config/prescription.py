"""What `mocap-id prescribe` reads: a body, a person's strength, where springs may be, and what they are to do."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from mocap_id.config.explain import explain
from mocap_id.config.source import Location, Source, read
from mocap_id.config.trial import absolute
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Settings

_MAX_JOINTS = 3
_Pair = tuple[float, float]


class Arm(Settings):
    """One joint with a weight on a lever (thesis figure 7.5); it hangs down at angle 0."""

    mass_kg: float = Field(gt=0, lt=1000, description="mass that hangs on the joint, kg")
    lever_m: float = Field(gt=0, lt=10, description="its distance from the joint, m")
    inertia_kgm2: float | None = Field(
        None, gt=0, description="about the joint, for level sets, kg·m²; default: that of the mass at its lever"
    )


class Segment(Settings):
    """A segment of a planar chain, with the joint that moves it; all angles 0: every y axis points up."""

    name: str = Field(min_length=1, max_length=60, description="what its joint is called")
    at_m: _Pair = Field((0.0, 0.0), description="the joint, in the frame of the segment before, m")
    mass_kg: float = Field(gt=0, lt=1000, description="kg")
    centre_m: _Pair = Field(description="centre of mass in the segment's own frame, m")


class JointWish(Settings):
    """What one joint may do, and what the person can."""

    limits_deg: _Pair | None = Field(None, description="smallest and largest angle; default: those of the trial")
    strength_Nm: _Pair | None = Field(None, description="least and largest torque of the person, N·m")  # noqa: N815
    strength_share: float | _Pair | None = Field(
        None, description="the same by the largest moment of gravity about the joint: 0.2, or [-0.2, 0.5]"
    )


class SpringWish(Settings):
    """Where a spring may be."""

    joints: tuple[int, ...] = Field((1,), min_length=1, max_length=2, description="joints it goes across, from 1")
    stiffest: float | None = Field(None, gt=0, description="largest stiffness, N·m/rad")
    rest_deg: _Pair = Field((-360.0, 360.0), description="allowed rest angles of the sum of its joints")


class GivenSpring(Settings):
    """A spring that is there already."""

    stiffness: float = Field(ge=0, description="N·m/rad")
    rest_deg: float = Field(description="rest angle")
    damping: float = Field(0.0, ge=0, description="of a damper beside it, N·m·s/rad")


class LevelSet(Settings):
    """The reachable set over time, of one joint."""

    horizons_s: tuple[float, ...] = Field((1.0, 2.0, 3.0, 4.0), min_length=1, description="times, ascending, s")
    angles: int = Field(121, ge=21, le=2001, description="nodes over the angle")
    velocities: int = Field(121, ge=21, le=2001, description="nodes over the velocity")
    order: Literal[1, 2] = Field(2, description="of accuracy, in space and time")
    scheme: Literal["upwind", "lax-friedrichs"] = Field("upwind", description="numerical Hamiltonian")
    spring: GivenSpring | None = Field(None, description="instead of the one that is prescribed")


class SearchGrid(Settings):
    """All springs of a grid by their level sets (thesis figure 7.9)."""

    stiffness_mNm_per_deg: tuple[float, float, float] = Field((5, 100, 5), description="first, last, step, mN·m/deg")  # noqa: N815
    rest_deg: tuple[float, float, float] = Field((180, 360, 10), description="first, last, step")
    horizon_s: float = Field(2.0, gt=0, description="s")
    angles: int = Field(101, ge=21, le=501, description="nodes over the angle")
    velocities: int = Field(101, ge=21, le=501, description="nodes over the velocity")


class Task(Settings):
    """Something that the person wants to do: everything in it has to be held."""

    name: str = Field(pattern=r"^\w[\w .+-]*$", max_length=60, description="feeding, drinking …")
    group: str | None = Field(None, description="tasks of one group share a sub-workspace; default: its own")
    angles_deg: _Pair | None = Field(None, description="of one joint: smallest and largest angle")
    box_m: tuple[_Pair, _Pair] | None = Field(None, description="two corners of a box for the tip, plane frame, m")
    point_m: _Pair | None = Field(None, description="or a point for it")


class PrescriptionFile(Settings):
    """A prescription."""

    prescription: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="its name")
    arm: Arm | None = Field(None, description="one joint with a weight")
    chain: tuple[Segment, ...] | None = Field(
        None, min_length=1, max_length=_MAX_JOINTS, description="or a planar chain, from the base to the tip"
    )
    trial: Path | None = Field(None, description="or a trial with identified dynamics: YAML file or run folder")
    tip: str | None = Field(None, description="marker of the trial's last segment that reaches; default: the farthest")
    tip_m: _Pair | None = Field(None, description="the chain's tip, in the last segment's frame, m")
    joints: tuple[JointWish, ...] = Field(min_length=1, max_length=_MAX_JOINTS, description="from the base to the tip")
    springs: tuple[SpringWish, ...] | None = Field(
        None, max_length=_MAX_JOINTS, description="where springs may be; default: one on every joint"
    )
    required_deg: tuple[float, ...] = Field((), description="of one joint: angles that must be held")
    required_m: tuple[_Pair, ...] = Field((), description="of several: points that the tip must be held at, m")
    penalty: float = Field(1e-4, ge=0, description="what stiffness costs: δ of eq. 7.10")
    gravity: float = Field(9.81, gt=0, description="m/s²")
    level_set: LevelSet | None = Field(None, description="the reachable set over time, of one joint")
    search: SearchGrid | None = Field(None, description="a map of springs by level sets, of one joint")
    tasks: tuple[Task, ...] = Field((), max_length=50, description="tasks to make a graph of sub-workspaces from")
    postures: int = Field(4096, ge=256, le=1 << 17, description="of several joints: postures that are sampled")
    boxes: int = Field(20_000, ge=1, description="of several joints: boxes of springs looked at before the search ends")
    seed: int = Field(0, ge=0, description="of the sampled postures")


@dataclass(frozen=True)
class PrescriptionConfig:
    """A checked configuration and where it stands, for messages."""

    wishes: PrescriptionFile
    source: Source

    def where(self, *location: str | int) -> str:
        """``FILE, line N`` of a key."""
        return self.source.where(tuple(location))


def load_prescription(file: Path) -> PrescriptionConfig:
    """Read and check a prescription's YAML file.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    if not isinstance(source.data, dict):
        raise ConfigError(f"{source.where(())}: expected keys such as `prescription:`, `arm:` and `joints:`")
    data = {
        key: {} if value is None and key in ("level_set", "search") else value for key, value in source.data.items()
    }
    try:
        parsed = PrescriptionFile.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        raise ConfigError(explain(error, PrescriptionFile, source)) from error
    wrong = _contradictions(parsed, source)
    if wrong:
        raise ConfigError("\n".join(wrong))
    return PrescriptionConfig(absolute(parsed, source.file.parent), source)


def prescription_schema() -> dict[str, Any]:
    """JSON Schema of a prescription's YAML file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **PrescriptionFile.model_json_schema()}


def _contradictions(wishes: PrescriptionFile, source: Source) -> list[str]:
    """What no single key shows."""
    bodies = [name for name in ("arm", "chain", "trial") if getattr(wishes, name) is not None]
    wrong = []
    if len(bodies) != 1:
        told = f"`{'` and `'.join(bodies)}` are given" if bodies else "no body is given"
        wrong.append(f"{source.where(())}: {told}: expected one of `arm:`, `chain:` and `trial:`")
    if wishes.chain is not None and wishes.tip_m is None:
        wrong.append(f"{source.where(('chain',))}: `tip_m` is missing: where the chain's tip is, in its last frame, m")
    count = 1 if wishes.arm is not None else len(wishes.chain) if wishes.chain is not None else None
    if count is not None and len(wishes.joints) != count:
        wrong.append(f"{source.where(('joints',))}: {len(wishes.joints)} joints are described, the body has {count}")
    for index, joint in enumerate(wishes.joints):
        wrong += _joint(joint, index, wishes.trial is not None, source)
    for index, spring in enumerate(wishes.springs or ()):
        where = source.where(("springs", index))
        if not all(1 <= joint <= len(wishes.joints) for joint in spring.joints):
            wrong.append(f"{where}: a spring goes across joints 1 to {len(wishes.joints)}, not {list(spring.joints)}")
        if spring.rest_deg[0] > spring.rest_deg[1]:
            wrong.append(
                f"{where}: the rest angles are crossed: {spring.rest_deg[0]:g}° is above {spring.rest_deg[1]:g}°"
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
            wrong.append(f"{source.where((key,))}: `{key}` is for {use}, and {len(wishes.joints)} are described")
    for index, task in enumerate(wishes.tasks):
        wrong += _task(task, index, one, source)
    return wrong


def _joint(joint: JointWish, index: int, observed: bool, source: Source) -> list[str]:
    place: Location = ("joints", index)
    wrong = []
    if joint.limits_deg is None and not observed:
        wrong.append(f"{source.where(place)}: `limits_deg` of joint {index + 1} is missing: no recording shows them")
    if joint.limits_deg is not None and joint.limits_deg[0] >= joint.limits_deg[1]:
        low, high = joint.limits_deg
        where = source.where((*place, "limits_deg"))
        wrong.append(f"{where}: the limits of joint {index + 1} are crossed: {low:g}° is not below {high:g}°")
    if (joint.strength_Nm is None) == (joint.strength_share is None):
        wrong.append(f"{source.where(place)}: give one of `strength_Nm` and `strength_share` for joint {index + 1}")
        return wrong
    given = joint.strength_Nm if joint.strength_Nm is not None else joint.strength_share
    low, high = given if isinstance(given, tuple) else (-float(given or 0.0), float(given or 0.0))
    if low >= high:
        where = source.where(place)
        wrong.append(f"{where}: the strength of joint {index + 1} is crossed: {low:g} is not below {high:g}")
    return wrong


def _task(task: Task, index: int, one: bool, source: Source) -> list[str]:
    where = source.where(("tasks", index))
    given = [key for key in ("angles_deg", "box_m", "point_m") if getattr(task, key) is not None]
    fitting = ["angles_deg"] if one else ["box_m", "point_m"]
    if len(given) != 1 or given[0] not in fitting:
        return [f"{where}: the task `{task.name}` needs {' or '.join(f'`{key}`' for key in fitting)}"]
    if task.angles_deg is not None and task.angles_deg[0] > task.angles_deg[1]:
        return [f"{where}: the angles of the task `{task.name}` are crossed"]
    return []
