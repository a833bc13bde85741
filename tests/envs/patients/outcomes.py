"""How the episodes of agents on patients end, all of them: what the boards' evidence tells further.

    python -m tests.envs.patients.outcomes                # of the evidence beside the records
    python -m tests.envs.patients.outcomes --latency      # measures the time of a decision as well
    python -m tests.envs.patients.outcomes TRAIN.json …   # scores of `racines eval agent` on the
                                                          # train split, for the gap to test

What was measured once stays in the result until it is measured again.
"""

import json
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from racines_data.files import write_json
from racines_data.patients.patient import PATHOLOGIES
from racines_data.patients.population import draw_patient
from racines_data.plotting import card_style, colour
from racines_data.views import VIEWS
from racines_envs.agents import load_agent
from racines_envs.evaluation.measures import latency
from racines_envs.evaluation.patients import PatientsConfig, start_set
from racines_envs.evaluation.pictures import save
from racines_envs.evaluation.run import core_for
from racines_envs.task.core import ScanCore
from racines_envs.task.tasks import get_task
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import make_ward
from racines_leaderboard.fresh.flags import read_secret_scores
from racines_models.statistics import Evidence
from tests.envs.patients.figures import BOARDS, TIERS, Found, measured, on_boards, percent

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs/results/agent-outcomes.json"
THRESHOLDS, LEARNING = (ROOT / f"docs/images/agent-{name}.png" for name in
                        ("thresholds", "learning"))  # fmt: skip
WEIGHTS = ROOT / "envs/weights"
BEST = {"patients": "servo-memory-plus", "beating": "servo-memory-plus"}
"""By tier, of those with a row in every view, the one first on most tasks: most is told of it."""
DRAWN = ("constant-pose", "ppo-belief", "servo", "servo-memory", "servo-full", "servo-memory-full",
         "servo-memory-plus", "planner")  # fmt: skip
AXES = {
    "position_error": ("mm to the patient's nominal pose", np.linspace(0.0, 30.0, 121)),
    "rotation_error": ("degrees to it", np.linspace(0.0, 30.0, 121)),
    "final_grade": ("grade at the end, at least", np.linspace(0.0, 10.0, 101)),
}
"""By figure of an episode: what it is called, and the thresholds."""
AIMS = {"patients": (95, 90, 4.0), "beating": (85, 80, 5.0)}
"""Share found on average and in the worst view, per cent; and the median error, mm and degrees."""
GAP = 5
DECISIONS = 200


@cache
def evidence_of(agent: str, view: str, tier: str) -> Evidence:
    """Return the figures of every episode of a row."""
    return Evidence.read(BOARDS / tier / "patient-agents" / f"{agent}-{view.lower()}.parquet")


def share_within(figures: np.ndarray, thresholds: np.ndarray, above: bool) -> np.ndarray:
    """Return the share of (M,) episodes that end within each of (T,) thresholds, per cent."""
    meet = figures[:, None] >= thresholds if above else figures[:, None] <= thresholds
    return 100.0 * meet.mean(0)


@card_style()
def draw_thresholds(path: Path) -> None:
    """Draw how many A4C episodes end within every distance, angle and grade; failures included."""
    figure = Figure(figsize=(9.6, 5.6), layout="constrained")
    grid = figure.subplots(len(TIERS), len(AXES), sharey=True)
    for row, (tier, told) in zip(grid, TIERS.items(), strict=True):
        for axes, (key, (title, thresholds)) in zip(row, AXES.items(), strict=True):
            for place, agent in enumerate(DRAWN):
                if not has_row(agent, "A4C", tier):
                    continue
                values = evidence_of(agent, "A4C", tier).figures[key].values
                assert values is not None
                shares = share_within(values.ravel(), thresholds, key == "final_grade")
                style = "--" if agent in ("planner", "constant-pose") else "-"
                axes.plot(thresholds, shares, style, color=colour(place), label=agent)
            axes.set(xlabel=title, ylim=(0, 101), xlim=(thresholds[0], thresholds[-1]))
        row[0].set_ylabel("share of episodes, %")
        row[0].set_title(f"A4C, {told} hearts, test patients")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(DRAWN) // 2)
    save(figure, path)


def trainings(agent: str) -> list[list[dict[str, float]]]:
    """Return the history of every published training of an agent."""
    own = json.loads((WEIGHTS / agent / "metrics.json").read_text())
    if "seeds" in own:
        return [each["history"] for each in own["seeds"].values()]
    folders = sorted((WEIGHTS / agent).glob("seed-*/metrics.json"))
    return [own["history"], *(json.loads(path.read_text())["history"] for path in folders)]


