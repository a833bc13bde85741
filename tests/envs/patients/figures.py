"""What the documentation says of agents on patients, from their boards.

racines eval agent AGENT --view VIEW --tier TIER --profile reference --out FILE
racines leaderboard --board TIER --collect FILE
python -m tests.envs.patients.figures
"""

import json
from pathlib import Path
from typing import Any

from racines_data.files import write_json
from racines_data.patients.patient import PATHOLOGIES
from racines_data.views import VIEWS
from racines_models.statistics import Evidence
from racines_models.statistics.intervals import difference

RESULT = Path(__file__).parents[3] / "docs/results/patient-tasks.json"
BOARDS = RESULT.parents[2] / "leaderboard/results"
AGENTS = (
    "random", "constant-pose", "blind-tour", "ppo", "behaviour-cloning", "ppo-belief", "servo",
    "servo-full", "servo-memory", "servo-memory-full", "servo-memory-plus", "planner",
)  # fmt: skip
TIERS = {"patients": "still", "beating": "beating"}
Found = dict[tuple[str, ...], dict[str, Any]]
"""Scores by agent, view, tier and split."""


def on_boards() -> Found:
    """Return the scores of the records on the boards of patients."""
    found: Found = {}
    for tier in TIERS:
        for path in sorted((BOARDS / tier / "patient-agents").glob("*.json")):
            record = json.loads(path.read_text())
            scores, name = record["scores"], record["submission"]["name"]
            view, split = scores["task"]["definition"]["view"], scores["task"]["split"]
            found[name, view, tier, split] = scores
    return found


def percent(told: dict[str, Any], digits: int = 0) -> str:
    """Return a share and its interval, per cent."""
    value, low, high = (f"{100 * told[key]:.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} % ({low} – {high})"


def measured(metrics: dict[str, Any], name: str, unit: str) -> str:
    """Return a median and its quartiles."""
    median, low, high = (
        metrics[f"{name}_{part}"]["value"] for part in ("median", "quartile", "upper_quartile")
    )
    return f"{median:.1f} ({low:.1f} – {high:.1f}) {unit}"


def success(found: Found, split: str) -> dict[str, Any]:
    """Return the table of declared success: a row an agent and tier, a column a view."""
    rows = []
    for agent in AGENTS:
        for tier, told in TIERS.items():
            own = [found.get((agent, view, tier, split)) for view in VIEWS]
            if any(own):
                cells = [percent(each["metrics"]["success_declared"]) if each else "–"
                         for each in own]  # fmt: skip
                rows.append([agent, told, *cells])
    return {"columns": ["agent", "hearts", *VIEWS], "rows": rows}


def ends(found: Found, split: str) -> dict[str, Any]:
    """Return the table of how A4C's episodes end, by agent and tier."""
    columns = ["agent", "hearts", "declares", "wrongly", "passes through", "steps", "distance",
               "angle", "peak force"]  # fmt: skip
    rows = []
    for agent in AGENTS:
        for tier, told in TIERS.items():
            if scores := found.get((agent, "A4C", tier, split)):
                metrics = scores["metrics"]
                shares = [percent(metrics[name])
                          for name in ("declared", "false_declarations", "reached")]  # fmt: skip
                rows.append([
                    agent, told, *shares, f"{metrics['episode_steps']['value']:.0f}",
                    measured(metrics, "position_error", "mm"),
                    measured(metrics, "rotation_error", "°"),
                    f"{metrics['peak_force']['value']:.1f} N",
                ])  # fmt: skip
    return {"columns": columns, "rows": rows}


def by_pathology(found: Found, agent: str, split: str) -> dict[str, Any]:
    """Return the table of an agent's declared success on A4C by pathology."""
    own = {tier: found[agent, "A4C", tier, split] for tier in TIERS}
    rows = []
    for name in PATHOLOGIES:
        told = [each["by_pathology"].get(name) for each in own.values()]
        if all(told):
            units = told[0]["success_declared"]["settings"]["units"]
            cells = [percent(each["success_declared"]) for each in told]
            rows.append([name, str(units), *cells])
    return {"columns": ["pathology", "patients", *TIERS.values()], "rows": rows}


def gains(one: str, other: str) -> dict[str, Any]:
    """Return the table of what one finds more often than another, points, paired by patient."""
    rows = []
    for tier, told in TIERS.items():
        cells = []
        for view in VIEWS:
            paths = [BOARDS / tier / "patient-agents" / f"{each}-{view.lower()}.parquet"
                     for each in (one, other)]  # fmt: skip
            if not all(path.is_file() for path in paths):
                cells.append("–")
                continue
            both = [Evidence.read(path).figures["success_declared"] for path in paths]
            gain = difference(*(figures.replicates() for figures in both))
            assert gain.low is not None and gain.high is not None
            cells.append(f"{100 * gain.value:+.0f} ({100 * gain.low:.0f} to {100 * gain.high:.0f})")
        if set(cells) != {"–"}:
            rows.append([told, *cells])
    return {"columns": ["hearts", *VIEWS], "rows": rows}


def floors(found: Found, split: str) -> dict[str, float]:
    """Return the highest share of each floor over views and tiers, per cent."""
    shares = {
        agent: [100 * scores["metrics"]["success_declared"]["value"]
                for (name, *_, its), scores in found.items() if (name, its) == (agent, split)]
        for agent in AGENTS[:4]
    }  # fmt: skip
    return {agent: round(max(each), 1) for agent, each in shares.items() if each}


def fill(found: Found) -> None:
    """Write the figures and tables."""
    versions = {scores["phantom"]["version"] for scores in found.values()}
    assert len(versions) == 1, versions
    content = json.loads(RESULT.read_text())
    tables = {"success_test": success(found, "test"), "ends": ends(found, "test")}
    tables |= {"pathology": by_pathology(found, "servo", "test")}
    tables |= {"gains": gains("servo-memory", "servo"), "pixels": gains("servo-full", "servo")}
    tables |= {"both": gains("servo-memory-full", "servo-full")}
    tables |= {"taught": gains("servo-memory-plus", "servo-memory-full")}
    shown = {
        agent: {
            told: round(100 * found[agent, "A4C", tier, "test"]["metrics"][
                "success_declared"]["value"], 1)
            for tier, told in TIERS.items()
        }
        for agent in AGENTS[6:]
        if (agent, "A4C", "beating", "test") in found
    }  # fmt: skip
    told = found["servo", "A4C", "patients", "test"]["metrics"]["success_declared"]["settings"]
    figures = {
        "floors": floors(found, "test"),
        "level": round(100 * told["level"]),
        "world": versions.pop(),
        "planner_least": round(
            min(
                100 * scores["metrics"]["success_declared"]["value"]
                for (name, *_, split), scores in found.items()
                if (name, split) == ("planner", "test")
            ),
            1,
        ),
        **shown,
    }
    write_json(RESULT, content | {"figures": figures, "tables": tables})


if __name__ == "__main__":
    fill(on_boards())
