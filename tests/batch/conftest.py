"""Dask's threads write their log after the test that began them has ended."""

from __future__ import annotations

import logging
import sys

import pytest


@pytest.fixture(autouse=True, scope="session")
def dask_writes_to_the_real_stderr() -> None:
    """The stream that Dask found when it was imported is that of one test, and is closed after it."""
    for name in ("distributed", "distributed.client", "tornado"):
        for handler in logging.getLogger(name).handlers:
            if isinstance(handler, logging.StreamHandler):
                handler.setStream(sys.__stderr__)
