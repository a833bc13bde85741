"""The documentation builds without a warning, and its Python blocks run."""

import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT, command
from tests.documents import blocks

PAGES = sorted((ROOT / "docs").glob("*.md"))


@pytest.mark.slow
def test_pages_build_and_their_links_hold(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "index.html").exists()


def test_every_page_that_a_clinician_could_open_first_says_what_it_is_not():
    for page in (ROOT / "README.md", ROOT / "docs/index.md", ROOT / "leaderboard/README.md"):
        assert "not a medical device" in page.read_text(), page.name


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_python_blocks_run(page, workplace):
    code = "\n\n".join(block.text for block in blocks(page) if block.language == "python")
    if not code:
        return
    command(workplace, "python", "-c", code)
