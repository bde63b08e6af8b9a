"""Inertial parameters for OpenSim, about each body's centre of mass, with their source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.workflows.run_folder import RunFolder

_WIDTH = len(PLANAR_PARAMETERS)
LEAST_MASS = 1e-9  # kg: OpenSim rejects a chain whose last body is massless
PLACEHOLDER = (1.0, 0.0, 0.0, 0.01)
"""m, mx, my, Izz of every segment if they are unknown: OpenSim rejects a chain without mass."""


@dataclass(frozen=True)
class BodyInertia:
    """Inertia of a planar body.

    Parameters
    ----------
    mass : float
        kg.
    centre : (float, float)
        Centre of mass in the segment's frame, m.
    inertia : float
        Moment of inertia about z through the centre of mass, kg·m².
    """

    mass: float
    centre: tuple[float, float]
    inertia: float


def about_centre(block: FloatArray) -> BodyInertia:
    """Convert m, mx, my, Izz about the origin (4,) to the centre of mass, with inertia Izz - (mx² + my²) / m.

    A physical body has m Izz ≥ mx² + my²; negative inertias, which rounding may cause, are set to zero.

    Examples
    --------
    >>> about_centre(np.array([2.0, 0.0, 1.0, 0.75]))
    BodyInertia(mass=2.0, centre=(0.0, 0.5), inertia=0.25)
    """
    mass, mx, my, inertia = (float(value) for value in block)
    if mass <= 0.0:
        return BodyInertia(LEAST_MASS, (0.0, 0.0), max(inertia, 0.0))
    return BodyInertia(mass, (mx / mass, my / mass), max(inertia - (mx * mx + my * my) / mass, 0.0))


@dataclass(frozen=True)
class Bodies:
    """Inertia of every segment, base first; whether it is known; and its source."""

    inertia: tuple[BodyInertia, ...]
    known: bool
    source: str


def bodies(run: RunFolder, count: int) -> Bodies:
    """Return the inertial parameters of a run's ``count`` segments: identified, else tabulated, else placeholders."""
    identified, reference = (_full(run, name, count) for name in ("value", "reference"))
    if np.isfinite(identified).all():
        chosen, source = identified, _identified(run)
    elif np.isfinite(reference).all():
        chosen, source = reference, _reference(run)
    else:
        source = (
            f"placeholders of {PLACEHOLDER[0]:g} kg a segment, which OpenSim needs to load a chain; none is identified "
            f"({run.why_missing('dynamics.h5')}). Use this model for kinematics only"
        )
        return Bodies((about_centre(np.array(PLACEHOLDER)),) * count, False, source)
    return Bodies(tuple(about_centre(block) for block in chosen.reshape(count, _WIDTH)), True, source)


def _full(run: RunFolder, name: str, count: int) -> FloatArray:
    tree = run.tree("dynamics.h5")
    if tree is None:
        return np.full(count * _WIDTH, np.nan)
    return tree.numbers(f"full/{name}")


def _identified(run: RunFolder) -> str:
    tree = run.tree("dynamics.h5")
    assert tree is not None
    verdicts, names = tree.texts("base/verdict"), tree.texts("base/name")
    facts = run.facts("dynamics.h5")
    table, motion = facts.get("reference_table"), facts.get("motion") or {}
    if motion.get("used"):
        return (
            f"those of {', '.join(motion['bodies'])}, identified on their measured poses and transferred to the chain "
            f"of pins. Parameters that the recording does not determine follow "
            f"{motion['prior'] if table is None else _table(run)}, so the mass of a single segment is not meaningful. "
            "Torques and modelled wrench of the run are those of the bodies, not of this chain"
        )
    rest = "one of the physically possible bodies" if table is None else _table(run)
    return (
        f"the {len(names)} base parameters ({_counted(verdicts)}) are identified; their division into m, mx, my "
        f"and Izz of the segments is not, and follows {rest}. Torques and ground wrench do not depend on it"
    )


def _counted(verdicts: Sequence[str]) -> str:
    return ", ".join(f"{verdicts.count(kind)} {kind}" for kind in dict.fromkeys(verdicts))


def _reference(run: RunFolder) -> str:
    why = run.facts("dynamics.h5").get("why") or "no wrench"
    return f"those of {_table(run)}, for the subject's height and mass; none is identified ({why})"


def _table(run: RunFolder) -> str:
    table = run.facts("dynamics.h5").get("reference_table")
    return "the allometric table" if table is None else f"the allometric table `{table}`"
