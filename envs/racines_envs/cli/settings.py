"""What the commands read their settings from: the params file or a packaged profile."""

from pathlib import Path
from typing import Annotated, Any

from racines_models.cli.scores import DEVICES

Device = Annotated[str | None, DEVICES]


def read_settings(params: Path | None, profile: str | None) -> dict[str, Any]:
    """Return the settings of a file or a profile; ./params.yaml, if it is there, for neither."""
    from racines_data.config import read_params

    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    return read_params(params, profile)


def given(**options: Any) -> dict[str, Any]:
    """Return the options that were given on the command line."""
    return {name: value for name, value in options.items() if value is not None}


def phantom_config(settings: dict[str, Any]) -> Any:
    """Return the configuration of the phantom that the dataset is acquired from."""
    from racines_data.config import fill, section
    from racines_data.phantom import PhantomConfig

    return fill(PhantomConfig, section(settings, "data.phantom.phantom"), "data.phantom.phantom")
