"""ISB frames in the frames of marker clusters, and a chain of segments expressed in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.anatomy.frames import (
    DEFINITIONS,
    FOREARM,
    UPPER_ARM_2,
    SegmentFrame,
    bent_enough,
    build_frame,
    frame_covariance,
    hand_at_rest,
)
from mocap_id.arrays import FloatArray
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class SegmentPoses:
    """Poses of all clusters at one moment.

    Parameters
    ----------
    rotations : (S, 3, 3) array
        Frame of each segment's cluster to the trial.
    origins : (S, 3) array
        m.
    """

    rotations: FloatArray
    origins: FloatArray

    def place(self, local: FloatArray, segment: int) -> FloatArray:
        """Return a point (3,) of a segment in the trial, m."""
        return np.asarray(self.rotations[segment] @ local + self.origins[segment])


@dataclass(frozen=True)
class AnatomicalFrames:
    """ISB frames in the frames of their segments' clusters.

    Parameters
    ----------
    frames : dict
        ``thorax``, ``upper_arm``, ``forearm``, ``hand`` to the frame. A sensitivity is by the displacement of the
        landmark in the axes of its own segment.
    covariances : mapping
        Landmark to its (3, 3) covariance in the axes of its segment, m², or its standard deviation along each axis, m.
    reasons : tuple of Reason
        Frames that could not be built, and why.
    """

    frames: dict[str, SegmentFrame]
    covariances: Mapping[str, FloatArray | float]
    reasons: tuple[Reason, ...]

    def covariance(self, parent: str, child: str) -> FloatArray:
        """Return the (6, 6) covariance of the errors of two frames, each in its own axes, rad²."""
        return frame_covariance((self.frames[parent], self.frames[child]), self.covariances)


def fit_segment_frames(
    places: Mapping[str, FloatArray],
    segment: Mapping[str, int],
    still: SegmentPoses,
    *,
    covariances: Mapping[str, FloatArray | float] | None = None,
    bent: SegmentPoses | None = None,
) -> AnatomicalFrames:
    """Return the ISB frames of the segments from landmarks in the frames of clusters.

    Frames that take landmarks of two segments (the forearm takes the elbow centre) hold for the still pose.

    Parameters
    ----------
    places : mapping
        Landmark to its place (3,) in the frame of its segment's cluster, m. GH is the centre of the shoulder joint in
        the frame of the upper arm.
    segment : mapping
        Landmark to the number of its segment; ``thorax``, ``upper_arm``, ``forearm`` and ``hand`` to theirs.
    still : SegmentPoses
    covariances : mapping, optional
        As in :class:`AnatomicalFrames`; other landmarks have the standard deviation of palpation.
    bent : SegmentPoses, optional
        A pose with the elbow near 90°, for option 2 of the upper arm; option 1 without it.
    """
    reasons: list[Reason] = []
    frames: dict[str, SegmentFrame] = {}
    standing = _place_all(places, segment, still)
    for name, definition in DEFINITIONS.items():
        if name not in segment:
            continue
        missing = [each for each in definition.landmarks if each not in places]
        if not missing:
            frame = _in_segment(build_frame(definition, standing), name, segment, still)
            frames[name] = _second_option(frame, places, segment, bent, reasons) if name == "upper_arm" else frame
        elif name == "hand" and "forearm" in frames:
            frames[name] = _in_segment(hand_at_rest(build_frame(FOREARM, standing), standing), name, segment, still)
            message = f"the hand has no landmarks {', '.join(missing)}; its wrist counts as straight in the still pose"
            reasons.append(Reason("wrist-at-rest", message, level="ok"))
        else:
            message = f"no ISB frame of the {name.replace('_', ' ')}: the landmarks {', '.join(missing)} are missing"
            reasons.append(Reason("no-isb-frame", f"{message}; name them under `landmarks:`"))
    return AnatomicalFrames(frames, covariances or {}, tuple(reasons))


def express_chain(chain: SpatialChain, rotations: FloatArray, base_origin: FloatArray) -> SpatialChain:
    """Return the same chain in other frames of its segments.

    Parameters
    ----------
    chain : SpatialChain
    rotations : (n + 1, 3, 3) array
        New frame of each segment to its old frame.
    base_origin : (3,) array
        New origin of the base in its old frame, m. The other origins stay at the centres of the joints.
    """
    back = np.swapaxes(rotations, 1, 2)
    shift = np.zeros((len(rotations), 3))
    shift[0] = base_origin
    joints = tuple(
        _express_joint(joint, rotations[joint.parent], rotations[k + 1], shift[joint.parent])
        for k, joint in enumerate(chain.joints)
    )
    local = np.einsum("mij,mj->mi", back[chain.segment], chain.local - shift[chain.segment])
    return replace(chain, joints=joints, local=local)


def _express_joint(joint: SpatialJoint, parent: FloatArray, child: FloatArray, shift: FloatArray) -> SpatialJoint:
    turns = np.stack([parent, child])
    return replace(
        joint,
        centre=parent.T @ (joint.centre - shift),
        covariance=parent.T @ joint.covariance @ parent,
        first_axis=parent.T @ joint.first_axis,
        second_axis=child.T @ joint.second_axis,
        axes_covariance=np.swapaxes(turns, 1, 2) @ joint.axes_covariance @ turns,
        offset=parent.T @ joint.offset @ child,
        glide=parent.T @ joint.glide,
        glide_covariance=parent.T @ joint.glide_covariance @ parent,
        rest=parent.T @ joint.rest,
        long_axis=child.T @ joint.long_axis,
    )


def _place_all(
    places: Mapping[str, FloatArray], segment: Mapping[str, int], pose: SegmentPoses
) -> dict[str, FloatArray]:
    return {name: pose.place(local, segment[name]) for name, local in places.items()}


def _second_option(
    first: SegmentFrame,
    places: Mapping[str, FloatArray],
    segment: Mapping[str, int],
    bent: SegmentPoses | None,
    reasons: list[Reason],
) -> SegmentFrame:
    """Return the upper arm's frame by option 2, or the given one by option 1 if the elbow is not bent."""
    if bent is None:
        return first
    if all(name in places for name in UPPER_ARM_2.landmarks):
        points = _place_all(places, segment, bent)
        if bool(bent_enough(points)):
            return _in_segment(build_frame(UPPER_ARM_2, points), "upper_arm", segment, bent)
    message = "option 2 of the upper arm needs US and a pose with the elbow bent by 60 to 120°; option 1 was used"
    reasons.append(Reason("elbow-not-bent", message))
    return first


def _in_segment(frame: SegmentFrame, name: str, segment: Mapping[str, int], pose: SegmentPoses) -> SegmentFrame:
    """Return a frame of the trial in its segment's frame, its sensitivities by displacements within segments."""
    k = segment[name]
    turn = pose.rotations[k]
    return SegmentFrame(
        turn.T @ (frame.origin - pose.origins[k]),
        turn.T @ frame.rotation,
        {each: part @ pose.rotations[segment[each]] for each, part in frame.sensitivity.items()},
    )