@card_style()
def draw_learning(path: Path) -> dict[str, int]:
    """Draw what validation patients said while agents learned; return how many trainings of each.

    Readings of the servos before their rounds, what the memory chooses before its own, and whole
    episodes of the policy.
    """
    figure = Figure(figsize=(9.6, 3.4), layout="constrained")
    reading, choosing, acting = figure.subplots(1, 3)
    counted = {}
    panels = (
        (reading, "servo", "images", "validation/position_error", 1e-6, 1.0),
        (reading, "servo-full", "images", "validation/position_error", 1e-6, 1.0),
        (choosing, "servo-memory", "episodes", "validation/chosen", 1e-3, 100.0),
        (choosing, "servo-memory-full", "episodes", "validation/chosen", 1e-3, 100.0),
        (choosing, "servo-memory-plus", "episodes", "validation/chosen", 1e-3, 100.0),
        (acting, "ppo-belief", "frames", "validation/success", 1e-3, 100.0),
    )
    for axes, agent, counter, key, each, factor in panels:
        histories = trainings(agent)
        counted[agent] = len(histories)
        for place, history in enumerate(histories):
            x, y = ([point[name] * by for point in history]
                    for name, by in ((counter, each), (key, factor)))  # fmt: skip
            axes.plot(x, y, color=colour(DRAWN.index(agent)), label=agent if place == 0 else None)
    reading.set(xlabel="million images", ylabel="mean error along an axis, mm", ylim=(0, None))
    reading.set_title("readings")
    choosing.set(xlabel="thousand episodes", ylabel="its choice shows the view, %", ylim=(0, 100))
    choosing.set_title("what memories choose")
    acting.set(xlabel="thousand steps", ylabel="ends at the view, %", ylim=(0, 100))
    acting.set_title("a policy on the belief")
    for axes in (reading, choosing, acting):
        axes.legend()
    save(figure, path)
    return counted


def left_out(agent: str, view: str, tier: str) -> list[int]:
    """Return the patients in whom no training found the view from any start."""
    figures = evidence_of(agent, view, tier).figures["success_declared"]
    assert figures.values is not None and figures.units is not None
    found = np.unique(figures.units[figures.values.any((0, 1))])
    return [int(unit) for unit in np.setdiff1d(figures.units, found)]


def never_found(agent: str, view: str, tier: str) -> int:
    """Return in how many patients no training found the view from any start."""
    return len(left_out(agent, view, tier))


def left() -> dict[str, Any]:
    """Return the table of the patients in whom the best agent always fails, and how it ends."""
    rows = []
    for tier, told in TIERS.items():
        for view in VIEWS:
            figures = evidence_of(BEST[tier], view, tier).figures
            for patient in left_out(BEST[tier], view, tier):
                passed, away, grade = (
                    each.values[..., each.units == patient].ravel()
                    for name in ("reached", "position_error", "final_grade")
                    if (each := figures[name]).values is not None and each.units is not None
                )
                rows.append([
                    told, view, str(patient), draw_patient(patient).pathology,
                    f"{passed.sum():.0f} of {len(passed)}", f"{np.median(away):.0f} mm",
                    f"{np.median(grade):.1f}",
                ])  # fmt: skip
    columns = ["hearts", "view", "patient", "form", "passes through", "distance", "grade"]
    return {"columns": columns, "rows": rows}


def has_row(agent: str, view: str, tier: str) -> bool:
    """Return whether a board has an agent's row."""
    return (BOARDS / tier / "patient-agents" / f"{agent}-{view.lower()}.parquet").is_file()


def never() -> dict[str, Any]:
    """Return the table of patients in whom an agent always fails."""
    agents = [each for each in DRAWN if each != "constant-pose"]
    rows = []
    for agent in agents:
        for tier, told in TIERS.items():
            cells = [str(never_found(agent, view, tier)) if has_row(agent, view, tier) else "–"
                     for view in VIEWS]  # fmt: skip
            if set(cells) != {"–"}:
                rows.append([agent, told, *cells])
    return {"columns": ["agent", "hearts", *VIEWS], "rows": rows}


def by_pathology(found: Found) -> dict[str, Any]:
    """Return the table of the best agent's declared success by pathology and view."""
    rows = []
    for tier, told in TIERS.items():
        for name in PATHOLOGIES:
            scores = [found[BEST[tier], view, tier, "test"]["by_pathology"].get(name)
                      for view in VIEWS]  # fmt: skip
            if all(scores):
                units = scores[0]["success_declared"]["settings"]["units"]
                cells = [_of_few(each["success_declared"]) for each in scores]
                rows.append([told, name, str(units), *cells])
    return {"columns": ["hearts", "pathology", "patients", *VIEWS], "rows": rows}


