"""Explanations of the exit codes: what happened, what was written and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id import errors


@dataclass(frozen=True)
class ExitCode:
    """Explanation of one exit code.

    Parameters
    ----------
    error : type of MocapIdError or None
        Exception behind the code; None if there is none.
    title : str
        Headline.
    meaning : str
        Meaning, and what was written.
    action : str
        What to do.
    """

    error: type[errors.MocapIdError] | None
    title: str
    meaning: str
    action: str

    @property
    def name(self) -> str | None:
        """Class name of the error."""
        return None if self.error is None else self.error.__name__


_INTERRUPTED = (
    "No file is half-written. The finished stages are kept; the interrupted stage left nothing.",
    "Run the same command again to continue.",
)
EXIT_CODES: Mapping[int, ExitCode] = {
    0: ExitCode(
        None,
        "Success",
        "The command finished. The verdict of a trial is `ok` or `caution`: exit code 0 does not mean that the numbers "
        "are good.",
        "Read the verdict.",
    ),
    1: ExitCode(
        errors.MocapIdError,
        "Finished with problems",
        "`study`, `batch`: a trial failed or was refused; the others are done. `regress`: a number changed. `doctor`: "
        "something that mocap-id needs is missing or broken.",
        "See the messages for what is affected; all other results are valid.",
    ),
    2: ExitCode(
        errors.ConfigError,
        "Invalid command line or configuration",
        "A key, a value, an option or a name is not valid. Nothing was computed or written.",
        "The message names the file, line and key, the expected value and the nearest valid name. `mocap-id COMMAND "
        "--help` lists the options, docs/settings.md the settings.",
    ),
    3: ExitCode(
        errors.RecordingError,
        "An input file is missing, unreadable or inconsistent",
        "A recording, a force file or an encoder file could not be read in the expected format. Nothing was written.",
        "The message names the file and the problem. `mocap-id inspect FILE` shows the contents. Export the file "
        "again, or configure what it does not state (`planarise: {units: …, vertical: …}`).",
    ),
    4: ExitCode(
        errors.Refused,
        "Refused",
        "The motion is not that of a planar serial chain on a fixed base, or no joint moves enough. summary.json and "
        "report.html give the reason, and the artefacts of the earlier stages are kept. This is a finding, not a "
        "failure.",
        "Read the reason in the verdict. It says what to record, or which part of the recording to use.",
    ),
    5: ExitCode(
        errors.NumericalError,
        "A computation failed",
        "A computation did not converge, or failed unexpectedly, on input that passed all checks. The artefacts of the "
        "earlier stages are kept.",
        "Check the skeleton and the units first. An unexpected failure leaves `failure.log` in the run folder: please "
        "report it.",
    ),
    6: ExitCode(
        errors.StoreError,
        "An artefact or the output folder cannot be used",
        "The artefact is missing, stale or damaged; the folder is locked by another run, full or not writable; or "
        "another file has the name of an output. No file is half-written.",
        "The message names the file and what to do: run the earlier stage, free disk space, change permissions, choose "
        "another folder, or use --force if the command has it.",
    ),
    130: ExitCode(None, "Interrupted by Ctrl-C", *_INTERRUPTED),
    143: ExitCode(None, "Interrupted by SIGTERM", *_INTERRUPTED),
}
"""Explanation of every exit code of every command."""
