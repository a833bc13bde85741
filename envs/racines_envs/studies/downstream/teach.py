"""How a servo learns from a point's images, and how it reads true ones."""

from dataclasses import asdict
from pathlib import Path

from racines_data.digest import recipe_digest
from racines_data.patients.patient import PATIENTS_VERSION
from racines_data.patients.scouts import SCOUTS_VERSION
from racines_data.patients.splits import seeds_of
from racines_data.views import VIEWS
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.frames import Frames, kept
from racines_envs.agents.servo.learner import Bank, ServoLearner
from racines_envs.agents.training import seeded
from racines_envs.studies.downstream.config import DownstreamConfig
from racines_envs.studies.downstream.lessons import lesson, taught
from racines_envs.studies.downstream.points import TRUTH, Point, open_point
from racines_models.networks.servo import SIDE, ServoNetwork
from racines_models.protocol import Run
from racines_models.training.trainer import train


def teach(
    point: Point, config: DownstreamConfig, folder: Path, own: Path
) -> tuple[list[ServoAgent], list[dict[str, float]], float]:
    """Return servos that learned from a point's images, how they read true frames, and seconds.

    Args:
        point: draws the images.
        config: all settings.
        folder: the study's, where lessons lie.
        own: the point's, which keeps images and checkpoints, so that a killed training goes on.
    """

    def drawn(patient: int) -> Frames:
        learned = lesson(patient, config.lessons, folder / "lessons")
        return kept(own / f"{patient}.safetensors", lambda: taught(point, patient, learned))

    def true(patient: int) -> Frames:
        return true_frames(patient, config, folder)

    count, seconds = config.lessons.frames, 0.0
    bank = Bank(seeds_of("train")[: config.patients], count, drawn)
    held = Bank(config.readers, count, true)
    agents, reading = [], []
    for seed in range(config.seed, config.seed + config.trainings):
        with seeded(seed, 1):
            network = ServoNetwork(len(VIEWS), config.widths)
            learner = ServoLearner(config.servo, bank, held, seed, network)
            run = Run(own / f"seed-{seed}", seed, "cpu", None, progress=False)
            seconds += train(learner, None, learner.training, run, learner)["seconds"]
        agents.append(ServoAgent(config.servo, learner.network))
        reading.append({name: round(each, 5) for name, each in learner.history[-1].items()})
    return agents, reading, seconds


def true_frames(patient: int, config: DownstreamConfig, folder: Path) -> Frames:
    """Return the true frames of a patient on whom servos are judged."""
    told = {"world": PATIENTS_VERSION, "scouts": SCOUTS_VERSION, "side": SIDE}
    digest = recipe_digest(told | asdict(config.lessons) | asdict(config.lessons.servo))[:16]
    path = folder / "lessons" / f"true-{patient}-{digest}.safetensors"
    learned = lesson(patient, config.lessons, folder / "lessons")
    return kept(path, lambda: taught(open_point(TRUTH), patient, learned))
