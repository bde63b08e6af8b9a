"""Exit codes in plain words: what each means for what was written, and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id import errors


@dataclass(frozen=True)
class Exit:
    """An exit code in plain words.

    Parameters
    ----------
    error : type of MocapIdError or None
        What is raised; None where nothing is.
    title : str
        What happened, as a headline.
    meaning : str
        What it means, and what was written.
    action : str
        What to do.
    """

    error: type[errors.MocapIdError] | None
    title: str
    meaning: str
    action: str

    @property
    def name(self) -> str | None:
        """Of the error, as Python has it."""
        return None if self.error is None else self.error.__name__


_INTERRUPTED = (
    "Nothing is half-written: the stages that were finished stand, the one that was at work left no trace.",
    "The same command goes on from there.",
)
EXITS: Mapping[int, Exit] = {
    0: Exit(
        None,
        "Done",
        "The command did what it says. A trial's verdict is `ok` or `caution`: exit code 0 does not mean that the "
        "numbers are good.",
        "Read the verdict.",
    ),
    1: Exit(
        errors.MocapIdError,
        "Done, with something to look at",
        "`study`, `batch`: a trial failed or was refused; the others are done. `regress`: a number moved. `doctor`: "
        "something that mocap-id needs is missing or broken.",
        "Read which one it was; the rest stands.",
    ),
    2: Exit(
        errors.ConfigError,
        "The command line or a configuration is wrong",
        "A key, a value, an option or a name is not what is expected. Nothing was computed or written.",
        "The message names file, line and key, what was expected and the nearest name. `mocap-id COMMAND --help` and "
        "docs/settings.md list all there are.",
    ),
    3: Exit(
        errors.RecordingError,
        "An input is missing, unreadable or contradicts itself",
        "A recording, a force file or an encoder's file cannot be read as what it should be. Nothing was written.",
        "The message names the file and what is wrong in it. `mocap-id inspect FILE` shows what it holds; export it "
        "again, or say what it does not (`planarise: {units: …, vertical: …}`).",
    ),
    4: Exit(
        errors.Refused,
        "Refused",
        "The motion is not that of a planar serial chain on a fixed base, or no joint moves enough. summary.json and "
        "report.html say so, and the artefacts of the stages before stand. A finding, not a failure.",
        "Read the reason in the verdict: it says what to record or which part of the recording to use.",
    ),
    5: Exit(
        errors.NumericalError,
        "A computation failed",
        "Something did not converge, or failed in a way that nobody foresaw, on input that passed every check. The "
        "artefacts of the stages before stand.",
        "Look at the skeleton and the units first. An unforeseen failure leaves `failure.log` in the run folder: "
        "please report it.",
    ),
    6: Exit(
        errors.StoreError,
        "An artefact or the output folder cannot be used",
        "It is missing, stale, damaged, locked by another run, full, or not writable; or a file stands where one is to "
        "be written. Nothing is half-written.",
        "The message names the file and what to do: run the stage before, make room, change permissions, choose "
        "another folder, or --force where a command has it.",
    ),
    130: Exit(None, "Interrupted by Ctrl-C", *_INTERRUPTED),
    143: Exit(None, "Interrupted by SIGTERM", *_INTERRUPTED),
}
"""Every exit code of every command."""
