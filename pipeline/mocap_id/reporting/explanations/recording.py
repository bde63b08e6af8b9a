"""What a recording's file, plane and marker labels give rise to."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

RECORDING: Mapping[str, Explanation] = {
    "recording-oddity": Explanation(
        ("ok",),
        "Something odd in the file",
        "The file contradicts itself or its format in a way that could be read around, as the message says.",
        "Compare with what you know of the recording; `mocap-id inspect FILE` shows all that the file holds.",
    ),
    "window-proposed": Explanation(
        ("ok",),
        "Only a part of the recording was used",
        "People walk on and off. The longest part in which markers stay put was taken, because a chain needs a base.",
        "Give `window: [from, to]`, in seconds of the recording's clock, to choose another part.",
    ),
    "facing-unsure": Explanation(
        ("ok",),
        "Which way the person faces is unsure",
        "A plane has two sides. If the wrong one was taken, x, every angle, Fx, the moment and the centre of pressure "
        "have the other sign; sizes do not change.",
        "Compare the skeleton with the person; if it is mirrored, give `planarise: {facing: +x}`.",
    ),
    "upside-down": Explanation(
        ("caution",),
        "The chain hangs below its base",
        "The moving segments are lower than the markers that stay still. For a person that means a wrong vertical "
        "axis, and then gravity, forces and mass are wrong too. A robot may hang.",
        "Set `planarise: {vertical: …}`, or ignore this for a chain that really hangs.",
    ),
    "marker-swap": Explanation(
        ("caution", "ok"),
        "Two markers carry each other's label",
        "Two trajectories exchange their places at once, and the distances to the markers around them hold only if the "
        "labels are exchanged too. The labels that the file begins with count as right. Left as they are (caution), "
        "swapped markers spoil the segments, the joints and everything after them; exchanged back (note), they do no "
        "harm.",
        "Compare the frames that are named with the cameras' own software and relabel there, or give `planarise: "
        "{repair_swaps: true}`. Your file is never changed.",
    ),
    "bursts": Explanation(
        ("ok",),
        "Markers jump",
        "Some samples jump away from their marker's track and back within 0.4 s: a wrong reconstruction, not a "
        "movement. They are left out before the segments are sought.",
        "Nothing, if they are few. Otherwise look at that marker in the cameras' own software.",
    ),
    "plate-unit-assumed": Explanation(
        ("caution",),
        "The unit of a force plate was assumed",
        "The file does not say in which unit the plate under the feet measures, so that of the format's custom was "
        "taken: N, and the file's unit of length. If it is another, every force, mass or moment is wrong by a constant "
        "factor, and nothing else shows it.",
        "Compare the mass in the report with the person's. Then give `planarise: {force_unit: …, moment_unit: …}`, "
        "which also settles the matter where the assumption is right.",
    ),
    "encoder-unused": Explanation(
        ("ok",),
        "The encoder is not read",
        "The configuration names an encoder's file. This version estimates the states from the markers alone.",
        "Nothing; the file can stay named.",
    ),
}
