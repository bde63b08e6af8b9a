"""Torques about the elbow in simulated curls (total, person, pneumatic device), and the description of the device."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.allometry import look_up_arm
from mocap_id.simulation.arm.body import FOREARM, HAND, UPPER_ARM, ArmBody
from mocap_id.simulation.arm.options import ArmOptions, CurlCondition
from mocap_id.simulation.arm.rotations import Z
from mocap_id.simulation.arm.trial import SpatialTrial
from mocap_id.simulation.body import GRAVITY
from mocap_id.stages.curl_keys import Body
from mocap_id.stages.device import Condition, DeviceFile

_SEGMENTS = {"forearm": FOREARM, "hand": HAND}
_DUMBBELL = Body(mass=3.59, centre=(0.0, -0.075, 0.0), inertia=(0.009, 0.0014, 0.009))
_BRACE = Body(mass=0.2, centre=(0.0, -0.11, 0.03), inertia=(0.0005, 0.0003, 0.0005), segment="forearm")


def arm_bodies(body: ArmBody) -> dict[str, Body]:
    """Return forearm and hand of a person, with inertial parameters from de Leva's table."""
    bodies: dict[str, Body] = {}
    forearm = look_up_arm("forearm", body.subject.sex)
    for name, segment in (("forearm", forearm), ("hand", look_up_arm("hand", body.subject.sex))):
        mass, length = segment.mass * body.subject.mass, body.forearm * segment.length / forearm.length
        across = mass * (segment.gyration * length) ** 2
        bodies[name] = Body(
            mass=mass,
            centre=(0.0, -segment.centre * length, 0.0),
            inertia=(across, 0.0, across),
            segment="forearm" if name == "forearm" else "hand",
        )
    return bodies


def carried_loads(condition: str) -> dict[str, Body]:
    """Return the loads that a person carries: the dumbbell of the thesis, and a brace if the device is worn."""
    return {"dumbbell": _DUMBBELL} if condition == "C" else {"dumbbell": _DUMBBELL, "brace": _BRACE}


def curl_keys(options: ArmOptions, body: ArmBody) -> dict[str, Any]:
    """Return the keys of `curl:` in trial.yaml, with the exact inertial parameters of all bodies."""
    keys: dict[str, Any] = {"condition": options.condition, "metronome_hz": 0.5}
    if options.condition != "C":
        keys["device"] = "device.yaml"
    keys["loads"] = {name: body_keys(one) for name, one in carried_loads(options.condition).items()}
    return keys | {name: body_keys(one) for name, one in arm_bodies(body).items()}


def body_keys(body: Body) -> dict[str, Any]:
    """Return the keys and rounded values of a body in a configuration."""
    keys = body.model_dump(mode="json")
    rounded = {name: [round(each, 6) for each in keys[name]] for name in ("centre", "inertia")}
    return {"mass": round(body.mass, 5), **rounded, "segment": body.segment}


def curl_torques(options: ArmOptions, trial: SpatialTrial) -> Mapping[str, FloatArray]:
    """Return the torques (F,) about the elbow's hinge by name, positive in flexion, N·m: total, device and human."""
    body: ArmBody = trial.document["body"]
    elbow = trial.origins[:, FOREARM]
    step = 1 / trial.rate

    def rate(values: FloatArray) -> FloatArray:
        return np.asarray(np.gradient(values, step, axis=0, edge_order=2))

    moment = np.zeros((len(trial.time), 3))
    for one in (*arm_bodies(body).values(), *carried_loads(options.condition).values()):
        k = _SEGMENTS[one.segment]
        rotation = trial.rotations[:, k]
        centre = trial.origins[:, k] + rotation @ np.array(one.centre)
        about = rotation @ np.diag(one.inertia) @ rotation.transpose(0, 2, 1)
        spin = (about @ trial.omega[:, k, :, None])[..., 0]
        force = one.mass * (rate(rate(centre)) + GRAVITY * Z)
        moment += np.cross(centre - elbow, force) + rate(spin)
    total = np.einsum("ti,ti->t", trial.rotations[:, UPPER_ARM] @ body.elbow_axis, moment)
    flexion, velocity = trial.angles["elbow_flexion"], trial.rates["elbow_flexion"]
    person = options.seed if options.subject is None else options.subject
    device = device_torque(person, options.condition, flexion, velocity)
    return {"tau_total": total, "tau_device": device, "tau_human": total - device}


_HIGH, _ATMOSPHERE = 446_063.0, 101_325.0  # Pa, absolute: 50 psi above the atmosphere, and the atmosphere
DEVICE = DeviceFile(
    device="simulated-elbow",
    pulley_radius_m=0.03,
    area_flexion_m2=2.835e-4,
    area_extension_m2=2.552e-4,
    dead_flexion_m=0.09,
    dead_extension_m=0.09,
    stroke_m=0.08,
    full_flexion_deg=150,
    polytropic=1.2,
    coulomb_Nm=0.2,
    viscous_Nms=0.02,
    supply_Pa=700_000,
    conditions={
        "C": Condition(worn=False),
        "AC": Condition(),
        "2": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_HIGH),
        "3": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_ATMOSPHERE),
        "4": Condition(flexion_Pa=_HIGH, extension_Pa=_HIGH),
        "5": Condition(flexion_Pa=_HIGH, extension_Pa=_ATMOSPHERE),
    },
)
"""Description of the device; its dimensions are assumed, because the thesis does not publish them."""


def device_yaml() -> bytes:
    """Return the content of the device's YAML file."""
    keys = DEVICE.model_dump(mode="json", exclude_defaults=True)
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in keys.items()).encode()


def device_torque(seed: int, condition: CurlCondition, angle: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the torque (T,) of the device on the elbow, N·m, for flexion ``angle``, rad, and ``velocity``, rad/s.

    The true cylinder differs from the description by random errors with the standard deviations of the description. The
    same seed gives the same cylinder.
    """
    state = DEVICE.conditions[condition]
    if not state.worn:
        return np.zeros(len(angle))
    rng = np.random.default_rng([seed, 30])
    cylinder, setting = DEVICE.cylinder(), state.setting()
    errors = {name: float(rng.normal(0, sd)) for name, sd in DEVICE.deviations().items()}
    gauge = errors.pop("gauge")
    true = replace(cylinder, **{name: max(getattr(cylinder, name) + error, 0.0) for name, error in errors.items()})
    true = replace(true, exponent=float(np.clip(true.exponent, 1.0, 1.4)))
    sealed = [None if pressure is None else pressure + gauge for pressure in (setting.flexion, setting.extension)]
    spring = true.torque(angle, replace(setting, flexion=sealed[0], extension=sealed[1]))
    return np.asarray(spring + true.friction(velocity))
