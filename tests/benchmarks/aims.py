"""What the project wants of itself on two cores: what was measured, and whether it is met.

Figures come from the files that the benchmarks and studies wrote; a verdict is drawn of them. What
no file has says "not measured".
"""

import json
from dataclasses import dataclass
from typing import Any

from tests.benchmarks.lines import FILE, number, read

RESULTS = FILE.with_name("results")
NOT_MEASURED = "not measured"
BENCH = "make bench"
FULL = "build at full size, 144,668 frames"
BUILD = "/usr/bin/time -v racines data build --profile paper --workers 2 --json"
SB3 = "Stable-Baselines3, its DummyVecEnv"


@dataclass(frozen=True)
class Aim:
    """A bound on a figure, and where it is from."""

    what: str
    bound: float
    unit: str
    command: str
    measured: float | None
    most: bool = False
    """Whether the bound is the most that it may be, and not the least."""

    @property
    def met(self) -> str:
        """What became of it."""
        if self.measured is None:
            return NOT_MEASURED
        kept = self.measured <= self.bound if self.most else self.measured >= self.bound
        return "met" if kept else "missed"


def of_line(work: str, key: str = "ours", peer: str | None = None) -> float | None:
    """Return a figure of the table of peers; None where the work was not measured."""
    found = [line[key] for line in read() if line["work"] == work and peer in (None, line["peer"])]
    return found[0] if found else None


def of_result(name: str, key: str) -> float:
    """Return a figure of a result file."""
    content = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return content["figures"][key]


def aims() -> list[Aim]:
    """Return all aims, with what was measured."""
    steps = "steps of 64 environments, {}, no grader"
    image, params = steps.format("image"), steps.format("params")
    compiled = "compiled steps of 64 environments, params, no grader"
    render, one = "render, 128 × 128, 64 poses", "render, 128 × 128, one pose"
    single, ppo = of_line(one), "PPO, 64 environments, pose"
    return [
        Aim(image, 2_000, "steps/s", BENCH, of_line(image)),
        Aim(params, 100_000, "steps/s", BENCH, of_line(params)),
        Aim(compiled, 100_000, "steps/s", BENCH, of_line(compiled)),
        Aim(render, 2_500, "frames/s", BENCH, of_line(render)),
        Aim(one, 1.5, "ms", BENCH, single and 1_000 / single, most=True),
        Aim(f"{ppo}, beside Stable-Baselines3", 1.5, "times as quick", BENCH,
            of_line(ppo, "ratio", SB3)),
        Aim("the default profile, with set-up and patients", 10, "minutes", "make repro",
            of_result("pipeline", "default_minutes"), most=True),
        Aim(FULL, 6, "minutes", BUILD, of_result("full-size", "minutes"), most=True),
        Aim(f"{FULL}: memory of a process", 1, "GB", BUILD, of_result("full-size", "gigabytes"),
            most=True),
        Aim("all lines beside peers", 10, "minutes", BENCH,
            of_result("bench", "seconds") / 60, most=True),
    ]  # fmt: skip


def table() -> dict[str, Any]:
    """Return the aims as a table of columns and rows, as the documentation takes it."""
    rows = [
        [
            aim.what, f"{'≤' if aim.most else '≥'} {aim.bound:,g} {aim.unit}",
            "–" if aim.measured is None else f"{number(aim.measured)} {aim.unit}",
            aim.met, f"`{aim.command}`",
        ]
        for aim in aims()
    ]  # fmt: skip
    return {"columns": ["what", "aim", "measured", "verdict", "command"], "rows": rows}


AIMS = table()
"""What the documentation shows."""
