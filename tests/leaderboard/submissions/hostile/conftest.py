"""Here a test that skips has shown nothing: with RACINES_NO_SKIP=1, as `.ci/run` sets, it fails."""

import os

import pytest

MUST_RUN = "RACINES_NO_SKIP"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    return _no_skip((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    return _no_skip((yield))


def _no_skip(report):
    if report.skipped and os.environ.get(MUST_RUN) == "1" and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped where it must run ({MUST_RUN}=1): {report.longrepr}"
    return report
