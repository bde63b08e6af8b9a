"""Configuration of a chain for workspaces without a recording: joints with axes and limits, and a tip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from mocap_id.arrays import FloatArray
from mocap_id.config.parsing import parse, raise_mistakes
from mocap_id.config.source import Source, read
from mocap_id.stages.base import Settings

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class _Joint(Settings):
    name: str = Field(min_length=1, max_length=60, description="name of the joint")
    axis: Literal["x", "y", "z"] | tuple[float, float, float] = Field(
        "z", description="axis of rotation in the frame of the previous link, with all joints at 0"
    )
    at: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="position in the frame of the previous joint, m"
    )
    limits_deg: tuple[float, float] = Field(description="smallest and largest angle, degrees")


class _File(Settings):
    chain: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the chain")
    joints: tuple[_Joint, ...] = Field(min_length=1, max_length=12, description="joints from the base to the tip")
    tip: tuple[float, float, float] = Field(description="end point in the frame of the last joint, m")


@dataclass(frozen=True)
class ChainFile:
    """A chain of n hinges."""

    name: str
    joints: tuple[str, ...]  # names
    axes: FloatArray  # (n, 3) unit axes, each in the frame of the previous link
    places: FloatArray  # (n, 3) positions, each in the frame of the previous joint, m
    limits: FloatArray  # (n, 2) smallest and largest angle, rad
    tip: FloatArray  # (3,) position in the frame of the last link, m

    @property
    def planar(self) -> bool:
        """Whether all joints rotate about z, so that the workspace is an area."""
        return bool(np.all(self.axes == _AXES["z"]))


def is_chain(file: Path) -> bool:
    """Return whether a YAML file describes a chain, not a trial; ConfigError if it is missing or not YAML."""
    data = read(file.absolute()).data
    return isinstance(data, dict) and "chain" in data and "recording" not in data


def load_chain(file: Path) -> ChainFile:
    """Read and check a chain's YAML file.

    Raises ConfigError with one line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    parsed = parse(source, _File, "keys such as `chain:`, `joints:` and `tip:`")
    raise_mistakes(_joint_mistakes(parsed, source))
    axes = [np.array(_AXES[joint.axis] if isinstance(joint.axis, str) else joint.axis) for joint in parsed.joints]
    return ChainFile(
        name=parsed.chain,
        joints=tuple(joint.name for joint in parsed.joints),
        axes=np.array([axis / float(np.linalg.norm(axis)) for axis in axes]),
        places=np.array([joint.at for joint in parsed.joints]),
        limits=np.array([np.radians(joint.limits_deg) for joint in parsed.joints]),
        tip=np.array(parsed.tip),
    )


def _joint_mistakes(parsed: _File, source: Source) -> Iterator[str]:
    """Yield a message for every joint whose axis is zero or whose limits are in the wrong order."""
    for index, joint in enumerate(parsed.joints):
        if joint.axis == (0.0, 0.0, 0.0):
            where = source.where(("joints", index, "axis"))
            yield f"{where}: the axis of the joint `{joint.name}` is zero: expected a direction"
        low, high = joint.limits_deg
        if low >= high:
            where = source.where(("joints", index, "limits_deg"))
            yield f"{where}: the first limit, {low:g}°, is not below the second, {high:g}°"
