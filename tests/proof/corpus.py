"""The cases of the proof: commands of the program, each in a folder of its own.

``{samples}``, ``{recordings}``, ``{configs}`` stand for folders of the source tree and of the shared recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

FIVE_SAMPLES = ("sit-to-stand", "robot-joint", "arm-reach", "curl", "curl-assisted")
SHORT = "--repetitions 3 --rate 50 --analog-rate 500"

# Every option and every fault of the simulated people, each once.
PEOPLE = (
    "", "--strategy dynamic", "--strategy stable", "--rate 200", "--marker-noise 0.002", "--soft-tissue 2",
    "--occlusions 3", "--jumps 10", "--plate-sense action", "--plate-moved", "--plate-origin-flipped",
    "--plate-noise 5", "--plate-bias 1", "--clock-offset 0.02", "--clock-offset 0.4", "--board", "--imus",
    "--seat-plate", "--seat-plate --chair-mass 6", "--attempts 2", "--hold 1", "--rail 0.1", "--rest-before 10",
    "--rest-standing 10",
    "--rest-after 10", "--marker-set plug-in-gait", "--marker-set plug-in-gait-without-wands", "--marker-set joints",
    "--marker-set plug-in-gait --knee-on-shank", "--marker-set plug-in-gait --without KNE", "--without LKNE",
    "--people hip_gap_mm=10", "--people lumbar_deg=15", "--people arm_swing_deg=40", "--people heel_lift_mm=20",
    "--people held_mass_kg=11", "--faults frozen_s=2", "--faults ghost_walks=1", "--faults ghost_reflects=1",
    "--faults reattached_mm=30", "--faults mislabelled_s=1", "--faults wander_mm=2", "--faults wobble_mm=2",
    "--faults filter_hz=6", "--faults repeated_share=0.5", "--faults camera_scale=1.03", "--faults tilt_deg=2",
    "--faults rate_error=0.05", "--faults gain=1.05", "--faults gain_fz=1.05", "--faults gain_moments=1.05",
    "--faults offset_fz_N=30", "--faults corners_mm=30", "--faults foot_slide_mm=20", "--faults foot_moves_mm=40",
    "--faults turn_deg=15", "--faults plane_tilt_deg=5",
)  # fmt: skip
ROBOTS = (
    "", "--joint shoulder", "--joint elbow --speed slow", "--joint wrist --orientation 45",
    "--joint elbow --joint-sensor",
)  # fmt: skip
ARMS = (
    "", "--preset clean", "--preset hard", "--side left", "--severity 0.8", "--imus", "--skeleton", "--anonymous",
    "--movement curl", "--movement curl --failed 2", "--movement curl --condition 5",
)  # fmt: skip
RECORDED = {
    "sts": "run {recordings}/sit-to-stand/STS1.trc --forces {recordings}/sit-to-stand/STS1_grf.mot "
    "--protocol sit-to-stand",
    "squats": "run {recordings}/sit-to-stand/squats1.trc --forces {recordings}/sit-to-stand/squats1_grf.mot "
    "--protocol sit-to-stand",
    "static": "run {recordings}/sit-to-stand/static1.trc --protocol free",
    "lift": "run {recordings}/lifting/S1.trc --forces {recordings}/lifting/S1_grf.mot --protocol free",
    "lift-motive": "run {recordings}/lifting/S4_markers.csv --protocol free",
    "walk": "run {recordings}/gait/walking1.trc --protocol free",
    "reach": "run {recordings}/upper-limb/ulema/RF1.c3d --protocol reach --side left",
    "type-2": "run {recordings}/c3d/TYPE-2.C3D --protocol free",
    "guess": "run {recordings}/c3d/sample_propulsion.c3d",
}
STUDIES = {
    "cohort": ("simulate cohort made --subjects 2", "study made/study.yaml --out out"),
    "reaches": ("simulate reach-cohort made --subjects 2", "study made/study.yaml --out out"),
    "curls": ("simulate curl-study made --subjects 1 --trials 1 --conditions C,5", "study made/study.yaml --out out"),
    "robots": ("validate robot --out out --repetitions 1",),
    "sensitivity": ("sensitivity {samples}/sit-to-stand/trial.yaml --out out --jobs 1",),
    "batch": ("batch {samples}/sit-to-stand/trial.yaml {samples}/robot-joint/trial.yaml --out out",),
}  # fmt: skip
ERRORS = (
    "run missing.yaml", "run missing.c3d", "run {configs}/no-such.yaml", "run", "no-such-command",
    "explain no-such-code", "inspect {samples}/README.md", "export missing --to tables", "status missing",
    "clean missing", "compare a b", "run {recordings}/c3d/Empty.c3d", "run {recordings}/c3d/badParameterOffset.c3d",
    "prescribe missing.yaml", "workspace missing.yaml", "pneumatic curve missing.yaml", "study missing.yaml",
    "transfer missing",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Commands that run one after another in an empty folder; all files and all printed text are compared."""

    name: str
    commands: tuple[str, ...]
    small: bool = False  # whether the case belongs to the small part, which CI runs


def list_cases(commands: tuple[str, ...]) -> Iterator[Case]:
    """Yield all cases; ``commands`` are the names of the program's commands, for their help."""
    for name in FIVE_SAMPLES:
        yield Case(f"sample/{name}", (f"run {{samples}}/{name}/trial.yaml -q",), small=name != "curl-assisted")
    for kind, prefix, options in (
        ("person", f"simulate sit-to-stand made {SHORT}", PEOPLE),
        ("robot", f"simulate robot made {SHORT}", ROBOTS),
        ("arm", "simulate arm made", ARMS),
        ("chain", "simulate chain made", ("",)),
        ("robot-in-space", "simulate robot-in-space made", ("",)),
    ):
        for seed, option in enumerate(options, start=1):
            name = option.replace("--", "").replace(" ", "_") or "plain"
            yield Case(f"{kind}/{name}", (f"{prefix} --seed {seed} {option}", "run made/trial.yaml -q"))
    for name, command in RECORDED.items():
        yield Case(f"recorded/{name}", (command,))
    for name, commands_of_study in STUDIES.items():
        yield Case(f"study/{name}", commands_of_study)
    once = "run {samples}/sit-to-stand/trial.yaml -q"
    person = "{samples}/sit-to-stand/runs/sit-to-stand"
    finished = {
        "status": f"status {person}",
        "export": f"export {person} --out out",
        "figures": f"figures {person} --out out",
        "transfer": f"transfer {person} {person}",
        "advise": f"advise {person}",
        "inspect": "inspect {samples}/sit-to-stand/trial.c3d --json",
        "compare": f"compare {person} {person}",
        "workspace": "workspace {samples}/sit-to-stand/trial.yaml --out out",
        "chain": "workspace {configs}/chains/isb-arm.yaml --out out",
        "explain": "explain no-chain",
        "stages": "stages",
        "schema": "schema",
        "regress": "regress {samples}/sit-to-stand --baseline {samples}/baseline.json",
        "prescribe": "prescribe {configs}/prescriptions/elbow.yaml --out out",
        "pneumatic": "pneumatic curve {configs}/devices/elbow.yaml --json",
    }
    for name, command in finished.items():
        yield Case(f"command/{name}", (once, command))
    for number, command in enumerate(ERRORS):
        yield Case(f"error/{number}-{command.split()[0]}", (command,), small=True)
    for name in itertools.chain(("",), commands):
        yield Case(f"help/{name or 'program'}", (f"{name} --help".strip(),), small=True)
