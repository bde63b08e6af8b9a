"""Markers on a simulated body and on the plate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.simulation.body import SimulatedBody

MarkerSetName: TypeAlias = Literal["clusters", "plug-in-gait", "plug-in-gait-without-wands", "joints"]
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


def place_markers(
    rng: np.random.Generator, body: SimulatedBody, name: MarkerSetName = "clusters", without: str = ""
) -> MarkerSet:
    """Place the body's markers with random placement errors; the set ``clusters`` adds seven markers on the plate.

    ``name`` is the marker set of a person; a robot has a fixed one. ``without`` lists markers to leave out, separated
    by commas: on both sides (``KNE``), on one side (``LKNE``), or all of one side (``R*``).
    """
    person = len(body.links) > 2
    left_out = {each.strip() for each in without.split(",")}
    sites = tuple(
        one
        for site in (MARKER_SETS[name] if person else _ROBOT)
        for one in _sides(site)
        if not {site.name, one.name, f"{one.name[0]}*" if site.paired else site.name} & left_out
    )
    return add_plate_markers(
        rng,
        tuple(site.name for site in sites),
        np.array([site.link for site in sites]),
        np.array([_local_position(body, site) for site in sites]),
        softness=np.array([site.soft_mm for site in sites]) / 1e3,
        hidden=np.array([site.hidden for site in sites]),
        at_joint=tuple(site.at_joint for site in sites),
        plate=PLATE if name == "clusters" else (),
    )


def fix_knee_to_shank(markers: MarkerSet, body: SimulatedBody) -> MarkerSet:
    """Return the markers after fixing the knee markers to the shank."""
    at_knee = np.array([joint == "knee" for joint in markers.at_joint])
    local = markers.local.copy()
    local[at_knee, :2] += body.links[2].centre
    return replace(markers, link=markers.link - at_knee, local=local)


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


def _sides(site: _Site) -> tuple[_Site, ...]:
    """Return the left and right marker of a site, or its only marker; left is +z, because the person faces -x."""
    if not site.paired:
        return (site,)
    return replace(site, name=f"L{site.name}"), replace(site, name=f"R{site.name}", z=-site.z)


def _local_position(body: SimulatedBody, site: _Site) -> tuple[float, float, float]:
    """Return the position in the link's frame, m; for the base, x of the site is measured from the first joint."""
    link = body.links[site.link]
    start = body.links[1].centre[0] if site.link == 0 else 0.0
    return start + site.x, site.y * link.length, site.z