def missing(view: str, tier: str) -> list[float]:
    """Return the shares of the best agent's failures, per cent: view passed through, and not."""
    figures = evidence_of(BEST[tier], view, tier).figures
    success, passed = (figures[name].values for name in ("success_declared", "reached"))
    assert success is not None and passed is not None
    failed = success == 0
    return [100 * float((failed & (passed == way)).mean()) for way in (1, 0)]


def _of_few(told: dict[str, Any]) -> str:
    """Return a share and its interval; of equal trainings the interval over them tells nothing."""
    if told["high"] - told["low"] < 1e-6:
        return f"{100 * told['value']:.0f} % (–)"
    return percent(told)


def ends(found: Found) -> dict[str, Any]:
    """Return the table of how the best agent's episodes end, by view."""
    rows = []
    for tier, told in TIERS.items():
        for view in VIEWS:
            metrics = found[BEST[tier], view, tier, "test"]["metrics"]
            shares = [percent(metrics[name]) for name in ("false_declarations", "reached")]
            missed = [f"{share:.0f} %" for share in missing(view, tier)]
            rows.append([
                told, view, *shares, *missed, f"{metrics['seconds_median']['value']:.1f} s",
                measured(metrics, "position_error", "mm"),
                measured(metrics, "rotation_error", "°"),
            ])  # fmt: skip
    columns = ["hearts", "view", "declares wrongly", "passes through", "and ends elsewhere",
               "never passes", "median time", "distance", "angle"]  # fmt: skip
    return {"columns": columns, "rows": rows}


def aims(found: Found, gaps: Mapping[str, float]) -> dict[str, Any]:
    """Return the table of the aims, what the best agent reaches, and whether that is enough."""
    rows = []
    for tier, told in TIERS.items():
        mean, least, error = AIMS[tier]
        metrics = [found[BEST[tier], view, tier, "test"]["metrics"] for view in VIEWS]
        shares = [100 * each["success_declared"]["value"] for each in metrics]
        missed = [never_found(BEST[tier], view, tier) for view in VIEWS]
        distance, angle = (
            [each[f"{name}_error_median"]["value"] for each in metrics]
            for name in ("position", "rotation")
        )
        worst = int(np.argmin(shares))
        rows += [
            [told, f"found and declared, mean of views: at least {mean} %",
             f"{np.mean(shares):.1f} %", _met(np.mean(shares) >= mean)],
            [told, f"in every view at least {least} %", f"{shares[worst]:.0f} % in {VIEWS[worst]}",
             _met(shares[worst] >= least)],
            [told, "no patient in whom it always fails",
             f"{min(missed)} to {max(missed)} a view", _met(max(missed) == 0)],
            [told, f"median distance at most {error:.0f} mm",
             f"{min(distance):.1f} to {max(distance):.1f} mm", _met(max(distance) <= error)],
            [told, f"median angle at most {error:.0f}°",
             f"{min(angle):.1f} to {max(angle):.1f}°", _met(max(angle) <= error)],
        ]  # fmt: skip
        ahead = gaps.get(tier)
        points = "not measured" if ahead is None else f"{ahead:+.1f} points"
        rows.append([told, f"train patients at most {GAP} points ahead, A4C", points,
                     "–" if ahead is None else _met(ahead <= GAP)])  # fmt: skip
    return {"columns": ["hearts", "aim", "measured", "met"], "rows": rows}


def secret() -> dict[str, Any]:
    """Return the table of rounds of fresh draws: on the board's patients, and on a round's."""
    rows = []
    for tier, told in TIERS.items():
        for path in sorted((BOARDS / tier / "secret").glob("round-*/patient-agents/*.json")):
            drawn = read_secret_scores(path, BOARDS)
            figures = drawn["figures"]
            cells = [percent(figures["success_declared"][side]) for side in ("public", "secret")]
            for name, unit in (("position_error_median", "mm"), ("rotation_error_median", "°")):
                pair = (figures[name][side]["value"] for side in ("public", "secret"))
                cells.append("{:.1f} and {:.1f} ".format(*pair) + unit)
            flags = "; ".join(drawn["flags"]) or "none"
            rows.append([told, f"`{drawn['name']}`", str(drawn["round"]), *cells, flags])
    columns = ["hearts", "row", "round", "test patients", "fresh patients", "distance", "angle",
               "flags"]  # fmt: skip
    return {"columns": columns, "rows": rows}


def _met(yes: Any) -> str:
    return "yes" if yes else "no"


