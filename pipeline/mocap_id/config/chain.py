"""Configuration of a chain (joints with axes and limits, and a tip), for workspaces without a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from mocap_id.arrays import FloatArray
from mocap_id.config.parsing import parse
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
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
    """A chain of revolute joints, n of them.

    Parameters
    ----------
    name : str
    joints : tuple of str
    axes : (n, 3) array
        Each in the frame of the previous link.
    places : (n, 3) array
        Positions in the frame of the previous link, m.
    limits : (n, 2) array
        Lower and upper, rad.
    tip : (3,) array
        In the frame of the last link, m.
    """

    name: str
    joints: tuple[str, ...]
    axes: FloatArray
    places: FloatArray
    limits: FloatArray
    tip: FloatArray

    @property
    def planar(self) -> bool:
        """Whether all joints turn about z, so that the workspace is an area."""
        return bool(np.all(self.axes == _AXES["z"]))


def is_chain(file: Path) -> bool:
    """Return whether a YAML file describes a chain, not a trial.

    Raises
    ------
    ConfigError
        The file is missing or not YAML.
    """
    data = read(file.absolute()).data
    return isinstance(data, dict) and "chain" in data and "recording" not in data


def load_chain(file: Path) -> ChainFile:
    """Read and check a chain's YAML file.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    parsed = parse(source, _File, "keys such as `chain:`, `joints:` and `tip:`")
    axes = np.array([_axis(joint, index, source) for index, joint in enumerate(parsed.joints)])
    limits = np.array([_limits(joint.limits_deg, index, source) for index, joint in enumerate(parsed.joints)])
    return ChainFile(
        name=parsed.chain,
        joints=tuple(joint.name for joint in parsed.joints),
        axes=axes,
        places=np.array([joint.at for joint in parsed.joints]),
        limits=limits,
        tip=np.array(parsed.tip),
    )


def _axis(joint: _Joint, index: int, source: Source) -> FloatArray:
    axis = np.array(_AXES[joint.axis] if isinstance(joint.axis, str) else joint.axis)
    length = float(np.linalg.norm(axis))
    if length == 0:
        where = source.where(("joints", index, "axis"))
        raise ConfigError(f"{where}: the axis of the joint `{joint.name}` is zero: expected a direction")
    return np.asarray(axis / length)


def _limits(limits: tuple[float, float], index: int, source: Source) -> FloatArray:
    low, high = limits
    if low >= high:
        where = source.where(("joints", index, "limits_deg"))
        raise ConfigError(f"{where}: the first limit, {low:g}°, is not below the second, {high:g}°")
    return np.radians([low, high])
