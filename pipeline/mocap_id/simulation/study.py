"""The ``study.yaml`` of a simulated cohort."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mocap_id.simulation.body import Body
from mocap_id.simulation.options import Options
from mocap_id.simulation.subject import Subject

_TOP = """\
# {subjects} simulated persons, {trials} trials of {repetitions} sit-to-stands each.
# Made by `mocap-id simulate cohort` with seed {seed}. The exact truth of each trial stands in truth/<trial>/.
# Paths are relative to this file.
study: simulated-cohort
out: runs
defaults: {{protocol: sit-to-stand}}  # {chair}
subjects:  # m, kg; the landmarks' lengths are the true ones
"""

_SIZE = "height: {height:.3f}, mass: {mass:.2f}, sex: {sex}"
_LANDMARKS = "landmarks_m: {{shank: {shank:.4f}, thigh: {thigh:.4f}}}"
_SUBJECT = f"  {{name}}: {{{{{_SIZE}, {_LANDMARKS}}}}}\n"

_TRIAL = "  - {{trial: {}, subject: {}, strategy: {}, recording: {}}}\n"


def study(options: Options, bodies: Mapping[Subject, Body], trials: Sequence[tuple[str, str, str, str]]) -> str:
    """YAML text, ready to run.

    Parameters
    ----------
    options : Options
        The cohort's.
    bodies : mapping
        Every person's.
    trials : sequence of (trial, subject, strategy, recording)
    """
    chair = (
        "what the chair's own plate reads counts as measured" if options.seat_plate else "the chair stands on no plate"
    )
    counts = {"subjects": len(bodies), "trials": len(trials), "repetitions": options.repetitions}
    text = _TOP.format(**counts, seed=options.seed, chair=chair)
    for subject, body in bodies.items():
        size = {"name": subject.name, "height": subject.height, "mass": subject.mass, "sex": subject.sex}
        text += _SUBJECT.format(**size, **body.scored_lengths)
    return text + "trials:\n" + "".join(_TRIAL.format(*trial) for trial in trials)
