"""Published trainings that stand beside a run's own: further seeds of the same method.

    models/runs/<name>/                      the first training, of seed s
    models/runs/<name>/seed-<s + 1>/         the second, and so on: what `training.repeats` trained
    models/weights/<board>/<name>/seed-<n>/  published, laid out as the run's folder is

What `repeats` leaves out may come from published weights, so that a row of a board rests on several
trainings where one is trained. They are a board's, since what is learned depends on its data. They
count where name, settings and data are those of the first, and seeds follow without a gap: a seed
that did badly cannot be left out.
"""

from pathlib import Path
from typing import Any

from racines_data.terminal import say
from racines_models.training.checkpoint import PREFIX, repeat_folders
from racines_models.weights import read_described

WEIGHTS = Path("models/weights")
DECIDE_NOTHING = ("repeats", "log_every", "sample_every", "checkpoint_every")
"""Settings of a training's loop that leave its weights as they are."""
LATER = {"compile": False}
"""Settings of the loop that came later, as older trainings had them."""


def published_seeds(board: str | None, first: Path, weights: Path = WEIGHTS) -> list[Path]:
    """Return the folders of the published seeds of a run that go on where its own end.

    What is there and does not count is said.

    Raises:
        RacinesError: a `config.json` that cannot be read.
    """
    published = weights / board / first.name if board else None
    if published is None or not published.is_dir() or not (first / "config.json").is_file():
        return []
    there = {int(each.name.removeprefix(PREFIX)): each for each in repeat_folders(published)}
    described = read_described(first, "no generator")
    seed = described.get("seed", 0) + 1 + len(repeat_folders(first))
    found: list[Path] = []
    while (folder := there.get(seed)) is not None:
        other = read_described(folder, "no generator")
        one, two = _made_of(described, seed), _made_of(other, other.get("seed"))
        if differing := sorted(key for key in one | two if one.get(key) != two.get(key)):
            told = f"another {', '.join(differing)} than {first}"
            say(f"racines: {folder}: not counted: {told}", err=True)
            break
        found.append(folder)
        seed += 1
    return found


def _made_of(described: dict[str, Any], seed: Any) -> dict[str, Any]:
    """Return what a training rests on, by key."""
    config = dict(described.get("config") or {})
    trained = LATER | (config.pop("training", None) or {})
    loop = {f"training.{key}": each for key, each in trained.items()}
    loop = {key: each for key, each in loop.items() if key.split(".")[1] not in DECIDE_NOTHING}
    data = (described.get("data") or {}).get("recipe_digest")
    return config | loop | {"name": described.get("name"), "data": data, "seed": seed}
