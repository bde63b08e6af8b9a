"""Explanations of reasons about inertial sensors."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

INERTIAL: Mapping[str, Explanation] = {
    "imu-disagrees": Explanation(
        ("caution",),
        "An inertial sensor contradicts the markers",
        "The rotation or the acceleration of the sensor differs from that of its segment by the markers: the sensor is "
        "on another segment, its file is of another trial, its units are wrong, or the markers are wrong. It is left "
        "out, and the result is that of the other sensors and the markers.",
        "Check which sensor was on which segment, and the files under `imus:`.",
        "ukf-smooth",
        "Differences of angular velocity (limit 0.35 of the segment's) and of specific force (limit 2 m/s²), rms.",
    ),
    "imu-differs": Explanation(
        ("caution",),
        "An inertial sensor and the markers differ more than usual",
        "The sensor follows its segment, but not as closely as skin explains. The sensor is used. Often the markers "
        "are wrong: one is on another segment, or many are hidden. States of this segment may have larger errors than "
        "their intervals say.",
        "Look at the residuals of the segment's markers and at its assignment; check that the sensor was tight.",
        "ukf-smooth",
        "Difference of the angular velocities, rad/s rms; limit 0.15 of the segment's, of at least 0.8 rad/s.",
    ),
    "imu-clock": Explanation(
        ("ok",),
        "The motion does not show the clock of an inertial sensor",
        "The clock is found from the rotation of the segment. A segment that hardly turns does not show it; the "
        "sensor's measurements then hardly depend on it either. Its offset in the summary is a guess with a large "
        "standard deviation, and `observable` is false.",
        "Nothing. If the offset itself is needed, turn the segment quickly at the start of the recording.",
        "ukf-smooth",
        "Standard deviation of the clock in the middle of the trial, s; limit 0.002.",
    ),
    "imu-saturated": Explanation(
        ("caution",),
        "An inertial sensor is saturated",
        "Some samples lie at the end of the sensor's range. They are left out; the states there come from the markers.",
        "Record with a larger range of the sensor.",
        "ukf-smooth",
        "Share of the samples that stay at the end of the range; limit 0.003.",
    ),
    "imus-alone": Explanation(
        ("caution",),
        "The trial has inertial sensors alone",
        "The chain, the place of each sensor and its mounting are those of the trial under `calibration:`. Gravity "
        "bounds the angles, so that they do not drift; their intervals contain the errors that the calibration shows "
        "if its markers are ignored. Directions about the vertical drift (`heading_deg` in the summary), and places in "
        "the room and forces are unknown. A sensor that was taken off and put on again turns the angles by a constant "
        "that nothing shows.",
        "Record markers and sensors together, and this trial without taking the sensors off.",
        "ukf-smooth",
        "Mean standard deviation of the angles, degrees; no limit.",
    ),
    "imus-alone-incomplete": Explanation(
        ("refused",),
        "A segment has neither markers nor an inertial sensor",
        "Without markers, each moving segment of the chain needs a sensor, in this trial and in its calibration. The "
        "angles of a joint beside a segment without one are unknown.",
        "Put a sensor on every moving segment in both trials, and name it under `imus:` by the same segment.",
        "planarise",
        "Sensors on all moving segments of the chain.",
    ),
    "imu-moved": Explanation(
        ("caution",),
        "A sensor sits otherwise than in the calibration",
        "On average, gravity has a part out of the plane of motion that it did not have in the calibration: the sensor "
        "was turned on its segment, or the person leaned sideways. A turn in the plane of the same size is likely and "
        "changes the angles by a constant; the intervals do not contain it.",
        "Record calibration and trial without taking the sensors off.",
        "ukf-smooth",
        "Angle of the mean specific force out of the plane against that of the calibration, degrees; limit 3.",
    ),
    "imus-contradict": Explanation(
        ("caution", "refused"),
        "The inertial sensors contradict each other",
        "On the chain of the calibration, the angular velocities of all gyroscopes predict what each accelerometer "
        "should measure. The difference is larger than noise and skin explain. The usual causes are two exchanged "
        "sensors, a sensor that was turned or put on anew, the calibration of another person, a wrong unit, and a "
        "clock of another rate. The angles may then be wrong by 5° to 180°, which no interval includes.",
        "Check which sensor is on which segment, its units and its clock, and that the calibration is of the same "
        "person and the same placement.",
        "ukf-smooth",
        "Largest rms of a component of this difference, m/s²; 0.05 in simulated people. Caution above 0.1, refused "
        "above 0.5.",
    ),
    "imu-heading": Explanation(
        ("caution",),
        "The motion left its plane",
        "The gyroscope shows a turn about the vertical that is larger than its drift explains. Angles in the plane do "
        "not describe such a motion.",
        "Keep feet and trunk in one direction, or use `window:` for the part before the turn.",
        "ukf-smooth",
        "Turn about the vertical between start and end, degrees; limit 15 plus two standard deviations.",
    ),
}
