"""On which of the boards that settings make a submission belongs."""

from pathlib import Path
from typing import Any

from racines_data.config import fill, section
from racines_data.errors import RacinesError
from racines_envs.evaluation.patients import PatientsConfig
from racines_envs.task.names import tier_of
from racines_leaderboard.records.tracks import PATIENT_AGENTS, PATIENT_GENERATORS
from racines_leaderboard.submissions.document import find_submission
from racines_leaderboard.submissions.worlds import views_of
from racines_models.registry import PATIENTS


def board_of(folder: Path, settings: dict[str, Any], asked: str | None = None) -> str:
    """Return the board that a submission belongs on: of what settings make, that of its track.

    Args:
        folder: `<submissions>/<track>/<name>`.
        settings: those of a params file.
        asked: the one that was asked for; None: whichever it is.

    Raises:
        RacinesError: none there, a policy that says no task, or a board that the settings do not
            make or that differs from the one asked for.
    """
    board, made = settings.get("board"), settings.get("patient_boards", ())
    tiers = {
        PATIENT_GENERATORS.name: lambda: PATIENTS,
        PATIENT_AGENTS.name: lambda: _tier(folder, settings),
    }
    if tier := tiers.get(folder.parent.name):
        board = tier()
        if board not in made:
            raise RacinesError(
                f"{folder.name}: belongs on board {board}, which these settings do not make "
                f"(patient_boards: {', '.join(made) or 'none'}): give --params of the board, as "
                "racines_data/profiles/reference.yaml"
            )
    if not isinstance(board, str):
        raise RacinesError("board: expected the name of a board in the settings")
    if asked not in (None, board):
        raise RacinesError(f"--board {asked} differs from {board!r}, the board of {folder.name}")
    return board


def _tier(folder: Path, settings: dict[str, Any]) -> str:
    """Return the tier of the task that was handed in for; where none is said, the settings'."""
    document = find_submission(folder.parents[1], folder.parent.name, folder.name)
    views = {} if document is None else views_of(folder, document)
    view = next(iter(views.values()), None)
    config = fill(PatientsConfig, section(settings, "evaluation_patients"), "evaluation_patients")
    return tier_of(view or config.view)
