"""The stages in their order, each with its one line for the command line and the docs.

Each stands after the stages whose outputs it reads; the last one is the report: when a stage refuses a trial, the
report is made of what exists. Everything that is made from the stages comes from here: commands, Makefile rules,
settings, documentation. A stage called ``fit-joints`` is ``STAGE`` in ``fit_joints.py``.
"""

from __future__ import annotations

LINEUP = {
    "planarise": "Read the recording and express markers and ground forces in the plane of motion.",
    "segment": "Sort the markers into a fixed base and the segments of a chain.",
    "fit-joints": "Fit joint centres, marker coordinates and segment lengths together.",
    "ukf-smooth": "Estimate joint angles, velocities and accelerations with their uncertainty.",
    "identify-dim": "Identify the inertial parameters from joint angles and the wrench of the ground.",
    "report": "Write the verdict, the figures and the page from the artefacts of the stages before.",
}
