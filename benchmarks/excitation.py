"""Whether advised movements keep their promise: ``python benchmarks/excitation.py [--write PAGE]``.

A body makes a movement that tells little; `mocap-id advise` says what to do instead; the same body does it in another
simulated recording, which goes through the whole pipeline. Prints docs/excitation.md, and with ``--write
docs/excitation.md`` replaces that page. About a quarter of a minute a body and core.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from excitation_bodies import KINDS, Case, Recorded, Result, measure
from kinematic_sweep import markdown

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.excitation import standing
from mocap_id.dynamics.proposal import Proposal

FRESH = 960_000  # the first seed; nothing was tuned on these

TEXT = """# Which movement to record

`mocap-id advise TRIAL` looks, for a trial whose body was identified, for the movement that would make its parameters
better known, and says what it would be worth: the standard deviation of every parameter, and the condition number.

```
mocap-id advise runs/s01                                    # a run folder, or a trial's YAML
mocap-id advise trial.yaml --angle knee=-90:0 --seconds 30  # what the person can do; length of the recording
mocap-id advise trial.yaml --for condition --support -10:4  # another aim; room for the centre of pressure, cm
mocap-id advise robot.yaml --out advised                    # advice.json, movement.csv, movement.svg and .pdf
```

It tells the best movement, simple changes from the best down, one movement of all joints together that a search
designed, and a table: each standard deviation by the parameter's size ([as here](reading-the-dynamics.md)) now, with
the best simple change, and with the designed movement. Where nothing takes a fifth off, it says so.

## How it is foreseen

Chain, parameters, noise and skin are those of the trial; the regressor is set up anew for the other movement
(`dynamics.foresight`). What the residuals contribute follows (XᵀX)⁻¹ over as many seconds as would be fitted; what
joints and skin contribute is carried through the fit anew, with skin that slides in proportion to the angles and joints
that would be found from the other movement's own postures (`kinematics.skin_foreseen`); the plate's zero stays. All of
it is in proportion to what the same computation says of the trial's own movement, so that this one is foreseen
exactly as it was found. The `helps` of a trial's summary come from the same computation with the geometry as it is.

## What is looked at

