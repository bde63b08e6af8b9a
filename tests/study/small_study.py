"""A small study: one person, two strategies, and trials that cannot be computed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_id.recording.writer import write_c3d
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study import StudyResult
from mocap_id_simulation import Options, generate

NAME = "DoeJane"
"""What the person is called, in folder, file names and labels, and nowhere in what is made."""
SHORT = Options(seed=21, repetitions=2, analog_rate=100, occlusions=0)
STUDY = f"""\
study: small
defaults: {{protocol: sit-to-stand}}
subjects:
  s01: {{height: 1.628, landmarks_m: {{shank: 0.375, thigh: 0.418}}}}
trials:
  - {{trial: s01-normal-1, subject: s01, strategy: normal, recording: {NAME}/{NAME}-normal.c3d}}
  - {{trial: s01-gone, subject: s01, strategy: normal, recording: {NAME}/{NAME}-gone.c3d}}
  - {{trial: s01-broken, subject: s01, strategy: stable, recording: {NAME}/{NAME}-broken.c3d}}
  - {{trial: s01-dynamic-1, subject: s01, strategy: dynamic, recording: {NAME}/{NAME}-dynamic.c3d}}
  - {{trial: s01-refused, subject: s01, strategy: stable, recording: {NAME}/{NAME}-still.c3d}}
"""


@dataclass(frozen=True)
class Ran:
    """A study that has run once."""

    file: Path
    outcome: StudyResult
    told: tuple[TrialRun, ...]

    @property
    def folder(self) -> Path:
        return self.outcome.study.folder

    def copy(self, to: Path) -> Path:
        """All of it in another folder: its study file."""
        shutil.copytree(self.file.parent, to, dirs_exist_ok=True)
        return to / self.file.name


def record(folder: Path) -> None:
    """Recordings with the person's name wherever laboratories put it."""
    folder.mkdir()
    for strategy in ("normal", "dynamic"):
        made = generate("sit-to-stand", replace(SHORT, strategy=strategy))
        labels = [f"{NAME}:{label}" for label in made.scene.markers.labels]
        write_c3d(folder / f"{NAME}-{strategy}.c3d", labels, made.points, SHORT.rate, plates=(made.signals,))
    still = made.points[:60] * 0 + made.points[:1]
    write_c3d(folder / f"{NAME}-still.c3d", labels, still, SHORT.rate)
    whole = (folder / f"{NAME}-normal.c3d").read_bytes()
    (folder / f"{NAME}-broken.c3d").write_bytes(whole[: len(whole) // 2])
