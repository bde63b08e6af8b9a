"""What single repetitions of a sit-to-stand give rise to."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

RISING: Mapping[str, Explanation] = {
    "attempt-failed": Explanation(
        ("caution",),
        "A rise was broken off",
        "The hips left the seat, or the feet took over at least 40 % of what the chair carries, and the person fell "
        "back. Such an attempt is no repetition; it lasts within the five-times test's time if others surround it. The "
        "samples count as contact with the chair, so the identification is not touched.",
        "Look at the times in the table of attempts. Where the test's rules ask for it, record again.",
    ),
    "rise-partial": Explanation(
        ("caution",),
        "A repetition does not come to standing",
        "The hips stay below 90 % of the height that they reach otherwise. The repetition is listed as not complete "
        "and is not counted for the five-times test. What is identified from it holds.",
        "Where the whole trial is of half rises, the highest of them counts as standing: nothing in the recording "
        "tells otherwise. Record a quiet upright stance with it.",
    ),
    "rise-paused": Explanation(
        ("caution",),
        "A rise stops on its way",
        "Between seat and standing the person is still for 0.3 s or longer. Events are those of the whole rise, and "
        "the times of the five-times test hold the pause.",
        "Nothing for the parameters. For the test, judge whether the trial counts.",
    ),
    "support-unexplained": Explanation(
        ("caution",),
        "Something else carries the person",
        "While the person rises, the plates show less than the body's acceleration asks for, by more than 5 % of the "
        "weight: a hand on an armrest or rail, or a helping hand. Without a plate under the chair this can be told "
        "only where the hips are above a quarter of the rise; lower, the support looks like the chair's. A push with "
        "the hands on the own thighs is a force within the body, and no plate shows it.",
        "Record with the arms crossed, or measure the support and give it under `external:`.",
    ),
    "repetition-cut": Explanation(
        ("ok",),
        "The recording cuts a repetition off",
        "Events outside the recording are not known; the repetition is kept as not complete.",
        "Record from quiet sitting to quiet sitting, or widen `window:`.",
    ),
}
