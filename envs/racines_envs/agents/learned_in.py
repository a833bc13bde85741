"""Where an agent learns, and where it is validated."""

from racines_data.errors import RacinesError
from racines_data.patients.memory import MEMORY
from racines_data.terminal import note
from racines_data.world import World
from racines_envs.agents.settings import TrainingConfig
from racines_envs.task.names import HEART_TIER
from racines_envs.worlds.making import WorldLike, find_task, make_phantom
from racines_envs.worlds.recorded.opening import of_split
from racines_envs.worlds.recorded.world import Recordings
from racines_envs.worlds.ward import make_ward


def worlds(config: TrainingConfig, phantom: WorldLike) -> tuple[World, World]:
    """Return where a run learns and where it is validated: one heart, or patients of two splits.

    In recordings that stand alone it is validated from starts of the validation split, and from its
    own where that split has none.
    """
    if isinstance(phantom, Recordings):
        return phantom, validated_in(phantom)
    task = find_task(config.view, phantom)
    if task.tier == HEART_TIER:
        world = make_phantom(phantom, config.device, task.anatomy)
        return world, world
    # Who is shown the pose alone holds no voxels.
    memory = MEMORY if config.observation != "params" else None
    counts = {"train": config.patients, "validation": max(1, config.patients // 2)}
    train, validation = (
        make_ward(task.tier, split, count, config.device, memory) for split, count in counts.items()
    )
    return train, validation


def validated_in(world: Recordings) -> Recordings:
    """Return the recordings with starts of the validation split; themselves where it has none."""
    try:
        return of_split(world, "validation")
    except RacinesError as error:
        note(f"racines: validated from starts of split {world.settings.split!r}: {error}")
        return world
