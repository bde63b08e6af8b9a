"""Stage report: writes verdict and numbers of a trial for people and programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from mocap_id import __version__
from mocap_id.reporting import FILES, PdfFonts
from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.trial_keys import BalanceBoard, StaticTrial, TrialKeys, list_sensors
from mocap_id.store.provenance import SCHEMAS
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.reporting.report_data import ReportData


class ReportSettings(Settings):
    """Settings of the files with figures."""

    figures: bool = Field(False, description="also write the figures as SVG and PDF, like `mocap-id figures`")
    pdf_fonts: PdfFonts = Field("type-3", description="fonts in the PDF figures; some journals require truetype")


def report(context: Context) -> Outputs:
    """Return the summary and the page of a trial, and its figures if the settings request them.

    For a refused trial (``context.refused``), these documents are made from the existing artefacts.
    """
    from mocap_id.reporting.report import make_documents  # noqa: PLC0415  loads its libraries only when run

    settings = context.settings
    return make_documents(report_data(context), figures=settings.figures, pdf_fonts=settings.pdf_fonts)


def report_data(context: Context) -> ReportData:
    """Return the artefacts, settings and refusal from which the report is made."""
    from mocap_id.reporting.report_data import ReportData  # noqa: PLC0415  loads its libraries only when run

    refused, trial = context.refused, context.trial
    refusal = None
    if refused is not None:
        refusal = Reason(refused.code, refused.message, refused.value, refused.limit, "refused")
    # the keys of the trial that are not empty; file names are without folders
    forces = None if trial.recording is None else trial.recording.forces
    forces = forces.balance_board if isinstance(forces, BalanceBoard) else forces
    worn = [sensor.file for sensor in list_sensors(trial.imus).values()]
    motion = worn if trial.recording is None else (trial.recording.motion,)
    files = [path.name for path in (*motion, forces) if path is not None]
    subject = trial.subject.model_dump(exclude_none=True)
    plates = trial.plates.model_dump(exclude_defaults=True)
    texts = {
        "recording": ", ".join(files),
        "protocol": trial.protocol,
        "space": "" if trial.space == "plane" else trial.space,
        "side": trial.side or "",
        "landmarks": ", ".join(f"{name} {label}" for name, label in trial.landmarks.items()),
        "pointers": ", ".join(f"{name} {file.name}" for name, file in trial.pointers.items()),
        "static": trial.static.trial.name
        if isinstance(trial.static, StaticTrial)
        else "".join(f"{first:g} to {last:g} s" for first, last in filter(None, [trial.static])),
        "calibration": "" if trial.calibration is None else trial.calibration.trial.name,
        "subject": ", ".join(f"{key} {value}" for key, value in subject.items()),
        "window": "" if trial.window is None else f"{trial.window[0]:g} to {trial.window[1]:g} s",
        "plates": ", ".join(f"{use} {' '.join(map(str, numbers))}" for use, numbers in plates.items()),
        "compare": "" if trial.compare is None else trial.compare.angles.name,
        "encoder": "" if trial.encoder is None else trial.encoder.name,
    }
    return ReportData(
        trial=trial.trial,
        product=__version__,
        artefacts=context.inputs,
        refusal=refusal,
        seconds=context.seconds,
        settings={key: value for key, value in texts.items() if value},
    )


STAGE = Stage(
    name="report",
    version=11,
    inputs=tuple(SCHEMAS),
    outputs=FILES,
    uses=tuple(TrialKeys.model_fields),
    settings=ReportSettings,
    function=report,
    help=STAGE_HELP["report"],
)
