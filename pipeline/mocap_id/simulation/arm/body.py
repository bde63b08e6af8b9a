"""The simulated arm: bones, joint axes and landmarks of a random person, in axes of the ISB (Wu 2005)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.body import Subject, draw_subject

SEGMENTS = ("thorax", "upper_arm", "forearm", "hand")
THORAX, UPPER_ARM, FOREARM, HAND = range(4)


@dataclass(frozen=True)
class ArmBody:
    """A right arm on a thorax, in ISB axes: x forward, y up, z to the right."""

    subject: Subject
    upper_arm: float  # length from the shoulder centre GH to the elbow centre along y, m
    forearm: float  # length from the elbow centre to the wrist centre along y, m
    shoulder: FloatArray  # (3,) shoulder centre GH in the thorax at zero elevation, m
    glide: FloatArray  # (3,) translation of GH in the thorax at 180° of elevation, m
    elbow_axis: FloatArray  # (3,) unit axis of the elbow's hinge in the upper arm
    carrying: float  # constant carrying angle of the bones, rad; negative as for most right elbows
    pronation_axis: FloatArray  # (3,) unit axis in the forearm
    landmarks: Mapping[
        str, tuple[int, FloatArray]
    ]  # segment and (3,) position of each landmark, m; AC at zero elevation

    @property
    def elbow(self) -> FloatArray:
        """Elbow centre (3,) in the upper arm, m."""
        return np.array([0.0, -self.upper_arm, 0.0])

    @property
    def wrist(self) -> FloatArray:
        """Wrist centre (3,) in the forearm, the middle of RS and US, m."""
        return np.asarray((self.landmarks["RS"][1] + self.landmarks["US"][1]) / 2)


def draw_arm(seed: int, glide: float) -> ArmBody:
    """Draw a person whose shoulder centre is displaced by ``glide``, m, at 180° of elevation."""
    subject = draw_subject(seed, 1 + seed % 2)
    rng = np.random.default_rng([seed, 1])
    height = subject.height
    upper_arm = height * rng.normal(0.186, 0.006)
    forearm = height * rng.normal(0.150, 0.005)
    shoulder = height * rng.normal((-0.022, -0.0155, 0.0965), (0.002, 0.002, 0.003))
    direction = np.array([rng.normal(-0.2, 0.02), 0.9, -0.4])
    landmarks = _thorax_landmarks(rng, height)
    landmarks["AC"] = (THORAX, shoulder + np.array([-0.004 * height, 0.0258 * height, 0.010]))
    elbow, wrist = height * rng.normal(0.019, 0.001), height * rng.normal(0.0295, 0.001)
    landmarks["EL"] = (UPPER_ARM, np.array([0.0, -upper_arm, elbow]))
    landmarks["EM"] = (UPPER_ARM, np.array([0.0, -upper_arm, -elbow]))
    landmarks["US"] = (FOREARM, np.array([0.0, 0.004 - forearm, 0.0]))
    landmarks["RS"] = (FOREARM, np.array([0.0, -0.004 - forearm, wrist]))
    return ArmBody(
        subject=subject,
        upper_arm=upper_arm,
        forearm=forearm,
        shoulder=shoulder,
        glide=glide * direction / np.linalg.norm(direction),
        elbow_axis=_normalise(np.array([*rng.normal(0, 0.05, 2), 1.0])),
        carrying=-np.radians(np.clip(rng.normal(10, 3), 3, 17)),
        pronation_axis=_normalise(np.insert(rng.normal(0, 0.025, 2), 1, 1.0)),
        landmarks=landmarks,
    )


def _thorax_landmarks(rng: np.random.Generator, height: float) -> dict[str, tuple[int, FloatArray]]:
    """Return the landmarks IJ, PX, C7 and T8; the middle of IJ and C7 is above the middle of PX and T8."""
    px = height * rng.normal((0.027, -0.095, 0.0), (0.003, 0.007, 0.0))
    c7 = height * rng.normal((-0.061, 0.028, 0.0), (0.002, 0.004, 0.0))
    t8 = np.array([c7[0] - px[0], height * rng.normal(-0.096, 0.003), 0.0])
    points = {"IJ": np.zeros(3), "PX": px, "C7": c7, "T8": t8}
    return {name: (THORAX, point) for name, point in points.items()}


def _normalise(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))
