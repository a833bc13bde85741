"""Measure one GPU; train the paper's agent and generators, and agents on patients; by value.

    make gpu                      half an hour; run it again to go on where it stopped
    make gpu BUDGET=10m OUT=gpu.json

Each part is written to the file as soon as it is known. A part that fails is noted, and the others
go on; the exit code is then 1.
"""

import argparse
import re
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
UNITS = {"s": 1, "m": 60, "h": 3600}
KEPT = 15.0
"""Seconds at the end of the budget in which nothing is begun."""
GENERATORS = 0.25
"""Share of what is left that agents leave to generators."""
Part = Callable[[float], tuple[bool, dict[str, Any]]]
"""Works for some seconds; returns whether it is done, and figures."""


def main(arguments: list[str] | None = None) -> int:
    """Run what is left to do; return the exit code."""
    options = _options(arguments)
    _registered()
    from racines_data.errors import RacinesError
    from racines_data.terminal import say

    try:
        return measure(options)
    except RacinesError as error:
        say(f"racines: {error}", err=True)
        return 1


def measure(options: argparse.Namespace) -> int:
    """Run the parts in order within the budget."""
    from racines_data.errors import RacinesError
    from racines_data.terminal import say
    from racines_models.devices import resolve_device
    from tests.benchmarks.gpu.document import DONE, FAILED, UNDER_WAY, Document
    from tests.benchmarks.gpu.sizes import TINY, Sizes

    end = time.monotonic() + options.budget
    device = resolve_device(options.device)
    sizes = TINY if options.tiny else Sizes()
    known = parts(device, sizes, options.work, end)
    if unknown := set(options.parts or ()) - set(known):
        raise RacinesError(f"unknown part {min(unknown)!r}: choose of {', '.join(known)}")
    document, failed = Document(options.out, device, options.tiny), []
    document.write()
    for name, (part, share) in known.items():
        if document.state(name) == DONE or (options.parts and name not in options.parts):
            continue
        left = end - time.monotonic() - KEPT
        if left <= 0:
            say(f"{name}: no time left; run it again to go on")
            break
        began = time.monotonic()
        say(f"{name} …")
        try:
            done, figures = part(left * share)
        except Exception as error:  # whatever a part meets, the others are worth their time
            traceback.print_exc()
            figures = {**document.parts.get(name, {}).get("figures", {}), "error": str(error)}
            document.put(name, FAILED, time.monotonic() - began, figures)
            failed.append(name)
            continue
        document.put(name, DONE if done else UNDER_WAY, time.monotonic() - began, figures)
        shown = {key: value for key, value in figures.items() if isinstance(value, (int, float))}
        say(f"{name}: {shown if shown else 'done' if done else 'under way'}")
    say(f"written: {document.path}" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return 1 if failed else 0


def parts(device: str, sizes: Any, work: Path, end: float) -> dict[str, tuple[Part, float]]:
    """Return the parts in order of value, each with the share of what is left that it may take."""
    from tests.benchmarks.gpu import patients, speeds, training
    from tests.benchmarks.gpu.correctness import correctness

    def at_once(work: Callable[..., dict[str, Any]], *more: Any) -> Part:
        return lambda _: (True, work(device, sizes, *more))

    def late() -> bool:
        return time.monotonic() > end - KEPT

    found: dict[str, tuple[Part, float]] = {"correctness": (at_once(correctness), 1.0)}
    hearts = [speeds.hearts] if sizes.hearts else []
    for speed in (speeds.render, *hearts, speeds.images, speeds.params, speeds.ppo):
        found[speed.__name__] = at_once(speed, late), 1.0
    for view in sizes.views:
        found[f"agent-{view}"] = partial(training.agent, view, device, sizes, work), 1 - GENERATORS
    found["data"] = partial(training.data, device, sizes, work), 1.0
    for name in sizes.generators:
        found[f"generator-{name}"] = partial(training.generator, name, device, sizes, work), 1.0
    for name in sizes.patients:
        found[f"grid-{name}"] = partial(patients.grid, name, device, sizes, work), 1.0
    return found


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.gpu", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--device", default="cuda", help="cuda or cuda:N")
    parser.add_argument("--budget", type=_seconds, default="25m", help="25m, 90s, 1h")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/results/gpu.json")
    parser.add_argument("--work", type=Path, default=ROOT / "envs/runs/gpu", help="trainings")
    parser.add_argument("--parts", type=lambda text: text.split(","), help="only these")
    parser.add_argument("--tiny", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def _seconds(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r} is no time: give 25m, 90s or 1h")
    return float(found[1]) * UNITS[found[2]]


def _registered() -> None:
    """Let a checkout that is not installed, as on a machine without a network, know its plug-ins.

    They are entry points of the package's metadata, which an installation writes.
    """
    try:
        version("racines")
        return
    except PackageNotFoundError:
        pass
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    place = Path(tempfile.mkdtemp(prefix="racines-metadata-"))
    folder = place / f"racines-{project['version']}.dist-info"
    folder.mkdir()
    about = f"Metadata-Version: 2.4\nName: racines\nVersion: {project['version']}\n"
    (folder / "METADATA").write_text(about)
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in points.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")
    sys.path.insert(0, str(place))


if __name__ == "__main__":
    sys.exit(main())
