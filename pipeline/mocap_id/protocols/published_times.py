"""Published times of the five-times-sit-to-stand test, for context and not for diagnosis.

The sources differ in chair, instruction and stop rule. A stopwatch starts at the command, not when the movement begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

StopRule = Literal["fifth stand", "fifth seat contact", "not said"]


@dataclass(frozen=True)
class Published:
    """One published value.

    Parameters
    ----------
    limit : float
        s.
    people : str
        Group that was studied.
    meaning : str
        Meaning of longer times according to the source.
    stop : {"fifth stand", "fifth seat contact", "not said"}
        Stop rule, as far as the text available to us states it.
    source : str
    """

    limit: float
    people: str
    meaning: str
    stop: StopRule
    source: str


_BOHANNON = "Bohannon, Percept Mot Skills 2006;103:215-222 (meta-analysis of 13 papers)"
_WORSE = "worse than average for the age"
_BUATOIS = "Buatois et al., J Am Geriatr Soc 2008;56:1575-1577"
_GURALNIK = "Guralnik et al., J Gerontol A 2000;55:M221-M231"
_DUNCAN = "Duncan et al., Arch Phys Med Rehabil 2011;92:1431"

PUBLISHED: tuple[Published, ...] = (
    Published(11.4, "60 to 69 years", _WORSE, "not said", _BOHANNON),
    Published(12.6, "70 to 79 years", _WORSE, "not said", _BOHANNON),
    Published(14.8, "80 to 89 years", _WORSE, "not said", _BOHANNON),
    Published(
        15.0,
        "2735 people of 65 years and older",
        "predicted recurrent falls with sensitivity 55 % and specificity 65 %",
        "not said",
        _BUATOIS,
    ),
    Published(13.6, "older people", "associated with increased disability and morbidity", "fifth stand", _GURALNIK),
    Published(
        16.0,
        "80 people with Parkinson's disease",
        "distinguished people who fall from others",
        "not said",
        _DUNCAN,
    ),
)
