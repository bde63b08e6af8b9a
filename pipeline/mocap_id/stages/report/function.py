"""``report``: the verdict and the numbers of a trial, for people and for other programs."""

from __future__ import annotations

from mocap_id import __version__
from mocap_id.reporting.material import Material
from mocap_id.stages.base import Context, Outputs, TrialKeys
from mocap_id.verdict import Reason


def report(context: Context) -> Outputs:
    """Write summary and page from whatever artefacts exist, and figures for papers where they are asked for.

    Parameters
    ----------
    context : Context
        All artefacts of a trial that went through; in a refused one (``context.refused``) those that there are.
    """
    from mocap_id.reporting.report import documents  # noqa: PLC0415  whoever asks for the material needs no template

    settings = context.settings
    return documents(material(context), figures=settings.figures, pdf_fonts=settings.pdf_fonts)


def material(context: Context) -> Material:
    """The trial as the report sees it."""
    refused = context.refused
    refusal = None
    if refused is not None:
        refusal = Reason(refused.code, refused.message, refused.value, refused.limit, "refused")
    return Material(
        trial=context.trial.trial,
        product=__version__,
        artefacts=context.inputs,
        refusal=refusal,
        seconds=context.seconds,
        settings=_asked_for(context.trial),
    )


def _asked_for(trial: TrialKeys) -> dict[str, str]:
    """The trial's own keys as they are shown: files without their folders."""
    files = [path.name for path in (trial.recording.markers, trial.recording.forces) if path is not None]
    subject = trial.subject.model_dump(exclude_none=True)
    plates = trial.plates.model_dump(exclude_defaults=True)
    asked = {
        "recording": ", ".join(files),
        "protocol": trial.protocol,
        "subject": ", ".join(f"{key} {value}" for key, value in subject.items()),
        "window": "" if trial.window is None else f"{trial.window[0]:g} to {trial.window[1]:g} s",
        "plates": ", ".join(f"{use} {' '.join(map(str, numbers))}" for use, numbers in plates.items()),
        "compare": "" if trial.compare is None else trial.compare.angles.name,
        "encoder": "" if trial.encoder is None else trial.encoder.name,
    }
    return {key: value for key, value in asked.items() if value}
