"""What an arm costs: tasks, sweeps and time with a UR5e in the loop, beside a free probe.

python -m tests.envs.studies.arm DATA SAC      # writes docs/results/arm.json, docs/images/arm.png
python -m tests.envs.studies.arm picture       # the picture alone; needs neither data nor a run

DATA is the folder of a dataset of the simulated heart, SAC that of a trained run of `sac`. Starts
are those that agents are judged on.
"""

import sys
import time
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from racines_data.files import write_json
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.store.frames import open_store
from racines_data.views import VIEWS
from racines_data.world import STEP_SECONDS
from racines_envs.agents import load_agent
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.protocol import acts
from racines_envs.agents.rollout import rollout
from racines_envs.apis.rendering import History, compose
from racines_envs.robots.following import ArmRobot, make_robot
from racines_envs.task.starts import evaluation_seeds
from racines_envs.worlds.making import make_core

ROOT = Path(__file__).parents[3]
RESULT, PICTURE = ROOT / "docs/results/arm.json", ROOT / "docs/images/arm.png"
STARTS, ROWS, STEPS, RATE = 100, 64, 100, 25.0


def episodes(view: str, agent: Any, robot: str) -> list[Any]:
    """Return found (%), steps (median) and refused by the arm (per 100 steps) from the starts."""
    core = make_core(
        view, STARTS, observation="params", reward="oracle", robot=robot, action=acts(agent)
    )
    final = rollout(core, agent, evaluation_seeds(STARTS)).final
    refused = 100.0 * float(core.state.arm_hits.sum()) / float(core.state.steps.sum())
    found = 100.0 * float(final["success"].mean())
    return [
        f"{found:.0f}",
        f"{float(torch.as_tensor(final['steps']).median()):.0f}",
        f"{refused:.1f}",
    ]


def rate(robot: str) -> float:
    """Return steps a second of 64 rows that look at the pose alone."""
    core = make_core("SC", ROWS, observation="params", reward="oracle", robot=robot)
    core.reset(0)
    action = torch.arange(ROWS) % 12
    for _ in range(5):
        core.step(action, autoreset=True)
    began = time.perf_counter()
    for _ in range(STEPS):
        core.step(action, autoreset=True)
    return ROWS * STEPS / (time.perf_counter() - began)


def sweeps(folder: Path) -> tuple[int, float]:
    """Return how many moves from frame to frame there are, and the share that the arm cannot do."""
    store, robot = open_store(folder), make_robot("ur5e", "cpu")
    assert isinstance(robot, ArmRobot)
    share = STEP_SECONDS * RATE  # a move between frames takes less than a step
    asked = missed = 0
    for trajectory in range(len(store.trajectories)):
        rows = (store.trajectory_index == trajectory).nonzero().squeeze(1)
        pose = parameters_to_pose(store.parameters[rows].double())
        joints = robot.begin(Pose(*(part[:1] for part in pose)))
        for row in range(1, len(rows)):
            at = Pose(*(part[row : row + 1] for part in pose))
            later, there = robot.follow(joints, at)
            fast = ((later - joints).abs() * share > robot.step).any(1)
            asked, missed = asked + 1, missed + int(~there | fast)
            joints = later
    return asked, missed / asked


def picture() -> None:
    """Draw the arm on its way to the four-chamber view."""
    core, agent = (
        make_core("A4C", 1, observation="params", reward="oracle", robot="ur5e"),
        PlannerAgent(),
    )
    agent.attach(core)
    seen, history = core.reset(0), History(1)
    history.note(core)
    while not bool(core.state.done.all()):
        action = agent.act(seen, core.decision_seeds())
        seen = core.step(action).observation
        history.note(core, action)
    Image.fromarray(compose(core, 0, history)).save(PICTURE, optimize=True)


def main() -> None:
    """Measure, and write; or draw the picture alone."""
    if sys.argv[1:] == ["picture"]:
        return picture()
    data, sac = Path(sys.argv[1]), Path(sys.argv[2])
    rows = [
        ["planner", view, *episodes(view, PlannerAgent(), "free")[:2],
         *episodes(view, PlannerAgent(), "ur5e")]
        for view in VIEWS
    ]  # fmt: skip
    for name, folder in (("ppo", ROOT / "envs/weights/ppo"), ("sac", sac)):
        agent = load_agent(name, folder)
        rows.append(
            [name, "SC", *episodes("SC", agent, "free")[:2], *episodes("SC", agent, "ur5e")]
        )
    moves, missed = sweeps(data)
    alone, arm = rate("free"), rate("ur5e")
    picture()
    write_json(RESULT, {
        "schema": "racines.figures/1",
        "what": "a UR5e in the loop: agents, simulated sweeps, steps a second of 64 rows",
        "command": "python -m tests.envs.studies.arm data/racines envs/runs/sac",
        "machine": "one core of an AMD EPYC (Zen 4), beside other work",
        "source": "measured once",
        "figures": {
            "starts": STARTS, "moves": moves, "missed_percent": round(100.0 * missed, 2),
            "free_steps": round(alone, -2), "arm_steps": round(arm, -2),
            "share_percent": round(100.0 * arm / alone),
        },
        "tables": {"episodes": {
            "columns": ["agent", "view", "found, free (%)", "steps", "found, UR5e (%)", "steps",
                        "refused by the arm (per 100 steps)"],
            "rows": rows,
        }},
    })  # fmt: skip


if __name__ == "__main__":
    main()