def starting(tier: str) -> dict[str, float]:
    """Return how far the boards' A4C starts are from the patients' nominal poses, by median."""
    config = PatientsConfig(view=f"A4C-{tier}", split="test", starts=3)
    starts = start_set(config)
    parts = []
    for chunk in starts.chunks(config.chunk):
        ward = make_ward(tier, config.split, chunk.patients, "cpu")
        core = make_core(get_task(config.view), len(chunk.seeds), observation="params",
                         reward="oracle", phantom=ward)  # fmt: skip
        core.reset(chunk.seeds, case=ward.case_of(chunk.units.tolist()))
        info = core.info()
        parts.append([info[f"{name}_error"].numpy() for name in ("position", "rotation")])
    metres, radians = np.concatenate(parts, 1)
    return {
        "start_distance": round(1e3 * float(np.median(metres)), 1),
        "start_angle": round(float(np.degrees(np.median(radians))), 1),
    }


def decision() -> dict[str, float]:
    """Return the median time of agents' decision and its step, a probe alone, ms."""
    took = {}
    kinds = {"servo": "servo", "servo-full": "servo", "servo-memory-full": "servo-memory"}
    for agent, kind in kinds.items():
        own: Any = load_agent(kind, WEIGHTS / agent, "cpu")
        own.view = "A4C-beating"
        core: ScanCore = core_for(own, get_task("A4C-beating"), 1, reward="oracle",
                                  phantom=make_ward("beating", "validation", 1, "cpu"))  # fmt: skip
        seeds = torch.arange(20)
        took[agent] = round(latency(core, own, seeds, DECISIONS, 1000)["value"], 1)
    return took


def ahead_of(tables: Mapping[str, Any]) -> dict[str, float]:
    """Return by tier how far train patients are ahead, points, where the best agent scanned any."""
    told = {tuple(row[:2]): float(row[4]) for row in tables.get("gap", {}).get("rows", [])}
    best = {tier: (hearts, f"`{BEST[tier]}`") for tier, hearts in TIERS.items()}
    return {tier: told[row] for tier, row in best.items() if row in told}


def gap(path: Path, found: Found) -> list[str]:
    """Return the table's row of train scores beside those of test.

    Raises:
        ValueError: of another split or view, or of other weights than the board's.
    """
    train = json.loads(path.read_text(encoding="utf-8"))
    task = train["task"]
    tier, view = task["definition"]["tier"], task["definition"]["view"]
    if task["split"] != "train" or view != "A4C":
        raise ValueError(f"{path}: not of A4C of train patients")
    scored = {name: found[name, view, tier, "test"] for name in DRAWN
              if (name, view, tier, "test") in found}  # fmt: skip
    own = [name for name, each in scored.items()
           if (each.get("weights") or {}).get("files") == train["weights"]["files"]]  # fmt: skip
    if not own:
        raise ValueError(f"{path}: of other weights than the board's")
    test = scored[own[0]]["metrics"]
    cells = [percent(each["success_declared"]) for each in (train["metrics"], test)]
    told = [measured(train["metrics"], "position_error", "mm"),
            measured(train["metrics"], "rotation_error", "°")]  # fmt: skip
    ahead = 100 * (train["metrics"]["success_declared"]["value"]
                   - test["success_declared"]["value"])  # fmt: skip
    return [TIERS[tier], f"`{own[0]}`", *cells, f"{ahead:+.1f}", *told]


def fill(arguments: list[str]) -> None:
    """Write the figures, tables and pictures."""
    found = on_boards()
    content = (
        json.loads(RESULT.read_text()) if RESULT.is_file() else {"schema": "racines.figures/1"}
    )
    figures: dict[str, Any] = content.get("figures", {})
    tables: dict[str, Any] = content.get("tables", {})
    figures |= starting("patients")
    if "--latency" in arguments:
        figures["decision"] = decision()
    rows = {tuple(row[:2]): row for row in tables.get("gap", {}).get("rows", [])}
    for argument in arguments:
        if not argument.startswith("--"):
            row = gap(Path(argument), found)
            rows[row[0], row[1]] = row
    if rows:
        columns = ["hearts", "agent", "train patients", "test patients", "points ahead",
                   "distance, train", "angle, train"]  # fmt: skip
        tables["gap"] = {"columns": columns, "rows": list(rows.values())}
    tables |= {"aims": aims(found, ahead_of(tables)), "ends": ends(found)}
    tables |= {"pathology": by_pathology(found), "never": never(), "left": left()}
    tables["secret"] = secret()
    draw_thresholds(THRESHOLDS)
    draw_learning(LEARNING)
    about = {
        "machine": "two cores of an AMD EPYC",
        "source": "measured once",
        "what": "how the episodes of agents on 140 test patients end",
        "command": "python -m tests.envs.patients.outcomes",
    }
    write_json(RESULT, content | about | {"figures": figures, "tables": tables})


if __name__ == "__main__":
    fill(sys.argv[1:])
