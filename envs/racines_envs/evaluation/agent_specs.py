"""Agents as commands name them: `[LABEL=]NAME`, or the folder that a training left."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from racines_data.errors import RacinesError
from racines_envs.agents import Agent, load_agent

RUNS = Path("envs/runs")


@dataclass(frozen=True)
class Run:
    """One agent, and where its weights lie."""

    label: str
    """What tables and pictures call it."""
    agent: str
    """Registered name, or what `load_agent` takes."""
    folder: Path
    """The run folder; not read for agents without weights."""
    config: dict[str, Any] = field(default_factory=dict)
    """The training's settings; empty for agents without weights."""
    seed: int | None = None
    """Of the training."""

    def load(self, device: torch.device | str = "cpu") -> Agent:
        """Return the agent."""
        return load_agent(self.agent, self.folder, device)


def split_label(spec: str) -> tuple[str | None, str]:
    """Split `LABEL=RUN`; without a label the first is None."""
    label, equals, rest = spec.partition("=")
    return (label, rest) if equals and label else (None, spec)


def find_run(spec: str) -> Run:
    """Return what `[LABEL=]NAME` or `[LABEL=]FOLDER` names; a name's folder is envs/runs/NAME.

    Raises:
        RacinesError: a folder without config.json, or one that does not say which agent it holds.
    """
    label, where = split_label(spec)
    folder = Path(where) if Path(where).is_dir() else RUNS / where
    described = folder / "config.json"
    if not described.is_file():
        if Path(where).is_dir():
            raise RacinesError(f"{described}: no such file: {where} is not an agent's run folder")
        return Run(label or Path(where).stem, where, folder)
    content = read_json(described)
    if "agent" not in content:
        raise RacinesError(f"{described}: names no agent: {where} is not an agent's run folder")
    return Run(
        label or folder.resolve().name,
        content["agent"],
        folder,
        content.get("config", {}),
        content.get("seed"),
    )


def find_runs(specs: Sequence[str]) -> list[Run]:
    """Return several agents, each under a label of its own.

    Raises:
        RacinesError: none given, or two of one label.
    """
    runs = [find_run(spec) for spec in specs]
    labels = [run.label for run in runs]
    if not runs:
        raise RacinesError("no agent given: name agents or run folders")
    for label in labels:
        if labels.count(label) > 1:
            raise RacinesError(f"two agents are called {label!r}: name them, LABEL=RUN")
    return runs


def common_view(runs: Sequence[Run], view: str = "") -> str:
    """Return the view that all were trained for; `view`, or SC, for agents without weights.

    Raises:
        RacinesError: they were trained for different views, or not for the one asked for.
    """
    trained = {run.label: run.config["view"] for run in runs if "view" in run.config}
    wanted = view or next(iter(trained.values()), "SC")
    for label, its in trained.items():
        if its != wanted:
            raise RacinesError(
                f"{label}: trained for {its}, not {wanted}: compare agents of a view"
            )
    return wanted


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        RacinesError: missing or damaged.
    """
    try:
        return json.loads(path.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RacinesError(f"{path}: not readable as JSON: {error}") from error
