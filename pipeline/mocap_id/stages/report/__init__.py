"""``report``: the verdict and the numbers of a trial, for people and for other programs."""

from __future__ import annotations

from pydantic import Field

from mocap_id.reporting.contents import FILES, PdfFonts
from mocap_id.stages.base import Context, Outputs, Settings, Stage, TrialKeys
from mocap_id.stages.lineup import LINEUP
from mocap_id.store.schemas import SCHEMAS


class ReportSettings(Settings):
    """Figures for papers; what they show is not to be set."""

    figures: bool = Field(False, description="write the figures as SVG and PDF too, as `mocap-id figures` does later")
    pdf_fonts: PdfFonts = Field(
        "type-3", description="letters of the PDF figures: drawn (type-3), or truetype as some journals ask"
    )


def _function(context: Context) -> Outputs:
    from mocap_id.stages.report.function import report  # noqa: PLC0415  whoever runs it loads its libraries

    return report(context)


STAGE = Stage(
    name="report",
    version=7,
    inputs=tuple(SCHEMAS),
    outputs=FILES,
    uses=tuple(TrialKeys.model_fields),
    settings=ReportSettings,
    function=_function,
    help=LINEUP["report"],
)
