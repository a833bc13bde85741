"""From names to a core: what `gymnasium.make`, `ScanEnv` and the evaluation all call."""

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from racines_data.config import fill
from racines_data.digest import recipe_digest
from racines_data.errors import RacinesError
from racines_data.imaging import ImageSource
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig
from racines_data.phantom.model import shared_phantom
from racines_data.phantom.saved import provenance
from racines_data.views import HEART
from racines_data.world import World
from racines_envs.robots.arm import FREE, Arm
from racines_envs.task.core import ScanCore
from racines_envs.task.motion import DISCRETE
from racines_envs.task.names import BEATING, HEART_TIER, PATIENTS, tier_of
from racines_envs.task.rewards import Reward, RewardConfig, get_reward
from racines_envs.task.sensing import Encoder, ForceSource
from racines_envs.task.tasks import Task, get_task
from racines_envs.worlds.backends import JudgeLike, make_backend, make_grader, usual_grader
from racines_envs.worlds.forces import make_forces
from racines_envs.worlds.recorded.world import Recordings
from racines_envs.worlds.ward import Ward, make_ward
from racines_models.devices import resolve_device

if TYPE_CHECKING:
    from racines_data.store.frames import FrameStore

WorldLike = World | PhantomConfig | Mapping[str, Any] | Path | str | None
"""What names a world: itself, a phantom's settings (as a mapping too, as JSON has them), the folder
or name of a phantom of one's own, `recorded`, or None for the default."""
RECORDED = "recorded"  # the `phantom` that stands for the recordings themselves
ANY = "any"  # the `data_version` that lets everything pass
_SHORTEST = 8  # characters of a digest that name a dataset


