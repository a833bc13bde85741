"""The one file that a machine's figures stand in: parts, each with its state, and the table.

It is written whole after each part, so that a run that is stopped at any moment leaves what it had.
"""

import json
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jsonschema

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_models.provenance import code_version, environment
from tests.benchmarks.gpu.sizes import Sizes

SCHEMA = json.loads(Path(__file__).with_name("schema.json").read_text())
PACKAGES = ("torch", "torchrl", "tensordict", "gymnasium", "numpy")
MILLION = 1_000_000
DONE, UNDER_WAY, FAILED = "done", "under way", "failed"
NOT_MEASURED = "not measured"
ROWS = (
    (
        "frames of patients against the CPU, gray levels",
        "correctness",
        "patients_levels",
        "≤ 1",
        ",.0f",
    ),
    (
        "the phantom's pixels more than a gray level apart",
        "correctness",
        "phantom_share",
        "",
        ".4%",
    ),
    ("rewards against the CPU", "correctness", "reward", "≤ 0.001", ".2g"),
    ("frames/s, renderer", "render", "frames_per_second", "≥ 100,000", ",.0f"),
    ("frames/s, renderer of patients", "hearts", "frames_per_second", "", ",.0f"),
    ("steps/s, image, student's reward", "images", "steps_per_second", "≥ 70,000", ",.0f"),
    ("steps/s, pose, oracle's reward", "params", "steps_per_second", "≥ 1,000,000", ",.0f"),
    ("steps/s, PPO from the image", "ppo", "steps_per_second", "≥ 32,000", ",.0f"),
    ("success of the paper's agent, SC", "agent-SC", "success", "", ".0%"),
    ("its environment steps", "agent-SC", "frames", "15,000,000", ",.0f"),
    *(
        (f"success of the paper's agent, {view}", f"agent-{view}", "success", "", ".0%")
        for view in Sizes.views[1:]
    ),
    *(
        (f"images that `{name}` learned from", f"generator-{name}", "images", "10,100,000", ",.0f")
        for name in Sizes.generators
    ),
    *(
        (f"`{name}` on patients, ten tasks", f"grid-{name}", "mean", "", ".0%")
        for name in Sizes.patients
    ),
)
"""Of the page's table: what, the part and its figure, the aim, and how it is written."""


def machine(device: str) -> dict[str, Any]:
    """Return the machine: device, driver, CPU, threads, versions."""
    import torch

    told = environment(device)
    return {
        "device": told.get("gpu", "cpu"),
        "driver": _driver() if device.startswith("cuda") else None,
        "cuda": torch.version.cuda,
        "memory_gib": _memory(device),
        "cpu": told["cpu"],
        "threads": told["threads"],
        "python": platform.python_version(),
        "platform": told["platform"],
        "versions": {name: _version(name) for name in PACKAGES},
    }


def _memory(device: str) -> float | None:
    import torch

    if not device.startswith("cuda"):
        return None
    return round(torch.cuda.get_device_properties(device).total_memory / 2**30, 1)


def _driver() -> str | None:
    command = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return told.stdout.split("\n")[0].strip() or None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


class Document:
    """The figures of one machine, and where they are kept."""

    def __init__(self, path: Path, device: str, tiny: bool) -> None:
        """Read what is there, if it is this machine's.

        Raises:
            RacinesError: the file is damaged, or holds another machine's figures.
        """
        self.path, self.tiny = path, tiny
        here = machine(device)
        content = read(path) if path.is_file() else {}
        known = content.get("hardware")
        if known is not None and (known["device"], known["cpu"]) != (here["device"], here["cpu"]):
            raise RacinesError(
                f"{path}: holds figures of {known['device']} ({known['cpu']}); this is "
                f"{here['device']} ({here['cpu']}): write elsewhere by --out, or remove it"
            )
        if known is not None and content["tiny"] != tiny:
            raise RacinesError(f"{path}: is of another size: write elsewhere by --out")
        self.hardware: dict[str, Any] = here
        self.parts: dict[str, dict[str, Any]] = content.get("parts", {})

    def state(self, part: str) -> str | None:
        """Return how far a part is; None where it was not begun."""
        return self.parts.get(part, {}).get("state")

    def put(self, part: str, state: str, seconds: float, figures: dict[str, Any]) -> None:
        """Note a part, and write the file; seconds add up over the runs that it took."""
        before = self.parts.get(part, {}).get("seconds", 0.0)
        self.parts[part] = {
            "state": state,
            "seconds": round(before + seconds, 1),
            "commit": code_version()["commit"],
            "figures": figures,
        }
        self.write()

    def write(self) -> None:
        """Write the file, which its schema has to pass."""
        content = whole(self.hardware, self.parts, self.tiny)
        jsonschema.validate(content, SCHEMA)
        write_json(self.path, content)


def read(path: Path) -> dict[str, Any]:
    """Return a file of figures.

    Raises:
        RacinesError: it is not there, or is none.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        jsonschema.validate(content, SCHEMA)
    except (OSError, ValueError, jsonschema.ValidationError) as error:
        told = error.message if isinstance(error, jsonschema.ValidationError) else error
        raise RacinesError(f"{path}: no figures of a GPU: {told}") from error
    return content


def whole(
    hardware: dict[str, Any] | None, parts: dict[str, dict[str, Any]], tiny: bool = False
) -> dict[str, Any]:
    """Return the whole file: of no machine yet where it is None."""
    return {
        "schema": "racines.figures/1",
        "what": "what one GPU does",
        "command": "make gpu",
        "source": "measured once",
        "machine": NOT_MEASURED if hardware is None else _named(hardware),
        "hardware": hardware,
        "tiny": tiny,
        "parts": parts,
        "tables": {"gpu": table(parts), "agent": curve(parts)},
    }


def _named(hardware: dict[str, Any]) -> str:
    driver = f", driver {hardware['driver']}" if hardware["driver"] else ""
    torch = hardware["versions"]["torch"]
    return f"{hardware['device']}{driver}; {hardware['cpu']}; PyTorch {torch}"


def table(parts: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the page's table; what is not there was not measured."""
    rows = []
    for what, part, name, aim, form in ROWS:
        figure = parts.get(part, {}).get("figures", {}).get(name)
        shown = NOT_MEASURED if figure is None else format(figure, form).replace("%", " %")
        rows.append([what, shown, aim])
    return {"columns": ["", "one GPU", "aim"], "right": 1, "rows": rows}


def curve(parts: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the validations of the paper's agent on SC, about one a million steps and the last."""
    history = parts.get("agent-SC", {}).get("figures", {}).get("history", [])
    shown, reached = [], 0
    for number, row in enumerate(history):
        if row["frames"] >= reached or number == len(history) - 1:
            shown.append(row)
            reached = (row["frames"] // MILLION + 1) * MILLION
    rows = [
        [
            format(row["frames"], ",.0f"),
            format(row["validation/return"], ",.0f"),
            format(row["validation/success"], ".0%").replace("%", " %"),
            format(row["validation/steps"], ",.0f"),
        ]
        for row in shown
    ]
    columns = ["environment steps", "return, by the grader", "true success", "steps an episode"]
    return {"columns": columns, "right": 0, "rows": rows}
