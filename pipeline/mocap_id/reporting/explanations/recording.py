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
    "plate-misplaced": Explanation(
        ("caution",),
        "A force plate is not where the file has it",
        "The ground can only push, so its force acts under the feet. Held against the markers on the feet that stand "
        "still, it acts beside them: the plate's place in the cameras' axes is wrong. The centre of pressure, tauz and "
        "every parameter are off with it; forces and mass are not.",
        "Measure the plate's corners anew, with markers on them, and correct them in the file; look at ORIGIN and at "
        "the units of the moments too.",
    ),
    "plate-height": Explanation(
        ("caution",),
        "A force plate's surface is not where the feet stand",
        "The markers on the feet are below the plate's surface, or far above it. The moment about the surface is off "
        "by the error of the height times the horizontal force.",
        "Measure the heights of the plate's corners anew. Where only markers high above the feet stay still, ignore "
        "this.",
    ),
    "plate-tilted": Explanation(
        ("caution", "ok"),
        "A force plate is tilted",
        "Who stands still is carried by a vertical force. Here the measured one leans, or the corners incline the "
        "plate without a stance that would show whether it is: a part of the weight then counts as horizontal force, "
        "12 N in a person of 70 kg for each degree. A plate that is inclined and says so is no error, and a note.",
        "Level the plate, zero it without load, and measure its corners anew. The lean tells of all the feet's plates "
        "together: of two, one may be tilted twice as much.",
    ),
    "plate-turned": Explanation(
        ("caution",),
        "A force plate is turned about the vertical",
        "The horizontal force is the body's mass times its acceleration, which the cameras see. The two point in "
        "different directions: the plate is turned, by half a turn most often, or its horizontal channels have the "
        "wrong sign. Fx and tauz are then of another sign or another axis, and no parameter holds.",
        "Look at the order of the corners (+x+y, −x+y, −x−y, +x−y in the plate's axes) and at the channels' signs.",
    ),
    "plate-saturated": Explanation(
        ("caution",),
        "A force plate is at the end of its range",
        "A channel sits at the converter's limit, or is held at an extreme that it never passes. The force was larger. "
        "Such samples are left out, and they are those in which the movement is strongest: parameters are known less "
        "well, and the mass only if the person's weight is within the range.",
        "Choose a larger range of the plate's amplifier and record again.",
    ),
    "plate-short": Explanation(
        ("caution", "ok"),
        "Forces and markers are not equally long",
        "The forces begin later than the markers or end before them. Without a force there is nothing to identify "
        "from; the kinematics use all frames.",
        "Export both whole. If they are of two recordings, the clock offset and every parameter are meaningless.",
    ),
    "plate-dropout": Explanation(
        ("caution",),
        "A force plate lost its signal",
        "The plates read nothing, or next to it, while the person stands upright and is not in the air. These frames "
        "are left out as if they had not been measured.",
        "Look at the plate's signal and its cable, or at a step beside the plate; leave that part out with `window:`.",
    ),
    "encoder-disagrees": Explanation(
        ("caution",),
        "The encoder and the cameras tell different movements",
        "A robot's encoder and the cameras look at the same joint, so that sense, zero and clock aside their angles "
        "agree to the noise. Here they do not. The states, unless `ukf-smooth: {method: encoder}` asks for it, are "
        "those of the cameras; which of the two is wrong is not known.",
        "Look whether the record is of this trial and of the joint that moves, and whether anything gives between "
        "encoder and link.",
    ),
    "encoder-weak": Explanation(
        ("caution",),
        "The encoder's clock or sense is not certain",
        "They are found from the one movement that encoder and cameras both saw, and it does not tell them well. What "
        "compares the two, the torque above all, suffers; states from the cameras do not.",
        "Let the joint rest, then swing widely and fast; or set the clocks to each other beforehand.",
    ),
}