def check_settings(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return settings that `make_core` knows.

    Raises:
        RacinesError: one that it does not; with the nearest.
    """
    known = [*inspect.signature(make_core).parameters][2:]
    for name in settings:
        if name not in known:
            near = [each for each in known if each.startswith(name)]
            near = near or get_close_matches(name, known, 1)
            guess = f": did you mean {near[0]!r}?" if near else ""
            raise RacinesError(f"unknown setting {name!r}{guess} (known: {', '.join(known)})")
    return settings


def make_core(
    view: str | Task,
    num_envs: int = 1,
    *,
    backend: str | ImageSource = "phantom",
    observation: str = "image",
    reward: str | Reward | None = None,
    phantom: WorldLike = None,
    anatomy: str | None = None,
    generator: ImageSource | str | Path | None = None,
    grader: JudgeLike = None,
    termination: str | None = None,
    rewards: RewardConfig | None = None,
    device: torch.device | str = "cpu",
    encoder: Encoder | None = None,
    data: Path | str | None = None,
    forces: ForceSource | str = "auto",
    data_version: str | None = None,
    split: str | None = None,
    patients: int | Sequence[int] | None = None,
    action: str = DISCRETE,
    robot: str | Arm = FREE,
    compile: bool = False,
) -> ScanCore:
    """Build the batched core of a task.

    Args:
        view: A target view of the phantom's anatomy, a task's name, or a task of your own.
        num_envs: Rows.
        backend: `phantom`, `generator`, `replay`, or an object that makes images of parameters.
        observation: `image`, `params` or `multimodal`.
        reward: `paper` (by the grader; the one heart's default), `oracle` (the same by the
            phantom's truth), `shaped` (the default on patients), the name of another's,
            `module:REWARD`, or a `Reward`.
        phantom: A phantom or its configuration; the shared one of the anatomy by default, and for
            `replay` that of the dataset. `recorded` for the recordings in its place, which stand
            there anyway where they are no phantom's. The folder or name of a phantom of one's own:
            the organ in the block, or the heart that all patients have. `Recordings` stand for
            themselves, images and forces included (`open_recordings`); their reward is `shaped`.
        anatomy: Whose view it is; the phantom's anatomy by default, or else the heart.
        generator: For the backend `generator`: a name, run folder, `module:Class`, `FILE.onnx` or
            object; see `racines_envs.worlds.backends.open_source`.
        grader: Run folder or object; for a reward that needs one, the tier's (`usual_grader`).
        termination: Instead of the task's: `first_hit`, `k_hits` or `timeout`.
        rewards: The numbers of the reward.
        device: Where the tensors live.
        encoder: A frozen network that the agent looks through; see `ScanCore`.
        data: Folder of the dataset to replay or to fit forces on; data/racines by default.
        forces: `auto` (recorded ones when recordings are replayed, else the contact model),
            `contact`, `recorded`, `fitted` (on `data`), or an object with `wrench(pose)`.
        data_version: The dataset that generator, grader and recordings have to come from; they have
            to agree in any case, unless it is `any`. See `check_datasets`.
        split: Whose patients: `train` (the default), `validation` or `test`; for tasks on patients.
        patients: So many of the split, or their seeds; see `make_ward`.
        action: `discrete`, the thirteen steps, or `velocity`, a twist; see `task.motion`.
        robot: `free`, or the arm that carries the probe: `ur5e`, another's name, `module:ARM`.
        compile: Compile steps that are seen by the pose; see `task.compiled`.

    Raises:
        RacinesError: any name that is unknown or any artefact that is not there.
    """
    device = resolve_device(device)
    if isinstance(phantom, Mapping):
        phantom = fill(PhantomConfig, phantom, "phantom")
    if isinstance(phantom, Path | str) and phantom != RECORDED and _tier(view) == HEART_TIER:
        phantom = PhantomConfig(anatomy=str(phantom))
    task = find_task(view, None if phantom == RECORDED else phantom, anatomy)
    alone = isinstance(phantom, Recordings)
    reward = reward or ("paper" if task.tier == HEART_TIER and not alone else "shaped")
    if isinstance(phantom, Recordings):
        backend, forces = _check_alone(phantom, backend, forces, action, robot)
    phantom = _world_of(task, phantom, backend, device, split, patients)
    if termination is not None:
        task = dataclasses.replace(task, termination=termination)
    parts: dict[str, Any] = {}
    if get_reward(reward).needs_judge and grader is None:
        grader = usual_grader(task)
    judge = None if grader is None else make_grader(grader, device, task)
    if judge is not grader:
        parts["the grader"] = trained_on(grader)
    store = _open_data(backend, forces, data, task)
    if store is not None:
        parts[f"dataset {store.root}"] = trained_on(store.manifest)
        backend, phantom = _recordings(store, backend, phantom, device, data_version)
    if phantom == RECORDED:
        raise RacinesError("phantom='recorded' needs the backend 'replay'")
    phantom = make_phantom(phantom, device, task.anatomy)
    images = make_backend(backend, phantom, generator, device)
    if backend == "generator":
        parts["the generator"] = trained_on(images)
    check_datasets(parts, data_version)
    made = ScanCore
    if compile:
        from racines_envs.task.compiled import CompiledCore as made
    return made(
        task, phantom, images, judge, observation, reward, rewards, num_envs, device, encoder,
        make_forces(forces, images, phantom, store, device), action, robot,
    )  # fmt: skip


def _check_alone(
    world: Recordings,
    backend: str | ImageSource,
    forces: ForceSource | str,
    action: str,
    robot: str | Arm,
) -> tuple[str | ImageSource, ForceSource | str]:
    """Return backend and forces as recordings that stand alone have them: by their own frames."""
    if forces == "fitted":
        raise RacinesError("forces='fitted' are for phantoms: a replay has recorded ones")
    if world.masks and action != DISCRETE:
        raise RacinesError("replay.beyond='mask' is of the thirteen steps: use action='discrete'")
    if world.masks and robot != FREE:
        raise RacinesError("replay.beyond='mask' knows no arm's joints: use beyond='refuse'")
    own = "phantom" if backend == "replay" else backend
    return own, "auto" if forces == "recorded" else forces


def _tier(view: str | Task) -> str:
    return view.tier if isinstance(view, Task) else tier_of(view)


def _world_of(
    task: Task, phantom: WorldLike, backend: str | ImageSource, device: torch.device | str,
    split: str | None, patients: int | Sequence[int] | None,
) -> WorldLike:  # fmt: skip
    """Return the ward that a task on patients needs; for the one heart what was given."""
    named = split is not None or patients is not None
    if task.tier == HEART_TIER:
        if named or isinstance(phantom, Ward):
            raise RacinesError(f"{task.id} has one heart and no patients: use {task.view}-patients")
        return phantom
    if backend == "replay" or backend == "generator":
        raise RacinesError(f"{task.id}: backend {backend!r} knows no patients: use 'phantom'")
    if isinstance(phantom, Ward):
        if named or phantom.pool.beating != (task.tier == BEATING):
            raise RacinesError(f"{task.id}: the ward that is given has its own patients and tier")
        return check_shown(task, phantom)
    if isinstance(phantom, Path | str):
        own = make_ward(task.tier, split or "train", patients, device, phantom=str(phantom))
        return check_shown(task, own)
    if phantom is not None:
        raise RacinesError(
            f"{task.id}: its world is a ward of patients, not one heart ({type(phantom).__name__})"
        )
    return make_ward(task.tier, split or "train", patients, device)


def check_shown(task: Task, ward: Ward) -> Ward:
    """Refuse a task on a view that the hearts of a ward do not have, as one's own may not."""
    shown = ward.pool.shown
    lacking = [view for view in ward.views if view not in shown]
    if task.view in lacking or (task.any_view and lacking):
        told = "has no " + ", ".join(lacking) if task.any_view else f"has no view {task.view}"
        raise RacinesError(
            f"{task.id}: the phantom's heart {told}, but {', '.join(shown)}: name one of these, or "
            "give the view in its tissues.yaml"
        )
    return ward


def _open_data(
    backend: str | ImageSource, forces: ForceSource | str, data: Path | str | None, task: Task
) -> "FrameStore | None":
    """Open the dataset if the backend or the forces need it, and check whose views it has."""
    store = None
    if not isinstance(backend, str):
        from racines_envs.worlds.replay import Replay

        store = backend.store if isinstance(backend, Replay) else None
    if store is None:
        if backend != "replay" and forces != "fitted":
            return None
        from racines_data.store.frames import open_store

        store = open_store(data)
    labels = task.labels
    if store.labels != labels:
        raise RacinesError(
            f"{store.root}: its labels are {', '.join(store.labels)}, the {task.anatomy} has "
            f"{', '.join(labels)}: give the dataset of that anatomy"
        )
    return store


def _recordings(
    store: "FrameStore", backend: str | ImageSource, phantom: WorldLike,
    device: torch.device | str, data_version: str | None,
) -> tuple[str | ImageSource, WorldLike]:  # fmt: skip
    """Return the replay of a dataset, and the phantom it is of or the recordings in its place.

    Where no recordings are replayed, both as they are given. A phantom beside recordings of none is
    not asked; another phantom than the dataset's is refused, unless any dataset may pass.
    """
    from racines_envs.worlds.replay import RecordedWorld, Replay, source_phantom

    replay = Replay(store, device) if backend == "replay" else backend
    if not isinstance(replay, Replay) or isinstance(phantom, RecordedWorld):
        return replay, phantom
    own = source_phantom(store)
    if phantom == RECORDED or own is None:
        return replay, RecordedWorld(replay, device)
    if config_of(phantom) not in (None, own) and data_version != ANY:
        raise RacinesError(
            f"{store.root}: was acquired from another phantom than the one given: leave phantom "
            f"out, give the dataset of that phantom, or let it pass: data_version={ANY!r}"
        )
    return replay, own if phantom is None else phantom


def find_task(view: str | Task, phantom: WorldLike = None, anatomy: str | None = None) -> Task:
    """Return the task of a view: of an anatomy, or else of a phantom's; both have to agree.

    Recordings that stand alone have a task of their own.
    """
    if isinstance(phantom, Recordings):
        return view if isinstance(view, Task) else phantom.task(view)
    config = config_of(phantom)
    held = config and config.anatomy
    task = view if isinstance(view, Task) else get_task(view, anatomy or held or HEART)
    if held not in (None, task.anatomy):
        raise RacinesError(
            f"task {task.id} is the {task.anatomy}'s and the phantom holds the {held}: give "
            f"phantom=PhantomConfig(anatomy={task.anatomy!r})"
        )
    return task


def make_phantom(
    phantom: WorldLike, device: torch.device | str = "cpu", anatomy: str = HEART
) -> World:
    """Return a world: the one given, or the shared phantom of a configuration (baked once)."""
    if phantom is None or isinstance(phantom, PhantomConfig):
        return shared_phantom(phantom or PhantomConfig(anatomy=anatomy), str(device))
    if not isinstance(phantom, World):
        raise RacinesError(
            f"phantom {phantom!r} is neither a Phantom nor a PhantomConfig; a class of your own "
            "inherits from racines_data.world.World"
        )
    return phantom


def config_of(phantom: WorldLike) -> PhantomConfig | None:
    """Return the configuration of a phantom, or the one given; None of all else."""
    if isinstance(phantom, World):
        return phantom.config
    return phantom if isinstance(phantom, PhantomConfig) else None


def phantom_recipe(phantom: WorldLike) -> dict[str, Any] | None:
    """Return the version and configuration digest of a phantom; None for a stand-in.

    Of a ward, the version of its patients: who they are is the start set's to say. Of recordings
    that stand alone, their dataset and settings.
    """
    if isinstance(phantom, Ward):
        return patients_recipe(
            BEATING if phantom.pool.beating else PATIENTS, phantom.pool.provenance
        )
    if isinstance(phantom, Recordings):
        return phantom.recipe
    config = config_of(phantom)
    if config is None:
        return None
    recipe = {"version": PHANTOM_VERSION, "config": dataclasses.asdict(config)}
    own = provenance(config.anatomy)
    if own is not None:  # by its content, wherever its folder lies
        recipe["config"]["anatomy"] = own["digest"]
    told = {"version": PHANTOM_VERSION, "recipe_digest": recipe_digest(recipe)}
    return told | ({"own": own} if own else {})


def patients_recipe(tier: str, own: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return what scores say of the world of a tier of patients.

    `own` is the provenance of the heart that all of them have, where it is one of one's own.
    """
    recipe = {"version": PATIENTS_VERSION, "world": tier}
    if own is None:
        return {**recipe, "recipe_digest": recipe_digest(recipe)}
    return {**recipe, "recipe_digest": recipe_digest(recipe | {"own": own["digest"]}), "own": own}


def trained_on(part: Any) -> dict[str, Any] | None:
    """Return the source, version and digests of the dataset that a part was made from, if it says.

    A part is a generator (its `data`, or the card in its ONNX file), a store's manifest, or the run
    folder of a grader.
    """
    if isinstance(part, dict):
        return part if part.get("digest") else None
    if isinstance(part, (str, Path)):
        from racines_models.judges.grader.model import read_config

        return trained_on(read_config(Path(part)).get("dataset") or {})
    card = getattr(getattr(part, "interface", None), "card", None)
    told = card.get("data") if isinstance(card, dict) else getattr(part, "data", None)
    return trained_on(told) if isinstance(told, dict) else None


def check_datasets(parts: dict[str, dict[str, Any] | None], wanted: str | None = None) -> None:
    """Check that the parts come from one dataset: equal digests, or equal recipes.

    `parts` names each one's dataset; None, where it does not say, passes unless one is `wanted`, by
    a version, a tag, or eight or more of a digest's first characters; `any` checks nothing.
    """
    if wanted == ANY:
        return
    hint = f"train on one dataset, or let it pass: data_version={ANY!r}"
    if wanted is not None:
        for name, data in parts.items():
            if data is None:
                raise RacinesError(f"{name} does not say which dataset it is from: {hint}")
            if not _named(data, wanted):
                raise RacinesError(f"{name} is from {_title(data)}, not {wanted}: {hint}")
    told = [(name, data) for name, data in parts.items() if data is not None]
    for name, data in told[1:]:
        first, known = told[0]
        # A rebuild of one recipe on another processor is the same version.
        recipe = data.get("recipe_digest")
        rebuilt = recipe is not None and recipe == known.get("recipe_digest")
        if data["digest"] != known["digest"] and not rebuilt:
            raise RacinesError(
                f"{first} is from {_title(known)} and {name} from {_title(data)}: {hint}"
            )


def _named(data: dict[str, Any], wanted: str) -> bool:
    version = data.get("version")
    names = (version, f"v{version}", f"{data.get('source')}-v{version}")
    digests = (data["digest"], data.get("recipe_digest") or "")
    begun = any(digest.startswith(wanted) for digest in digests)
    return wanted in names or (len(wanted) >= _SHORTEST and begun)


def _title(data: dict[str, Any]) -> str:
    return f"{data.get('source')} {data.get('version')} ({data['digest'][:_SHORTEST]}…)"
