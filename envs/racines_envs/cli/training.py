"""The command `racines train agent`. Heavy imports stand inside, so that --help is instant."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.cli.options import given, matching, overrides, read_settings, seed_of
from racines_data.errors import RacinesError
from racines_data.terminal import say_page
from racines_envs.cli.settings import Env, Goal, Name, Tier, on_tier, open_env, phantom_config
from racines_models.cli.device import OneDevice

if TYPE_CHECKING:
    from racines_data.engines import Engine
    from racines_models.protocol import Run
    from racines_models.training.sets import Training


def train_agent(
    agents: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="name",
            help="Registered agents, module:Class, runs of the section agents, or a pattern of "
            "those.  [default: ppo]",
        ),
    ] = None,
    view: opt.View = None,
    tier: Tier = None,
    env: Env = None,
    goal: Goal = None,
    observation: opt.Observation = None,
    reward: opt.Reward = None,
    backend: opt.Backend = None,
    generator: opt.Generator = None,
    grader: opt.Grader = None,
    encoder: Annotated[
        str | None, typer.Option(help="What looks at images: a folder, or pose.")
    ] = None,
    data: opt.OtherData = None,
    frames: Annotated[int | None, typer.Option(help="Environment steps.")] = None,
    device: OneDevice = None,
    seed: opt.Seed = None,
    name: Name = None,
    out: opt.OwnOut = None,
    resume: opt.Resume = None,
    settings: opt.Set = None,
    params: opt.Params = None,
    profile: opt.Profile = None,
    engine: opt.Engine = "local",
    address: opt.Address = None,
    workers: opt.Workers = None,
    as_json: opt.AsJson = False,
) -> None:
    """Train agents into envs/runs/<run>, or --out; options override the settings.

    With --env replay:FOLDER in the recorded frames of a dataset, from starts of its train split,
    into envs/runs/<run>-replay-<folder>-<view>; --set then also takes the settings of the replay.
    With `repeats: N` in an entry, N seeds: the first in that folder, seed n in its seed-<n>.
    Several names, or a pattern, are a set, each in a folder of its own, of --out too; one that was
    killed goes on. --workers N trains so many seeds at a time, --engine ray on a cluster, in
    folders that all nodes see. With several `collectors` in the settings of one agent it is these
    that they spread, and seeds follow each other.
    """
    from racines_envs.evaluation.agent_specs import SECTIONS
    from racines_models.cli.device import spread
    from racines_models.cli.output import tell_trained, told_of
    from racines_models.training.sets import train_set

    values = read_settings(params, profile)
    known = [each for section in SECTIONS for each in values.get(section) or {}]
    chosen = matching(agents or ["ppo"], known, " and ".join(SECTIONS))
    if name and len(chosen) > 1:
        raise RacinesError("--name is of one run: give one agent, or leave --name out")
    if goal and not env:
        raise RacinesError("--goal needs --env replay:FOLDER")
    own = given(
        observation=observation, reward=reward, backend=backend, generator=generator,
        grader=grader, encoder=encoder, frames=frames, device=device,
    )  # fmt: skip
    asked = _Asked(view, tier, env, goal, name, data, device, own, overrides(settings))
    made = [asked.training(each, values) for each in chosen]
    made = [
        replace(each, run=replace(
            each.run, seed=seed_of(values, seed), resume=resume, progress=not as_json,
            folder=each.run.folder if out is None
            else out / each.run.folder.name if len(made) > 1 else out,
        ))
        for each in made
    ]  # fmt: skip
    fits: list[Any] = [each.fit for each in made]
    devices = {getattr(each.config, "device", None) for each in fits} - {None, "cpu"}
    with spread(engine, address, next(iter(devices), None), workers) as pool:
        beside = pool
        if len(made) == 1 and getattr(fits[0].config, "collectors", 1) > 1:
            made = [replace(made[0], fit=replace(fits[0], engine=pool))]
            beside = None
        metrics = train_set(made, beside, told_of(made))
    if len(made) > 1:
        tell_trained(made, metrics, as_json, lambda own: "settings, metrics and policy, if any")
        return
    folder = made[0].run.folder
    page = (folder / "metrics.json").read_text(encoding="utf-8")
    say_page(page if as_json else f"settings, metrics and policy, if any, are in {folder}")


@dataclass(frozen=True)
class _Fit:
    """Trains an agent by its settings, in the world that they name."""

    cls: Any
    config: Any
    where: dict[str, Any]
    engine: "Engine | None" = None
    """Where its environments act, of one that has several collectors."""

    def __call__(self, run: "Run") -> dict[str, Any]:
        from racines_envs.evaluation.agent_specs import read_json

        told = {"seed": run.seed, "resume": run.resume, "progress": run.progress}
        gathers = {} if self.engine is None else {"engine": self.engine}
        self.cls.train(self.config, run.folder, **told, **self.where, **gathers)
        return read_json(run.folder / "metrics.json")


@dataclass(frozen=True)
class _Asked:
    """What the options ask of each agent."""

    view: str | None
    tier: str | None
    env: str | None
    goal: str | None
    name: str | None
    data: Path | None
    device: str | None
    own: dict[str, Any] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)

    def training(self, spec: str, values: dict[str, Any]) -> "Training":
        """Return the training of an agent by the settings of all sections and these."""
        from racines_data.config import fill
        from racines_envs.agents import agent_class
        from racines_envs.agents.policy import arms_told
        from racines_envs.evaluation.agent_specs import find_entry
        from racines_models.protocol import Run
        from racines_models.training.sets import Training

        entry = find_entry(values, spec, self.name)
        cls = agent_class(entry.agent)
        phantom, more, view, own = phantom_config(values), self.more, self.view, self.own
        if self.env:
            where_to = view or (None if self.goal or "goal" in more else entry.view)
            goal = given(goal=self.goal)
            phantom, more, label = open_env(self.env, values, where_to, goal | more, self.device)
            entry = entry if self.name else replace(entry, name=f"{entry.name}-{label}")
            view, own = phantom.aim.view, own | {"backend": "replay"}
        # What learns no view of its own, as a floor, may still learn on a tier.
        known = {each.name for each in fields(cls.Config)}
        wanted = {"tier": self.tier} if "tier" in known else {"view": on_tier(view, self.tier)}
        if self.env:
            wanted = {"view": view} if "view" in known else {}
            own = own if "backend" in known else {k: v for k, v in own.items() if k != "backend"}
        config: Any = fill(cls.Config, entry.settings | given(**wanted) | own | more, entry.where)
        beside = getattr(cls, "beside", ())
        decides = {key: each for key, each in arms_told(config).items() if key not in beside}
        what = {"agent": entry.agent, "config": decides, "env": self.env, "data": self.data}
        where = {"phantom": phantom, "data": self.data}
        return Training(_Fit(cls, config, where), Run(entry.folder), entry.repeats, what)
