"""Tables of ``benchmarks/claims.py``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from harness import markdown

from mocap_id.workflows.sensitivity.kinds import JOINTS, KINDS, Kind
from mocap_id.workflows.sensitivity.runs import PerturbationRun


def claims_table(answers: Sequence[tuple[Any, Mapping[str, tuple[bool, Any]]]], counts: Mapping[str, int]) -> str:
    """Return every claim with the result of every group of trials."""
    head = ("", "the thesis (5.5.2)", "confirmed by", *(f"{name} ({count})" for name, count in counts.items()))
    rows = [
        (claim.letter, claim.text, claim.limit, *(_cell(claim.letter, *found[name]) for name in counts))
        for claim, found in answers
    ]
    return markdown(head, rows)


def _cell(letter: str, holds: bool, said: Any) -> str:
    about = f" ({said.about})" if said.about else ""
    lost = "no states left" if letter == "a" else "nothing identified"
    return (
        f"{'confirmed' if holds else '**refuted**'}: {lost if math.isinf(said.value) else _number(said.value)}{about}"
    )


def _number(value: float) -> str:
    return "< 0.001 %" if value < 1e-3 else f"{float(f'{value:.2g}'):g} %"


def kind_table() -> str:
    """Return the kinds of perturbations."""
    worse = {"more": "", "less": "; fewer is worse", "either": ""}
    rows = [
        (
            f"`{kind.name}`",
            ", ".join(f"{level:g}" for level in kind.levels) + worse[kind.worse],
            kind.unit.replace("*", "·") or "–",
            _targets(kind),
            f"`{kind.entry}`",
        )
        for kind in KINDS.values()
    ]
    return markdown(("kind", "levels", "unit", "on", "enters"), rows)


def _targets(kind: Kind) -> str:
    if kind.targets == JOINTS:
        return "all joints; each on request" if kind.usual else "each joint and all"
    return ", ".join(kind.targets) or "–"


def tolerance_list(name: str, sentences: Sequence[str], runs: Sequence[PerturbationRun]) -> str:
    """Return what a trial tolerates."""
    lines = "\n".join(f"- {sentence[:1].upper()}{sentence[1:]}" for sentence in sentences)
    return f"**{name}**, {len(runs)} perturbations:\n\n{lines}"


def cost_table(runs: Sequence[PerturbationRun]) -> str:
    """Return the time of each kind of perturbation."""
    rows = []
    for kind in dict.fromkeys(one.perturbation.kind for one in runs):
        spent = [one.seconds for one in runs if one.perturbation.kind == kind]
        rows.append((f"`{kind}`", str(len(spent)), f"{np.median(spent):.2f}", f"{sum(spent):.1f}"))
    return markdown(("kind", "perturbations", "s each (median)", "s in all"), rows)