- the whole movement, or one joint, 1.5 times faster or larger;
- each joint by itself, at five frequencies from 0.2 to 1 Hz, as far as the limits allow: the whole recording with one
  joint, half of it (beside the trial's own movement) with several;
- one joint after the other;
- all joints together: a wave each with an amplitude, a middle and a frequency of its own, for robots with an overtone;
  20 starts from a seed and the three best simple ones, then 60 small steps; with several joints for the whole of the
  recording, or half of it.

Where a chair takes part the recording is not shared with another movement.

People have to keep their balance, and nobody swings three joints at will. For all protocols but `robot-joint` the first
joint therefore gives way so that the posture's centre of pressure is where it is asked to be, and what is chosen is how
far knees and hips swing and how far the person sways. Movements begin and end at rest, grow and fade over 1.5 s.

What is to become small (`--for`): `intervals`, the root mean square of the standard deviations by the parameters'
sizes (A-optimal); `volume`, their joint interval (D-optimal); `condition` or `condition-scaled`. The plate's zero does
not count, as no movement changes it.

## Limits

| | default | instead |
|---|---|---|
| angles | as seen of each joint, 5° more at both ends; 20° for a robot | `--widen`, `--angle JOINT=LOW:HIGH` |
| speed | 1.5 times the fastest, at least 90°/s; a person 200°/s unless more was seen | `--speed` |
| acceleration | 2.25 times the largest, at least 360°/s²; a person 800°/s² unless more was seen | `--acceleration` |
| centre of pressure | as seen off the chair, 3 cm more at both ends; a robot is bolted down | `--support` |
| length | the trial's | `--seconds` |

Angles count as in `states.parquet`, in degrees. The limits hold by the model, sample by sample, for the movement as it
is told, in whole degrees, half centimetres and hundredths of a hertz, the centre of pressure with one standard
deviation of what is known of it. The program knows nothing of what a person's joints, a robot's cell or a plate can
bear: say so with the options. A robot's angles in `movement.csv` count as in `states.parquet`; its own zero and sense
may differ.

## Does it keep its promise?

Generated by `python benchmarks/excitation.py --write docs/excitation.md` from {bodies} fresh bodies of each kind (seeds
from {first} up; none was used for tuning):

{kinds}

Each makes that movement in a simulated recording (skin, drop-outs, cameras and plate with noise), which goes through
the whole pipeline; `advise` looks at the run; the same body then does the best simple change that is not its own
movement, and the designed movement, each in another simulated recording, which goes through the whole pipeline too.
Nothing of the truth reaches the advice. Recordings that could not be advised on: {lost}.

**Foreseen by achieved**: median and range over the recordings; of the standard deviations without that of the mass
and of a robot's `mx1`, which the plate's zero holds.

{foresight}

**What it brought**: medians; errors are rms against the truth, by the parameter's size, of the same parameters.

{gains}

**Weak parameters**: those that were not `known`; of them those that the advice promised to be, and those that then
were.

{promises}

Something within the limits was said to help in {helped}. Where nothing helps the
movements above were carried out all the same, to see whether that was foreseen rightly. A person's true centre of
pressure left the limits in {balance}; recordings that are shared with the trial's own movement, which
the simulated body breaks off within two seconds, do not count here.

The first bodies were told:

{examples}

What it cannot foresee: how a person carries the instruction out, and the residuals of a movement that is much
larger than the trial's, which are taken as they are. A standard deviation that rests on few blocks of a second is
itself off by some tens of per cent, in the trial that the advice starts from and in the one that follows.
"""


def achieved(results: Sequence[Result]) -> Iterator[tuple[Result, str, Proposal, Recorded]]:
    """Every movement that was carried out and identified from."""
    for result in results:
        for name, (proposal, came) in result.told.items():
            if isinstance(came, Recorded):
                yield result, name, proposal, came


def spread(values: FloatArray, form: str = "{:.2f}") -> str:
    """Median and range."""
    return (
        "–" if not len(values) else f"{form} ({form} to {form})".format(np.median(values), values.min(), values.max())
    )


def moved(result: Result) -> BoolArray:
    """Parameters (b,) whose deviation a movement can change: the plate's zero holds the mass, and a robot's mx1."""
    return np.arange(len(result.names)) > (1 if result.case.kind == "robot" else 0)


def foresight_table(results: Sequence[Result]) -> str:
    """Foreseen by achieved, of condition numbers and standard deviations."""
    head = [
        "body",
        "movement",
        "recordings",
        "condition number",
        "standard deviations",
        "of them within a factor of 1.5",
    ]
    rows = []
    for kind in KINDS:
        for name in ("designed", "simple"):
            own = [(r, p, c) for r, told, p, c in achieved(results) if r.case.kind == kind and told == name]
            conditions = np.array([p.foreseen.condition / c.condition for _, p, c in own])
            ratios = np.concatenate([np.zeros(0), *((p.foreseen.sd / c.sd)[moved(r)] for r, p, c in own)])
            near = f"{100 * np.mean(np.abs(np.log(ratios)) <= np.log(1.5)):.0f} %" if len(ratios) else "–"
            rows.append([kind, name, str(len(own)), spread(conditions, "{:.3f}"), spread(ratios), near])
    return markdown(head, rows)


def gain_table(results: Sequence[Result]) -> str:
    """Before and after: condition number, deviations, and errors against the truth."""
    head = [
        "body",
        "movement",
        "condition number",
        "sd by size, %",
        "error by size, %",
        "largest sd by size, %",
        "truth inside 95 %",
    ]
    rows = []
    for kind in KINDS:
        own = [r for r in results if r.case.kind == kind]
        groups = {"as it was": [(r, r.before) for r in own]}
        for name in ("simple", "designed"):
            groups[name] = [(r, c) for r, told, _, c in achieved(own) if told == name]
        for name, pairs in groups.items():
            if pairs:
                sd = np.array([(c.sd / r.size)[moved(r)] for r, c in pairs])
                error = np.array([((c.value - c.true) / r.size)[moved(r)] for r, c in pairs])
                inside = np.abs(error) <= 1.96 * sd
                shown = [f"{np.median([c.condition for _, c in pairs]):.3g}", f"{100 * np.median(sd):.2g}"]
                shown += [f"{100 * np.sqrt(np.mean(error**2)):.2g}", f"{100 * np.median(sd.max(axis=1)):.2g}"]
                rows.append([kind, name, *shown, f"{100 * inside.mean():.0f} %"])
    return markdown(head, rows)


def promise_table(results: Sequence[Result]) -> str:
    """Parameters that were not known, and what the advice promised and came to."""
    head = [
        "body",
        "movement",
        "not known before",
        "promised to be known",
        "known",
        "not known: promise broken",
        "recordings without parameters",
    ]
    rows = []
    for kind in KINDS:
        for name in ("designed", "simple"):
            own = [r for r in results if r.case.kind == kind and name in r.told]
            failed = [r for r in own if not isinstance(r.told[name][1], Recorded)]
            weak = promised = kept = 0
            for r, told, proposal, came in achieved(own):
                if told != name:
                    continue
                doubtful = [i for i, sd in enumerate(r.before.sd / r.size) if standing(float(sd)) != "known"]
                sure = [i for i in doubtful if standing(float(proposal.foreseen.sd[i] / r.size[i])) == "known"]
                weak, promised = weak + len(doubtful), promised + len(sure)
                kept += sum(standing(float(came.sd[i] / r.size[i])) == "known" for i in sure)
            rows.append([kind, name, str(weak), str(promised), str(kept), str(promised - kept), str(len(failed))])
    return markdown(head, rows)


def balance(results: Sequence[Result]) -> str:
    """How far the true centre of pressure leaves the limits, where the recording holds nothing but what was advised."""
    beyond = [
        1e3 * max(r.support[0] - c.pressure[0], c.pressure[1] - r.support[1], 0.0)
        for r, _, p, c in achieved(results)
        if r.support is not None and p.made
    ]
    outside = sum(value > 0 for value in beyond)
    return f"{outside} of {len(beyond)}, by {max(beyond, default=0.0):.0f} mm at most"


def examples(results: Sequence[Result]) -> str:
    """What the first body of each kind is told."""
    told = []
    for kind in KINDS:
        first = next((r for r in results if r.case.kind == kind), None)
        for name, (proposal, came) in ({} if first is None else first.told).items():
            assert first is not None
            after = f"{came.condition:.0f}" if isinstance(came, Recorded) else str(came)
            told.append(
                f"- *{kind}*, {name}: {proposal.words}. Condition number {first.before.condition:.0f}, foreseen "
                f"{proposal.foreseen.condition:.0f}, achieved {after}."
            )
    return "\n".join(told)


def main() -> None:
    """Measure, print and perhaps write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--bodies", type=int, default=5, help="of each kind")
    parser.add_argument("--first", type=int, default=FRESH, help="first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--write", type=Path, help="page to replace")
    arguments = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for the processes: as many threads as cores each would get in the way
    cases = [Case(kind, arguments.first + 10 * k) for kind in KINDS for k in range(arguments.bodies)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        found = list(pool.map(measure, cases))
    lost = [each for each in found if isinstance(each, str)]
    results = [each for each in found if isinstance(each, Result)]
    text = TEXT.format(
        bodies=arguments.bodies,
        first=arguments.first,
        kinds="\n".join(f"- *{kind}*: {told}" for kind, told in KINDS.items()),
        foresight=foresight_table(results),
        gains=gain_table(results),
        promises=promise_table(results),
        balance=balance(results),
        helped=", ".join(
            f"{sum(r.helps for r in results if r.case.kind == kind)} of "
            f"{sum(r.case.kind == kind for r in results)} ({kind})"
            for kind in KINDS
        ),
        lost="; ".join(lost) if lost else "none",
        examples=examples(results),
    )
    sys.stdout.write(text)
    if arguments.write:
        arguments.write.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
