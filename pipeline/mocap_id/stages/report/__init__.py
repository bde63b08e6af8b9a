"""Settings and record of the stage report, which writes verdict and numbers of a trial for people and programs."""

from __future__ import annotations

from pydantic import Field

from mocap_id.reporting.contents import FILES, PdfFonts
from mocap_id.stages import STAGE_HELP
from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store.provenance import SCHEMAS


class ReportSettings(Settings):
    """Settings of the files with figures."""

    figures: bool = Field(False, description="also write the figures as SVG and PDF, like `mocap-id figures`")
    pdf_fonts: PdfFonts = Field("type-3", description="fonts in the PDF figures; some journals require truetype")


def _function(context: Context) -> Outputs:
    from mocap_id.stages.report.function import report  # noqa: PLC0415  loads its libraries only when run

    return report(context)


STAGE = Stage(
    name="report",
    version=11,
    inputs=tuple(SCHEMAS),
    outputs=FILES,
    uses=tuple(TrialKeys.model_fields),
    settings=ReportSettings,
    function=_function,
    help=STAGE_HELP["report"],
)
