"""The servo that looks through several trained networks at once."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

from racines_data.errors import RacinesError
from racines_data.files import write_json
from racines_data.views import VIEWS
from racines_envs.agents.protocol import SETTINGS
from racines_envs.agents.servo.agent import POLICY, ServoAgent
from racines_envs.evaluation.agent_specs import trained_folder
from racines_envs.evaluation.trainings import find_trainings
from racines_models.devices import on_device
from racines_models.networks.servo import WIDTHS, ServoEnsemble, ServoNetwork
from racines_models.weights import save_weights


@dataclass(frozen=True)
class EnsembleConfig:
    """Whose networks, and how many."""

    members: str = "servo"
    """Run of a servo with several trainings: a name, trained here or published, or a folder."""
    size: int = 3
    """Networks; training n of the ensemble takes the run's n · size and those that follow."""
    widths: tuple[int, ...] = WIDTHS
    """As the members'."""
    blocks: tuple[int, ...] = ()
    """As the members'."""
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.size < 2:
            raise RacinesError(f"agents.servo-ensemble.size: {self.size}: give 2 or more")


class ServoEnsembleAgent(ServoAgent):
    """A servo whose readings are those of several networks; nothing is learned anew."""

    name: ClassVar[str] = "servo-ensemble"
    Config: ClassVar[type] = EnsembleConfig

    @classmethod
    def train(cls, config: Any, run_dir: Path, *, seed: int = 0, **where: Any) -> Self:
        """Take the networks of a servo's trainings; other arguments as of `ServoAgent.train`.

        Raises:
            RacinesError: a run without so many trainings, or of another agent.
        """
        config = on_device(config)
        folder = Path(config.members)
        folder = folder if folder.is_dir() else trained_folder(config.members)
        trainings = find_trainings(folder)
        own = trainings[seed * config.size : (seed + 1) * config.size]
        if len(own) < config.size:
            raise RacinesError(
                f"{folder}: has {len(trainings)} trainings, and an ensemble of {config.size} with "
                f"seed {seed} takes those from {seed * config.size + 1} to "
                f"{(seed + 1) * config.size}: train more (`repeats` of its entry), or give a "
                "smaller size"
            )
        servos = [ServoAgent.load(each.folder, config.device) for each in own]
        network = ServoEnsemble([each.network for each in servos])
        config = replace(config, widths=servos[0].config.widths, blocks=servos[0].config.blocks)
        run_dir = Path(run_dir)
        save_weights(run_dir / POLICY, network.state_dict())
        told = {"agent": cls.name, "config": asdict(config), "seed": seed}
        write_json(run_dir / SETTINGS, told)
        members = [{"seed": each.seed, "files": each.files} for each in own]
        write_json(run_dir / "metrics.json", {"members": members, "views": list(VIEWS)})
        return cls(config, network)

    @classmethod
    def built(cls, config: Any) -> ServoEnsemble:
        """Return the networks that settings describe, untrained."""
        shape = len(VIEWS), config.widths, config.blocks
        return ServoEnsemble([ServoNetwork(*shape) for _ in range(config.size)])
