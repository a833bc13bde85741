"""The core is small, stands without its extras, and says which one is lacking."""

import re
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, requires

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from racines_data.errors import RacinesError
from racines_data.extras import EXTRAS, install_hint, needed
from tests.conftest import ROOT
from tests.modules import modules

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OPTIONAL = PROJECT["optional-dependencies"]
PINS = [
    Requirement(line)
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if "==" in line and not line.startswith("#")
]
MOST = 60
"""Packages of the core beside torch and what torch itself needs, ours included."""
STUDIO = "racines_leaderboard.studio"
NEEDS_ITS_EXTRA = {
    "racines_envs.agents.belief.transform": "train",
    "racines_envs.apis.torchrl_env": "train",
    "racines_envs.apis.sb3": None,
    "racines_envs.apis.tianshou": None,
    "racines_envs.apis.lerobot": None,
    "racines_envs.apis.envhub": None,
}
"""Modules that are nothing without a package, and the extra that brings it; None: no extra of ours.
So is the Studio."""

CORE = """
import importlib, sys
from importlib.machinery import PathFinder
LACKING = set(sys.argv[1].split(","))
class Others(PathFinder):
    @classmethod
    def find_spec(cls, name, *where):
        return None if name.partition(".")[0] in LACKING else super().find_spec(name, *where)
sys.meta_path[:] = [Others if each is PathFinder else each for each in sys.meta_path]
for name in sys.argv[2].split(","):
    importlib.import_module(name)
import gymnasium
env = gymnasium.make("racines_envs:racines/SC-v0", observation="params", reward="oracle")
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
from racines_envs.agents import load_agent
from racines_envs.agents.ppo import PPOConfig, PPOAgent
load_agent("ppo", "envs/weights/ppo")
from racines_data.errors import RacinesError
try:
    PPOAgent.train(PPOConfig(frames=64), "unused")
except RacinesError as error:
    print(error)
try:
    from racines_envs import ScanEnv
except RacinesError as error:
    print(error)
assert not LACKING & set(sys.modules)
"""


def names(lines: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(line).name) for line in lines}


def place(asked: Requirement) -> tuple[str, frozenset[str]]:
    return canonicalize_name(asked.name), frozenset(asked.extras)


def reached(lines: list[str]) -> set[str]:
    """Return the distributions that requirements bring, as they are installed here."""
    found, todo = (
        set(),
        [(canonicalize_name(r.name), frozenset(r.extras)) for r in map(Requirement, lines)],
    )
    while todo:
        one = name, extras = todo.pop()
        if one in found:
            continue
        found.add(one)
        for line in requires(name) or ():
            asked = Requirement(line)
            marker = asked.marker
            if marker is None or any(marker.evaluate({"extra": e}) for e in extras | {""}):
                todo.append(place(asked))
    return {name for name, _ in found}


def test_the_core_is_small():
    core = reached(PROJECT["dependencies"]) - reached(["torch"])
    assert len(core) + 1 <= MOST, sorted(core)
    assert not core & {"opencv-python", "dvc", "dvclive", "torchrl", "accelerate", "gradio"}


def test_each_extra_is_what_the_code_looks_for():
    assert set(OPTIONAL) == {*EXTRAS, "dvc", "all", "dev"}
    for extra, imported in EXTRAS.items():
        assert {canonicalize_name(each) for each in imported} == names(OPTIONAL[extra]), extra
    (everything,) = map(Requirement, OPTIONAL["all"])
    assert everything.name == "racines" and everything.extras == {*EXTRAS, "dvc"}
    assert "racines[all]" in OPTIONAL["dev"]
    assert not names(PROJECT["dependencies"]) & names(sum(map(OPTIONAL.get, EXTRAS), []))


def test_the_pins_are_those_of_what_is_asked_for():
    pinned = {canonicalize_name(each.name) for each in PINS}
    tools = [line for line in OPTIONAL["dev"] if not line.startswith("racines")]
    extras = [line for extra in [*EXTRAS, "dvc"] for line in OPTIONAL[extra]]
    try:
        asked = reached([*PROJECT["dependencies"], *extras, *tools])
    except PackageNotFoundError as error:
        pytest.skip(f"{error.name} is not installed: pip install -e '.[dev]'")
    assert pinned <= asked, sorted(pinned - asked)
    assert names([*PROJECT["dependencies"], *extras, *tools]) <= pinned


@pytest.mark.slow
def test_the_core_loads_steps_and_refuses_without_any_extra():
    lacking = {each for packages in EXTRAS.values() for each in packages} - {"networkx"}
    lacking |= {"dvc", "dvclive", "cv2", "stable_baselines3", "tianshou", "lerobot", "av"}
    ours = [
        name for name in modules() if name not in NEEDS_ITS_EXTRA and not name.startswith(STUDIO)
    ]
    words = [sys.executable, "-c", CORE, ",".join(lacking), ",".join(ours)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    training, environment = done.stdout.splitlines()
    assert training == 'training ppo needs torchrl: pip install "racines[train]"'
    assert re.fullmatch(r'ScanEnv needs \w+: pip install "racines\[train\]"', environment)


def test_what_is_absent_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch):
    for module in ("captum", "captum.attr"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(RacinesError, match=r'a map needs captum: pip install "racines\[explain\]"'):
        needed("captum.attr", "a map")
    assert needed("json", "nothing") is import_module("json")
    assert install_hint("elsewhere") == "pip install elsewhere"


def test_what_is_pinned_runs_on_the_oldest_python():
    """A pin whose package asks for a later patch release leaves nothing to install on Debian's."""
    oldest = PROJECT["requires-python"].removeprefix(">=") + ".0"
    asked = {}
    for pin in PINS:
        try:
            found = distribution(pin.name)
        except PackageNotFoundError:  # of another platform
            continue
        if pin.specifier.contains(found.version):
            asked[pin.name] = found.metadata["Requires-Python"] or ""
    late = {name: each for name, each in asked.items() if not SpecifierSet(each).contains(oldest)}
    assert len(asked) > 200 and not late, late
