"""Markers on a simulated arm: palpated landmarks and clusters, and the soft tissue under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.body import FOREARM, HAND, THORAX, UPPER_ARM, ArmBody
from mocap_id.simulation.arm.options import Difficulty
from mocap_id.simulation.arm.rotations import Y
from mocap_id.simulation.markers import MarkerSet
from mocap_id.simulation.skin import draw_skin_motion

_LANDMARK_SLIDE = {"IJ": 1.0, "PX": 1.5, "C7": 1.5, "T8": 1.5, "AC": 4.0, "EL": 3.0, "EM": 4.0, "US": 1.0, "RS": 1.0}
_LANDMARK_LOSS = {"EL": 0.05, "EM": 0.05, "US": 0.08, "RS": 0.03}
_CHEST = ((30.0, -65.0, 60.0), (25.0, -65.0, -60.0), (45.0, -145.0, 50.0), (42.0, -142.0, -50.0))
_HAND = ((-15.0, -49.0, -20.0), (-25.0, -53.0, 24.0), (-20.0, -93.0, -1.0))
_UPPER = ((44.0, 17.0), (21.0, 43.0), (-10.0, 47.0), (-34.0, 33.0))
_FORE = ((36.0, 0.0), (29.0, 21.0), (14.0, 33.0), (-5.0, 35.0))
_UPPER_SHARES = np.linspace(0.3, 0.8, 4)
_FORE_SHARES = np.linspace(0.25, 0.8, 4)
JITTER = 0.003  # m


@dataclass(frozen=True)
class ArmMarkers:
    """M markers in the coordinate frames of their segments at the start."""

    labels: tuple[str, ...]  # names in the file
    names: tuple[str, ...]  # names of the landmarks and cluster markers, also if the recording is anonymous
    segment: IntArray  # (M,)
    local: FloatArray  # (M, 3) m
    slide: FloatArray  # (M,) size of the displacement by sliding skin, m
    twist_loss: FloatArray  # (M,) fraction of the segment's axial rotation that the skin does not follow
    on_glide: BoolArray  # (M,) whether a marker of the thorax moves with the shoulder girdle


def draw_markers(rng: np.random.Generator, body: ArmBody, sizes: Difficulty, anonymous: bool) -> ArmMarkers:
    """Place 24 markers: nine landmarks with palpation errors, and clusters on every segment."""
    names, segment, local, slide, loss = [], [], [], [], []
    for name, millimetres in _LANDMARK_SLIDE.items():
        part, bone = body.landmarks[name]
        names.append(name)
        segment.append(part)
        local.append(bone + rng.normal(0, 1, 3) * sizes.palpation)
        slide.append(millimetres)
        loss.append(_LANDMARK_LOSS.get(name, 0.0))
    upper, fore = rng.permutation(_UPPER_SHARES), rng.permutation(_FORE_SHARES)
    upper_sites = [(x, -1e3 * share * body.upper_arm, z) for (x, z), share in zip(_UPPER, upper, strict=True)]
    fore_sites = [(x, -1e3 * share * body.forearm, z) for (x, z), share in zip(_FORE, fore, strict=True)]
    for prefix, part, sites, slides, losses in (
        ("THX", THORAX, _CHEST, [1.5] * 4, [0.0] * 4),
        ("UPA", UPPER_ARM, upper_sites, rng.uniform(3.0, 10.0, 4), 0.6 * (0.8 - 0.6 * upper)),
        ("FOR", FOREARM, fore_sites, rng.uniform(1.5, 4, 4), 0.55 * (1 - 0.9 * fore)),
        ("HND", HAND, _HAND, [1.1] * 3, [0.0] * 3),
    ):
        names += [f"{prefix}{i + 1}" for i in range(len(sites))]
        segment += [part] * len(sites)
        local += list(np.array(sites) / 1e3 + rng.normal(0, JITTER, (len(sites), 3)))
        slide += list(slides)
        loss += list(losses)
    landmarks = len(_LANDMARK_SLIDE)
    labels = names[:landmarks] + [f"M{i:03d}" for i in range(len(names) - landmarks)] if anonymous else names
    return ArmMarkers(
        labels=tuple(labels),
        names=tuple(names),
        segment=np.array(segment),
        local=np.array(local),
        slide=np.array(slide) / 1e3 * sizes.soft_tissue,
        twist_loss=np.array(loss) * sizes.twist_loss,
        on_glide=np.array([name == "AC" for name in names]),
    )


def marker_set(labels: tuple[str, ...], segment: IntArray, local: FloatArray, softness: FloatArray) -> MarkerSet:
    """Return the markers for the models of cameras and skin; the cameras may lose sight of every marker."""
    every = np.ones(len(labels), dtype=np.bool_)
    return MarkerSet(labels, segment, local, softness, every, ~every, (None,) * len(labels))


def draw_slide(
    rng: np.random.Generator, wander: np.random.Generator, markers: ArmMarkers, angles: FloatArray, time: FloatArray
) -> FloatArray:
    """Return the displacement (F, M, 3) by sliding skin in the segments' frames, m; it is zero in the first frame.

    ``rng`` and ``wander`` are the generators of the slide and of a slow drift. ``angles`` (F, 4) are elevation, elbow
    flexion, pronation and wrist flexion, rad. The skin of a segment slides with the two angles next to the segment.
    """
    soft = marker_set(markers.labels, markers.segment, markers.local, markers.slide)
    moved = draw_skin_motion(rng, soft, angles, time, wander=wander, middle=angles[0])
    return np.asarray(moved - moved[0])


def axial_displacement(markers: ArmMarkers, axial: FloatArray) -> FloatArray:
    """Return the displacement (F, M, 3), m, because skin follows only a part of ``axial`` (F, 4) rotations, rad."""
    angle = -markers.twist_loss * (axial - axial[0])[:, markers.segment]
    rotated: FloatArray = np.einsum("fmij,mj->fmi", so3.exp(angle[..., None] * Y), markers.local)
    return rotated - markers.local
