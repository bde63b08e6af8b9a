"""Explanations of reasons about the recording: file, plane, marker labels, force plates and encoder."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

RECORDING: Mapping[str, Explanation] = {
    "recording-oddity": Explanation(
        ("ok",),
        "Inconsistency in the file",
        "The file contradicts itself or its format, but it could still be read. The message gives the details.",
        "Compare with what you know of the recording; `mocap-id inspect FILE` shows the contents of the file.",
        "planarise",
        "The reader of the file reports it.",
    ),
    "window-proposed": Explanation(
        ("ok",),
        "Only part of the recording was used",
        "People walk into and out of the volume. The longest part with still markers was used, because the chain needs "
        "a fixed base.",
        "Give `window: [from, to]`, in seconds of the recording's clock, to choose another part.",
        "planarise",
        "No `window:` is given, and markers are still in only part of the recording.",
    ),
    "facing-unsure": Explanation(
        ("ok",),
        "The facing direction is uncertain",
        "The plane of motion can be seen from two sides. If the wrong one was chosen, x, all angles, Fx, the moment "
        "and the centre of pressure have the opposite sign; their magnitudes are right.",
        "Compare the skeleton with the person. If it is mirrored, set `planarise: {facing: +x}`.",
        "planarise",
        "The sign that distinguishes front from back is within the noise.",
    ),
    "board-vertical-only": Explanation(
        ("ok",),
        "A balance board instead of a plate",
        "The board measures the vertical force and the centre of pressure at its cells. The parameters are fitted to "
        "Fy and tauz. Fx and its share of the torques come from the model; no measurement checks them.",
        "Nothing, if this is what you want; [other sensors](sensors.md#balance-boards) says what a board can show.",
        "planarise",
        "The forces of the recording are those of a `balance_board`.",
    ),
    "board-gaps": Explanation(
        ("caution", "ok"),
        "The balance board paused",
        "The wireless link stalled. The load is unknown in these samples, and they are not used.",
        "Bring the receiver closer to the board, and close other programs on the computer.",
        "planarise",
        "Two time stamps of the log are more than 0.15 s apart; a caution if more than 2 % of the time is lost.",
    ),
    "board-direction-unsure": Explanation(
        ("caution",),
        "The direction of the balance board is uncertain",
        "Which way the board lies is found from the movement of the body and the centre of pressure, and then compared "
        "with a usual body. Here the opposite direction fits nearly as well, or better. If it is wrong, tauz, "
        "the centre of pressure and all parameters are wrong.",
        "Say where the top of the board points, or check what you said: `top:` beside `balance_board:`.",
        "identify-dim",
        "The first moments of the opposite direction disagree with those of a usual body less, or less than 3 times "
        "as much while r² of tauz is below 0.9. For other movements than a sit-to-stand: the body explains less than "
        "half of the centre of pressure.",
    ),
    "board-place-unknown": Explanation(
        ("caution",),
        "The place of the balance board is uncertain",
        "The model of a person shows where the board stands. Here no such model applies, so the board was placed under "
        "the feet. The first moment of the base segment, the centre of pressure and the torques contain its error, "
        "about 3 cm.",
        "Measure the centre of the board: `centre_m:` beside `balance_board:`.",
        "identify-dim",
        "No `centre_m` is given, and there is no reference body.",
    ),
    "base-moved": Explanation(
        ("caution", "ok"),
        "The feet changed their place",
        "The feet slid, were placed elsewhere or turned, usually while the person sat. If both moved alike (note), "
        "markers, forces and moments are expressed relative to the feet, so that angles, lengths and torques are "
        "right. x, tauz and the centre of pressure then hold for the feet at their first place. If they did not move "
        "alike (caution), only their mean displacement was corrected; joints and lengths are less exact.",
        "Nothing for a note; `planar.parquet` has the times and amounts. For a caution, analyse each part alone with "
        "`window:`, or record again with the feet at marked places.",
        "planarise",
        "Largest horizontal displacement of the markers on the feet between two stretches in which they stand still, "
        "m; found from 8 mm. A caution if they are more than 5 mm rms from a common motion.",
    ),
    "plane-leans": Explanation(
        ("ok",),
        "The plane of motion leans sideways",
        "The motion lies in a plane that is not vertical: the person moves at an angle to the vertical, or the "
        "cameras' vertical is wrong. Angles and lengths are measured in this plane, forces and moments in the "
        "vertical plane along it.",
        "If the person moved upright, calibrate the cameras' vertical again.",
        "planarise",
        "Lean of the plane, degrees; from 2.5 to 20, if this plane leaves less than half of the out-of-plane motion.",
    ),
    "upside-down": Explanation(
        ("caution",),
        "The chain hangs below its base",
        "The moving segments are below the still markers. For a person this means a wrong vertical axis, and gravity, "
        "forces and mass are wrong too. A robot may really hang.",
        "Set `planarise: {vertical: …}`. If the chain really hangs, ignore this.",
        "segment",
        "The mean height of the moving markers is below that of the base.",
    ),
    "marker-swap": Explanation(
        ("caution", "ok"),
        "Swapped marker labels",
        "Two trajectories exchange places at once, and the distances to the markers around them are preserved only if "
        "the labels are exchanged too. The labels at the start of the file are taken as correct. Of unrepaired swaps "
        "(caution), the samples of both markers are left out of the segments, the joints and the states; repaired "
        "swaps (note) are used.",
        "Check the named frames in the camera software and relabel there, or set `planarise: {repair_swaps: true}`. "
        "Your file is never changed.",
        "segment",
        "Two trajectories jump at once by 8 to 15 mm or more; the distances to other markers stay constant only if the "
        "two labels are exchanged.",
    ),
    "bursts": Explanation(
        ("ok",),
        "Markers jump",
        "Some samples jump away from the marker's trajectory and back within 0.4 s. Such a jump is a reconstruction "
        "error, not a movement. These samples are excluded before the segments are found.",
        "Nothing, if they are few. Otherwise inspect the marker in the camera software.",
        "segment",
        "A sample jumps by 12 mm or more, and by 4 times the usual change between samples, and returns.",
    ),
    "plate-unit-assumed": Explanation(
        ("caution",),
        "The unit of a force plate was assumed",
        "The file does not state the unit of the plate under the feet. The usual unit of the format was assumed: N, "
        "and the length unit of the file. If this is wrong, every force, mass and moment has the wrong scale, and no "
        "other check shows it.",
        "Compare the mass in the report with the person's. Then set `planarise: {force_unit: …, moment_unit: …}`, "
        "also to confirm a correct assumption.",
        "planarise",
        "The file declares no unit of force or moment.",
    ),
    "plate-misplaced": Explanation(
        ("caution",),
        "A force plate is not where the file places it",
        "The ground can only push, so its force acts under the feet. Compared with the markers on the standing feet, "
        "it acts beside them: the position of the plate in the camera axes is wrong. The centre of pressure, tauz and "
        "all parameters are affected; force and mass are not.",
        "Measure the plate corners again, with markers on them, and correct them in the file. Also check ORIGIN and "
        "the units of the moments.",
        "planarise",
        "Distance of the centre of pressure from the standing foot's markers, m; limit 0.05 m plus the uncertainty of "
        "their positions.",
    ),
    "plate-unchecked": Explanation(
        ("ok",),
        "The position of a force plate was not checked",
        "The centre of pressure is compared with the outline of the foot markers. Here they do not show this outline: "
        "toes or heels alone, one foot alone, or feet that never stand still. The position of the plate is taken from "
        "the file.",
        "Measure the plate corners with markers on them. Next time put markers on heel and toes of both feet.",
        "planarise",
        "Markers of standing feet are missing, each shorter than 0.13 m, or together less than 0.13 m wide.",
    ),
    "plate-height": Explanation(
        ("caution",),
        "Wrong height of a force plate",
        "The markers on the feet are below the plate surface, or far above it. The moment about the surface is wrong "
        "by the height error times the horizontal force.",
        "Measure the heights of the plate corners again. If the only still markers are high above the feet, ignore "
        "this.",
        "planarise",
        "Height of the lowest foot marker above the surface, m; limits 0.008 below, 0.12 above.",
    ),
    "plate-tilted": Explanation(
        ("caution", "ok"),
        "A force plate is tilted",
        "The ground reaction force on a person who stands still is vertical. Here the measured force leans, or the "
        "corners describe a tilted plate and no standing phase shows whether it is. Part of the weight then appears as "
        "horizontal force: 12 N per degree for a person of 70 kg. A plate that is correctly described as tilted is not "
        "an error, only a note.",
        "Level the plate, zero it without load, and measure its corners again. The lean is that of all plates under "
        "the feet together: of two plates, one may be tilted by twice as much.",
        "planarise",
        "Inclination of the corners, degrees; limit 1.5. Or of the force while standing, degrees; limit 2.",
    ),
    "plate-turned": Explanation(
        ("caution",),
        "A force plate is rotated about the vertical axis",
        "The horizontal force equals the body's mass times its horizontal acceleration, which the cameras measure. The "
        "two point in different directions: the plate is rotated, usually by half a turn, or its horizontal channels "
        "have the wrong sign. Fx and tauz then have the wrong sign or axis, and no parameter is valid.",
        "Check the order of the corners (+x+y, −x+y, −x−y, +x−y in the plate's axes) and the signs of the channels.",
        "planarise",
        "Angle about the vertical between the horizontal force and the mean marker acceleration, degrees; limit 30, or "
        "90 for the plate of one foot.",
    ),
    "plate-saturated": Explanation(
        ("caution",),
        "A force plate is saturated",
        "A channel is at the limit of the converter, or stays at an extreme value that it never exceeds. The true "
        "force was larger. These samples, which are those of the strongest movement, are excluded. The parameters are "
        "therefore less certain, and the mass is known only if the person's weight is within the range.",
        "Choose a larger range on the plate's amplifier and record again.",
        "planarise",
        "Share of samples at the limit of a channel's range; limit 0.",
    ),
    "plate-short": Explanation(
        ("caution", "ok"),
        "Forces and markers have different lengths",
        "The forces begin later than the markers or end earlier. Frames without force cannot be used for "
        "identification; the kinematics use all frames.",
        "Export both in full. If they are from two recordings, the clock offset and all parameters are meaningless.",
        "planarise",
        "Share of frames without force; a caution above 0.05.",
    ),
    "plate-dropout": Explanation(
        ("caution",),
        "A force plate lost its signal",
        "The plates read almost nothing while the person stands upright and is not in the air. These frames are "
        "treated as not measured.",
        "Check the plate's signal and cable, or whether the person stepped off the plate. Exclude that part with "
        "`window:`.",
        "planarise",
        "Share of frames in intervals of 0.6 s or longer in which the plates carry less than a fifth of their usual "
        "load; limit 0.",
    ),
    "encoder-disagrees": Explanation(
        ("caution",),
        "The encoder and the cameras disagree",
        "The encoder and the cameras measure the same joint. After correction of sense, zero and clock, their angles "
        "should agree to within the noise; here they do not. The states are those of the cameras unless `ukf-smooth: "
        "{method: encoder}` is set. It is not known which of the two is wrong.",
        "Check that the encoder record belongs to this trial and to the joint that moves, and that there is no play "
        "between the encoder and the link.",
        "ukf-smooth",
        "r² of the camera angle against the encoder angle, after correction of sense, zero and clock; limit 0.999.",
    ),
    "encoder-weak": Explanation(
        ("caution",),
        "The clock or sense of the encoder is uncertain",
        "Both are estimated from the movement that encoder and cameras recorded, which does not determine them well. "
        "Comparisons between the two, especially of torque, are inexact; the states from the cameras are not affected.",
        "Let the joint rest, then move it far and fast; or synchronise the clocks before the recording.",
        "ukf-smooth",
        "The opposite sense fits nearly as well, or the clock offset is at `ukf-smooth: {encoder_offset_limit_s}`, or "
        "its standard deviation is above 0.001 s.",
    ),
}
"""Explanation of each code."""
