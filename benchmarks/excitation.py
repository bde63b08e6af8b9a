"""Advised movements compared with their prediction, on simulated bodies.

A body makes a movement that determines little. ``mocap-id advise`` suggests another one. The same body makes it in a
new simulated recording, which goes through the whole pipeline. About fifteen seconds per body and core.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from excitation_bodies import KINDS, Case, Recorded, Result, measure
from harness import QUANTILE, command_line, markdown, measured_by, publish, run_all

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.design.proposal import Proposal
from mocap_id.dynamics.excitation import classify


def achieved(results: Sequence[Result]) -> Iterator[tuple[Result, str, Proposal, Recorded]]:
    """Yield every movement that was carried out and identified."""
    for result in results:
        for name, (proposal, came) in result.advised.items():
            if isinstance(came, Recorded):
                yield result, name, proposal, came


def spread(values: FloatArray, form: str = "{:.2f}") -> str:
    """Return median and range."""
    if not len(values):
        return "–"
    return f"{form} ({form} to {form})".format(np.median(values), values.min(), values.max())


def moved(result: Result) -> BoolArray:
    """Return which parameters (b,) a movement can improve: not the mass, nor a robot's mx1."""
    return np.arange(len(result.names)) > (1 if result.case.kind == "robot" else 0)


def prediction_table(results: Sequence[Result]) -> str:
    """Return predicted divided by achieved condition numbers and standard deviations."""
    head = ["body", "movement", "recordings", "condition number", "standard deviations"]
    head.append("of them within a factor of 1.5")
    rows = []
    for kind in KINDS:
        for name in ("designed", "simple"):
            own = [(r, p, c) for r, movement, p, c in achieved(results) if r.case.kind == kind and movement == name]
            conditions = np.array([p.predicted.condition / c.condition for _, p, c in own])
            ratios = np.concatenate([np.zeros(0), *((p.predicted.sd / c.sd)[moved(r)] for r, p, c in own)])
            near = f"{100 * np.mean(np.abs(np.log(ratios)) <= np.log(1.5)):.0f} %" if len(ratios) else "–"
            rows.append([kind, name, str(len(own)), spread(conditions, "{:.3f}"), spread(ratios), near])
    return markdown(head, rows)


def gain_table(results: Sequence[Result]) -> str:
    """Return condition number, standard deviations and errors, before and after."""
    head = ["body", "movement", "condition number", "sd by size, %", "error by size, %", "largest sd by size, %"]
    head.append("truth inside 95 %")
    rows = []
    for kind in KINDS:
        own = [r for r in results if r.case.kind == kind]
        groups = {"unchanged": [(r, r.before) for r in own]}
        for name in ("simple", "designed"):
            groups[name] = [(r, c) for r, movement, _, c in achieved(own) if movement == name]
        for name, pairs in groups.items():
            if pairs:
                sd = np.array([(c.sd / r.size)[moved(r)] for r, c in pairs])
                error = np.array([((c.value - c.true) / r.size)[moved(r)] for r, c in pairs])
                inside = np.abs(error) <= QUANTILE * sd
                shown = [f"{np.median([c.condition for _, c in pairs]):.3g}", f"{100 * np.median(sd):.2g}"]
                shown += [f"{100 * np.sqrt(np.mean(error**2)):.2g}", f"{100 * np.median(sd.max(axis=1)):.2g}"]
                rows.append([kind, name, *shown, f"{100 * inside.mean():.0f} %"])
    return markdown(head, rows)


def promise_table(results: Sequence[Result]) -> str:
    """Return the number of parameters that were not known, were predicted to be known, and are known."""
    head = ["body", "movement", "not known before", "predicted to be known", "known", "predicted, but not known"]
    head.append("recordings without parameters")
    rows = []
    for kind in KINDS:
        for name in ("designed", "simple"):
            own = [r for r in results if r.case.kind == kind and name in r.advised]
            failed = [r for r in own if not isinstance(r.advised[name][1], Recorded)]
            weak = promised = kept = 0
            for r, movement, proposal, came in achieved(own):
                if movement != name:
                    continue
                doubtful = [i for i, sd in enumerate(r.before.sd / r.size) if classify(float(sd)) != "known"]
                sure = [i for i in doubtful if classify(float(proposal.predicted.sd[i] / r.size[i])) == "known"]
                weak, promised = weak + len(doubtful), promised + len(sure)
                kept += sum(classify(float(came.sd[i] / r.size[i])) == "known" for i in sure)
            rows.append([kind, name, str(weak), str(promised), str(kept), str(promised - kept), str(len(failed))])
    return markdown(head, rows)


def balance(results: Sequence[Result]) -> str:
    """Return how far the true centre of pressure leaves the limits, in recordings of the advised movement only."""
    beyond = [
        1e3 * max(r.support[0] - c.pressure[0], c.pressure[1] - r.support[1], 0.0)
        for r, _, p, c in achieved(results)
        if r.support is not None and p.standalone
    ]
    outside = sum(value > 0 for value in beyond)
    return f"{outside} of {len(beyond)} recordings, by {max(beyond, default=0.0):.0f} mm at most"


def examples(results: Sequence[Result]) -> str:
    """Return the advice to the first body of each kind."""
    lines = []
    for kind in KINDS:
        first = next((r for r in results if r.case.kind == kind), None)
        for name, (proposal, came) in ({} if first is None else first.advised).items():
            assert first is not None
            after = f"{came.condition:.0f}" if isinstance(came, Recorded) else str(came)
            lines.append(
                f"- *{kind}*, {name}: {proposal.words}. Condition number {first.before.condition:.0f}, predicted "
                f"{proposal.predicted.condition:.0f}, achieved {after}."
            )
    return "\n".join(lines)


def main() -> None:
    """Measure all bodies."""
    arguments = command_line(__doc__, parallel=True, bodies=5, first=960_000).parse_args()
    cases = [Case(kind, arguments.first + 10 * k) for kind in KINDS for k in range(arguments.bodies)]
    found = run_all(measure, cases, arguments.jobs)
    lost = "; ".join(each for each in found if isinstance(each, str)) or "none"
    results = [each for each in found if isinstance(each, Result)]
    helped = [
        f"{sum(r.helps for r in own)} of {len(own)} ({kind})"
        for kind in KINDS
        for own in [[r for r in results if r.case.kind == kind]]
    ]
    sections = {
        "excitation": measured_by(
            __file__, f"{arguments.bodies} simulated bodies of each kind, seeds from {arguments.first}"
        )
        + f" Recordings without advice: {lost}.",
        "excitation-predictions": prediction_table(results),
        "excitation-gains": gain_table(results),
        "excitation-promises": promise_table(results),
        "excitation-helped": f"Something within the limits was predicted to help in {', '.join(helped)} trials. A "
        f"person's true centre of pressure left the limits in {balance(results)}.",
        "excitation-examples": examples(results),
    }
    publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
