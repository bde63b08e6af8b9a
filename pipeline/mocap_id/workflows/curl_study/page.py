"""The page of a study of curls from its results."""

from __future__ import annotations

from collections.abc import Sequence

from mocap_id.reporting.cohort.page_data import CohortData
from mocap_id.workflows.curl_study.trial_results import CurlResult


def page(data: CohortData, trials: Sequence[CurlResult]) -> bytes:
    """Return the page as UTF-8."""
    from mocap_id.reporting.curl_cohort.page import curl_cohort_page  # noqa: PLC0415  it loads the page's templates

    return curl_cohort_page(data, trials[0].reference)
