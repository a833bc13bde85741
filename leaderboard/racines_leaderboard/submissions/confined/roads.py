"""A stranger's generator and policy: the in-process classes, their graph in a confined child."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from racines_envs.agents.onnx.policy import OnnxPolicyAgent
from racines_leaderboard.submissions.confined.session import ConfinedSession, Limits, rehearse
from racines_leaderboard.submissions.file_checks import MAX_BYTES, read_bounded
from racines_models.exchange.onnx.generator import OnnxGenerator


class ConfinedGenerator(OnnxGenerator):
    """Draws what `OnnxGenerator` draws, byte for byte, on the CPU; RacinesError if it may not."""

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        super().__init__(path, "cpu", _confined(path, limits))


class ConfinedPolicyAgent(OnnxPolicyAgent):
    """Acts as `OnnxPolicyAgent` acts, on the CPU; RacinesError if it may not."""

    def __init__(self, path: Path, limits: Limits | None = None) -> None:
        super().__init__(path, "cpu", _confined(path, limits))


def _confined(path: Path, limits: Limits | None) -> Callable[..., ConfinedSession]:
    """Rehearse a file's parse; return what opens it."""
    content = read_bounded(path.parent, path.name, str(path.parent), MAX_BYTES)
    rehearse("onnx", content, str(path), limits)
    return partial(ConfinedSession, limits=limits)
