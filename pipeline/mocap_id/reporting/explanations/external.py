"""What wrenches beside the ground's give rise to: a chair on its own plate, other force sensors."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

EXTERNAL: Mapping[str, Explanation] = {
    "seat-measured": Explanation(
        ("ok",),
        "The chair's force is measured",
        "The chair stands on a force plate of its own. What that reads, less its reading while the person stands, is "
        "the chair's force on the thigh: samples with contact are identified on too, and joint torques account for it.",
        "Nothing. `identify-dim: {seat_segment: …}` names another segment; `{seat_plate: false}` leaves the plate out.",
    ),
    "seat-contradiction": Explanation(
        ("caution",),
        "The chair's plate does not fit the body",
        "With the right force of the chair, ground and chair together move the body that moves without it. With this "
        "one they would have to be multiplied to do so. It was left out, and samples with contact with it, as if the "
        "chair had no plate.",
        "Look at that plate's sign, corners and units, and whether the whole chair, with nothing else, stands on it.",
    ),
    "seat-zero-unknown": Explanation(
        ("caution",),
        "The chair's own weight is unknown",
        "A chair weighs on its plate. What is taken off is the plate's reading while the person stands; here nobody "
        "does. Unless the plate was zeroed with the chair on it, the identified mass is too large by the chair's.",
        "Record some standing, or, if it was zeroed with the chair on it, give `planarise: {seat_zero: none}`.",
    ),
    "plates-doubtful": Explanation(
        ("caution",),
        "A plate's load contradicts its use",
        "The feet's plates keep their load when the person stands, a chair's loses it. A plate that the configuration "
        "names does the opposite.",
        "Look at `plates: {feet: …, seat: …}`: plates count from 1, in the order of `mocap-id inspect`.",
    ),
    "external-contradiction": Explanation(
        ("caution",),
        "A sensor's force does not fit the body",
        "With the right force, everything that acts on the body adds up to its movement. This sensor's would have to "
        "be multiplied to do so; minus one means that the file holds the body's force on the sensor. It was used as it "
        "is, so parameters and torques are wrong.",
        "Look at `force:`, `at:`, `clock_offset_s:` and the axes of the file under `external:`.",
    ),
}
