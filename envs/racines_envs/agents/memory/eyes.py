"""The servo's network that a memory sees through: frozen, shared, and known by its hash."""

from pathlib import Path
from typing import NamedTuple

from racines_data.errors import RacinesError
from racines_envs.agents.protocol import SETTINGS
from racines_envs.agents.servo.agent import POLICY, ServoAgent
from racines_envs.evaluation.agent_specs import RUNS, trained_folder
from racines_envs.evaluation.trainings import Training, find_trainings
from racines_models.networks.servo import ServoNetwork
from racines_models.published.places import POLICIES, published


class Eyes(NamedTuple):
    """A training of a servo."""

    network: ServoNetwork
    sha256: str
    """Of its weights."""


def eyes_of(members: str, seed: int, device: str) -> Eyes:
    """Return the training of a seed of a servo's run.

    Args:
        members: name of a run, trained here or published, or its folder.
        seed: of the training.
        device: where it looks.

    Raises:
        RacinesError: a run without that training, or of another agent.
    """
    folder = published(Path(members))
    # A folder of that name that holds no run, in the current one, stands in nobody's way.
    folder = folder if (folder / SETTINGS).is_file() else trained_folder(members)
    trainings = find_trainings(folder)
    found = [each for each in trainings if each.seed == seed]
    if not found:
        seeds = ", ".join(str(each.seed) for each in trainings)
        raise RacinesError(
            f"{folder}: has no training of seed {seed} (seeds {seeds}), through which a memory of "
            "that seed sees: train it (`repeats` of its entry), or give another seed"
        )
    return _open(found[0], device)


def eyes_like(sha256: str, members: str, run_dir: Path | str, device: str) -> Eyes:
    """Return the training of a servo whose weights have a hash.

    Looked for in a folder `eyes` beside the policy, in the run that the settings name, and among
    the published ones.

    Raises:
        RacinesError: it is in none of them.
    """
    beside, named = Path(run_dir) / "eyes", Path(members)
    known = RUNS / members, published(POLICIES / named.name)
    for folder in (beside, named, *known):
        if not (folder / SETTINGS).is_file():
            continue
        for each in find_trainings(folder):
            if each.files.get(POLICY) == sha256:
                return _open(each, device)
    raise RacinesError(
        f"{run_dir}: sees through a servo whose weights have the sha256 {sha256[:16]}…, which is "
        f"neither in {beside} nor in {members}: put its run there, or train the memory anew with "
        "`racines train agent servo-memory`"
    )


def _open(training: Training, device: str) -> Eyes:
    network = ServoAgent.load(training.folder, device).network
    assert isinstance(network, ServoNetwork)
    return Eyes(network, training.files[POLICY])
