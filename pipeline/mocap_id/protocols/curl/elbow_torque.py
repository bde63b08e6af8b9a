"""Torque about the elbow's flexion axis, from the motion of forearm and hand and their inertia (thesis 8.3).

The elbow has the acceleration a. A centre of mass of the forearm at r from the elbow has the acceleration
a_centre = a + α × r + ω × (ω × r). With the acceleration g of gravity, the torque of all muscles and devices about the
unit axis h is

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
    """A rigid body that is forearm or hand, or is carried by it."""

    mass: float  # mass, kg
    centre: FloatArray  # (3,) centre of mass in the axes of the segment, m
    inertia: FloatArray  # (3,) moments of inertia about the centre of mass along the segment's axes, kg·m²
    relative_sd: float  # standard deviation of the mass as a share of the mass


@dataclass(frozen=True)
class SegmentMotion:
    """Motion of one segment in the trial's axes at T samples, and its bodies."""

    origin: FloatArray  # (T, 3) origin of the segment, m
    rotation: FloatArray  # (T, 3, 3) rotation from the segment's axes to the trial's axes
    # omega, alpha: (T, 3) angular velocity, rad/s, and angular acceleration, rad/s²
    omega: FloatArray
    alpha: FloatArray
    sd_alpha: FloatArray  # (T,) standard deviation of each component of alpha, rad/s²
    bodies: Sequence[Mass]  # bodies with this motion


@dataclass(frozen=True)
class ElbowTorque:
    """Torque about the elbow's axis and its standard deviation, (T,) N·m; NaN where the motion is unknown."""

    torque: FloatArray
    sd: FloatArray


def compute_elbow_torque(
    time: FloatArray, axis: FloatArray, segments: Sequence[SegmentMotion], *, tilt: float, gravity: float = 9.81
) -> ElbowTorque:
    """Return the torque of all muscles and devices about the elbow's axis.

    Parameters
    ----------
    time : (T,) array
        Sample times with constant step, s.
    axis : (T, 3) array
        Unit vector of the elbow's axis in the trial's axes; a positive rotation about it is flexion.
    segments : sequence of SegmentMotion
        Forearm, whose origin is the elbow, and hand.
    tilt : float
        Standard deviation of the forearm's direction, rad.
    gravity : float
        Acceleration of gravity, m/s², along -y.
    """
    rate = (len(time) - 1) / (time[-1] - time[0])
    elbow = segments[0].origin
    down = np.array([0.0, -gravity, 0.0])
    total, weight_moment, variance = np.zeros(len(time)), np.zeros(len(time)), np.zeros(len(time))
    acceleration = _differentiate_twice(elbow, rate)  # acceleration of the segment's origin
    for k, motion in enumerate(segments):
        if k:
            before = segments[k - 1]
            acceleration = acceleration + _relative_acceleration(before, motion.origin - before.origin)
        for body in motion.bodies:
            out = np.einsum("tij,j->ti", motion.rotation, body.centre)
            lever = motion.origin - elbow + out
            specific_force = acceleration + _relative_acceleration(motion, out) - down
            by_force = body.mass * np.einsum("ti,ti->t", axis, np.cross(lever, specific_force))
            inertia = np.einsum("tij,j,tkj->tik", motion.rotation, body.inertia, motion.rotation)
            moment = np.einsum("tik,tk->ti", inertia, motion.alpha)
            moment += np.cross(motion.omega, np.einsum("tik,tk->ti", inertia, motion.omega))
            torque = by_force + np.einsum("ti,ti->t", axis, moment)
            about_elbow = np.einsum("ti,tik,tk->t", axis, inertia, axis) + body.mass * np.sum(lever**2, axis=1)
            total += torque
            weight_moment += body.mass * gravity * np.linalg.norm(lever, axis=1)
            variance += (body.relative_sd * torque) ** 2 + (about_elbow * motion.sd_alpha) ** 2
    return ElbowTorque(total, np.sqrt(variance + (weight_moment * tilt) ** 2))


def _relative_acceleration(motion: SegmentMotion, out: FloatArray) -> FloatArray:
    """Return the acceleration (T, 3) of a point at ``out`` from the segment's origin, relative to the origin, m/s²."""
    return np.cross(motion.alpha, out) + np.cross(motion.omega, np.cross(motion.omega, out))


def _differentiate_twice(position: FloatArray, rate: float) -> FloatArray:
    """Return the second derivative (T, 3) of low-passed positions, m/s²; zeros if more than half are missing."""
    known: BoolArray = np.asarray(np.isfinite(position).all(axis=1))
    if known.sum() < len(known) // 2:
        return np.zeros_like(position)
    at = np.flatnonzero(known)
    filled = np.stack([np.interp(np.arange(len(position)), at, position[at, i]) for i in range(3)], axis=1)
    smooth = LowPass(_ELBOW_CUTOFF, rate)(filled)
    return np.asarray(np.gradient(np.gradient(smooth, axis=0), axis=0) * rate**2)
