"""Pages of the documentation that are drawn from the code."""

from tests.conftest import ROOT
from tests.reference import commands, settings

__all__ = ["PAGES", "ROOT"]
PAGES = {"cli.md": commands.page, "settings.md": settings.page}
