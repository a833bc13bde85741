"""Lines that benchmarks add are kept and shown when all have run."""

from collections.abc import Callable, Iterator

import pytest

from racines_data.terminal import console
from tests.benchmarks import lines as kept
from tests.benchmarks.lines import Line

LINES: list[Line] = []


@pytest.fixture
def line(benchmark) -> Iterator[Callable[[Line], None]]:
    """Take a line of the table of peers; its figures go to pytest-benchmark's file, too.

    Where measuring is off (`--benchmark-disable`, pytest-xdist) nothing is kept: a test that runs
    the benchmarks for their assertions alone must not change what the documentation says.
    """

    def add(one: Line) -> None:
        benchmark.extra_info[f"{one.work} / {one.peer}"] = one.ratio
        if benchmark.enabled:
            LINES.append(one)

    yield add


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the lines that were measured, and print them."""
    if not LINES:
        return
    from rich.table import Table

    measured = {(one.work, one.peer) for one in LINES}
    document = kept.keep(LINES)
    shown = [each for each in document["lines"] if (each["work"], each["peer"]) in measured]
    content, sheet = kept.table(shown), Table(title=f"Peers; kept in {kept.FILE}")
    for name in content["columns"][:-1]:
        sheet.add_column(name)
    for row in content["rows"]:
        sheet.add_row(*row[:-1])
    console().print(sheet)
