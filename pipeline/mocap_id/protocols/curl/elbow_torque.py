"""Torque about the elbow's flexion axis from the motion of forearm and hand and their inertia (thesis 8.3).

The elbow has the acceleration a. A centre of mass of the forearm, at r from the elbow, has the acceleration
a_centre = a + α × r + ω × (ω × r). With gravity g, the torque of all muscles and devices about the unit axis h is

    τ = h · Σ [ r × m (a_centre - g) + I α + ω × I ω ]        positive if it flexes
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import LowPass

_ELBOW_CUTOFF = 4.0  # Hz: the elbow rests or moves slowly


@dataclass(frozen=True)
class Mass:
    """A rigid body on forearm or hand.

    Parameters
    ----------
    mass : float
        kg.
    centre : (3,) array
        Centre of mass in the frame of its segment, m.
    inertia : (3,) array
        Moments of inertia about the axes through the centre, along those of the segment's frame, kg·m².
    relative_sd : float
        Standard deviation of the mass, as a share of it.
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray
    relative_sd: float


@dataclass(frozen=True)
class SegmentMotion:
    """Motion of one segment in the trial's frame (T samples), with the bodies that it carries.

    Parameters
    ----------
    origin : (T, 3) array
        m.
    rotation : (T, 3, 3) array
        Segment to frame.
    omega, alpha : (T, 3) arrays
        rad/s, rad/s².
    sd_alpha : (T,) array
        Standard deviation of each component of alpha, rad/s².
    bodies : sequence of Mass
    """

    origin: FloatArray
    rotation: FloatArray
    omega: FloatArray
    alpha: FloatArray
    sd_alpha: FloatArray
    bodies: Sequence[Mass]


@dataclass(frozen=True)
class ElbowTorque:
    """Torque about the elbow's axis and its standard deviation, (T,) N·m; NaN where the motion is unknown."""

    torque: FloatArray
    sd: FloatArray


def elbow_torque(
    time: FloatArray, axis: FloatArray, segments: Sequence[SegmentMotion], *, tilt: float, gravity: float = 9.81
) -> ElbowTorque:
    """Return the total torque about the elbow's axis.

    Parameters
    ----------
    time : (T,) array
        s, uniform.
    axis : (T, 3) array
        Unit axis of the elbow in the trial's frame; a positive turn about it flexes.
    segments : sequence of SegmentMotion
        Forearm, whose origin is the elbow, then the hand.
    tilt : float
        Standard deviation of the forearm's direction, rad.
    gravity : float
        m/s², along -y.
    """
    rate = (len(time) - 1) / (time[-1] - time[0])
    elbow = segments[0].origin
    down = np.array([0.0, -gravity, 0.0])
    whole, held, variance = np.zeros(len(time)), np.zeros(len(time)), np.zeros(len(time))
    carried = _acceleration(elbow, rate)
    for place, motion in enumerate(segments):
        if place:
            before = segments[place - 1]
            carried = carried + _at(before, motion.origin - before.origin)
        for body in motion.bodies:
            out = np.einsum("tij,j->ti", motion.rotation, body.centre)
            lever = motion.origin - elbow + out
            weight = body.mass * np.einsum("ti,ti->t", axis, np.cross(lever, carried + _at(motion, out) - down))
            about = np.einsum("tij,j,tkj->tik", motion.rotation, body.inertia, motion.rotation)
            turned = np.einsum("tik,tk->ti", about, motion.alpha)
            turned += np.cross(motion.omega, np.einsum("tik,tk->ti", about, motion.omega))
            torque = weight + np.einsum("ti,ti->t", axis, turned)
            reach = np.einsum("ti,tik,tk->t", axis, about, axis) + body.mass * np.sum(lever**2, axis=1)
            whole += torque
            held += body.mass * gravity * np.linalg.norm(lever, axis=1)
            variance += (body.relative_sd * torque) ** 2 + (reach * motion.sd_alpha) ** 2
    return ElbowTorque(whole, np.sqrt(variance + (held * tilt) ** 2))


def _at(motion: SegmentMotion, out: FloatArray) -> FloatArray:
    """Return the acceleration of a point of a segment relative to the segment's origin, (T, 3) m/s²."""
    return np.cross(motion.alpha, out) + np.cross(motion.omega, np.cross(motion.omega, out))


def _acceleration(position: FloatArray, rate: float) -> FloatArray:
    """Return the low-passed second derivative of positions (T, 3); zero where they are unknown."""
    known: BoolArray = np.asarray(np.isfinite(position).all(axis=1))
    if known.sum() < len(known) // 2:
        return np.zeros_like(position)
    at = np.flatnonzero(known)
    filled = np.stack([np.interp(np.arange(len(position)), at, position[at, i]) for i in range(3)], axis=1)
    smooth = LowPass(_ELBOW_CUTOFF, rate)(filled)
    return np.asarray(np.gradient(np.gradient(smooth, axis=0), axis=0) * rate**2)
