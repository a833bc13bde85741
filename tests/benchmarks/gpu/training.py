"""The paper's agent and generators, each by the command that users have, stopped in time.

A training that is stopped leaves a checkpoint; the next run goes on from there.
"""

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.terminal import say
from tests.benchmarks.gpu.sizes import Sizes

ROOT = Path(__file__).parents[3]
MAIN = "import sys; from racines_leaderboard.cli.command import main; sys.exit(main())"
PATIENCE = 20.0
"""Seconds that a training may take to end when asked to."""


def agent(view: str, device: str, sizes: Sizes, work: Path, left: float) -> tuple[bool, dict]:
    """Train the paper's agent on a view for so many seconds; return whether it is done, and how."""
    out = work / f"agent-{view}"
    if not (out / "metrics.json").is_file():
        words = ["train", "agent", "ppo", "--profile", "paper", "--view", view, "--device", device]
        words += [
            "--out",
            str(out),
            *(f"--set={key}={value}" for key, value in sizes.agent.items()),
        ]
        run(words, out, left)
    metrics = _read(out / "metrics.json")
    if metrics:
        last = metrics["history"][-1]
        return True, {
            "frames": metrics["frames"],
            "seconds": metrics["seconds"],
            "frames_per_second": round(metrics["frames"] / max(metrics["seconds"], 0.1), 1),
            "success": metrics["validation_success"],
            "steps": metrics["validation_steps"],
            "return": last["validation/return"],
            "history": metrics["history"],
        }
    told = _read(out / "dvclive/metrics.json")
    seen = told.get("validation", {})
    figures = {"frames": told.get("step"), "frames_per_second": told.get("frames_per_second")}
    figures |= {name: seen.get(name) for name in ("success", "steps", "return")}
    figures["history"] = _validations(out) or None
    return False, {name: value for name, value in figures.items() if value is not None}


def _validations(out: Path) -> list[dict[str, float]]:
    """Return the validations of a run under way, as a finished run's metrics hold them."""
    rows: dict[int, dict[str, float]] = {}
    for path in sorted((out / "dvclive/plots/metrics/validation").glob("*.tsv")):
        for line in path.read_text().splitlines(keepends=True)[1:]:
            if not line.endswith("\n"):  # torn by a kill
                continue
            step, value = line.split("\t")
            row = rows.setdefault(int(step), {"frames": int(step)})
            row[f"validation/{path.stem}"] = float(value)
    return [rows[step] for step in sorted(rows)]


def data(device: str, sizes: Sizes, work: Path, left: float) -> tuple[bool, dict]:
    """Build the profile's dataset of the phantom, which the generators learn from."""
    out = work / "data"
    if not (out / "manifest.json").is_file():
        words = ["data", "build", "--profile", sizes.profile, "--source", "phantom"]
        run([*words, "--out", str(out)], work / "data-build", left)
    manifest = _read(out / "manifest.json")
    if not manifest:
        return False, {}
    return True, {"digest": manifest["digest"], "recipe_digest": manifest["recipe_digest"]}


def generator(name: str, device: str, sizes: Sizes, work: Path, left: float) -> tuple[bool, dict]:
    """Train one of the profile's generators for so many seconds."""
    out = work / f"generator-{name}"
    if not (out / "metrics.json").is_file():
        words = ["train", "generator", name, "--profile", sizes.profile, "--device", device]
        run([*words, "--data", str(work / "data"), "--out", str(out)], out, left)
    told = _read(out / "dvclive/metrics.json")
    figures: dict[str, Any] = {"images": told.get("step")} if "step" in told else {}
    figures["losses"] = {key: value for key, value in told.items() if key != "step"}
    return (out / "metrics.json").is_file(), figures


def run(words: list[str], log: Path, seconds: float) -> bool:
    """Run a command of `racines`, its words in LOG.log; stop it after some seconds.

    Returns:
        Whether it came to its end.

    Raises:
        RacinesError: it failed, with the end of what it said.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    file = log.with_name(f"{log.name}.log")
    say(f"racines {shlex.join(words)}  (at most {seconds:.0f} s; {file})")
    with file.open("a") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", MAIN, *words], cwd=ROOT, stdout=out, stderr=out,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )  # fmt: skip
        try:
            code = process.wait(timeout=max(seconds, 1.0))
        except subprocess.TimeoutExpired:
            _stop(process)
            return False
        except BaseException:
            _stop(process)
            raise
    if code:
        told = file.read_text().strip().splitlines()[-3:]
        raise RacinesError(f"racines {' '.join(words[:3])}: exit {code}: {' | '.join(told)}")
    return True


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    began = time.monotonic()
    while process.poll() is None and time.monotonic() - began < PATIENCE:
        time.sleep(0.1)
    if process.poll() is None:
        process.kill()
        process.wait()


def _read(path: Path) -> Mapping[str, Any]:
    """Return a JSON file; nothing where it is not there, or half-written by who was stopped."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
