"""The LeRobot format with images of three equal channels, for policies that take no other."""

from functools import partial

from racines_data.export.lerobot.writer import export as export_lerobot

export = partial(export_lerobot, channels=3)
"""As `racines_data.export.lerobot.export`; PNG files grow by about a tenth."""
