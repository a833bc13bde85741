"""What the wheel carries beside the code: weights that lie in the repository once.

An editable install has them in their own places; a wheel is given copies, as
`racines_models/published/places.py` expects them.
"""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CARRIED = (
    "models/weights/manifest.json",
    "models/weights/student",
    "envs/weights/ppo",
    "envs/weights/servo",
)


class CarriedWeights(BuildHookInterface):
    """Adds the judge and the agents that an installed package works with."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files to copy, in a wheel that is no editable one."""
        if version == "standard":
            inside = "racines_models/published/carried"
            build_data["force_include"] |= {each: f"{inside}/{each}" for each in CARRIED}
