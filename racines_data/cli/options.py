"""The options that commands share: one name, one meaning, one help text each; and their settings.

A command annotates its parameters with these and gives its own defaults; its settings come from a
params file, a packaged profile, and these options. What `--device` takes stands in
`racines_models.cli.device`, which knows the devices of this machine.
"""

import fnmatch
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from racines_data.config import read_params
from racines_data.errors import RacinesError

DATA = Path("data/racines")
GRADER, POSE = Path("models/runs/grader"), Path("models/runs/pose")
RESULTS, SUBMISSIONS = Path("leaderboard/results"), Path("leaderboard/submissions")

Root = Annotated[
    Path | None, typer.Argument(help="Folder of the dataset.  [default: data/racines]")
]
Data = Annotated[Path, typer.Option(help="Folder of the dataset.")]
OtherData = Annotated[Path | None, typer.Option("--data", help="Folder of the dataset.")]
Config = Annotated[str, typer.Option(help="Config of the dataset, such as patients or beating.")]
Split = Annotated[str, typer.Option(help="train, validation or test.")]
OneSplit = Annotated[str | None, typer.Option("--split", help="train, validation or test.")]
Samples = Annotated[
    int | None, typer.Option(min=2, help="Frames that are scored.  [default: the settings']")
]

_PROFILES = "smoke, default, patients, reference, paper or abdomen"
Params = Annotated[
    Path | None, typer.Option(help="Settings.  [default: ./params.yaml, if it is there]")
]
Profile = Annotated[str | None, typer.Option(help=f"Packaged settings: {_PROFILES}.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="A setting of the section, NAME=VALUE; repeat for several."),
]
Seed = Annotated[int | None, typer.Option(help="Seed.  [default: the settings']")]
DrawSeed = Annotated[int, typer.Option("--seed", min=0, help="Seed of what is drawn by chance.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Worker processes.")]
Engine = Annotated[str, typer.Option(help="Who runs the tasks: local, or ray.")]
Address = Annotated[
    str | None,
    typer.Option(help="HOST:PORT of a Ray cluster; none: a Ray of this machine's own."),
]
Verify = Annotated[
    bool,
    typer.Option("--verify", help="Hash every file of a dataset again, changed or not."),
]
Mapping = Annotated[
    Path | None,
    typer.Option(help="What is what in the folder, YAML.  [default: mapping.yaml in it]"),
]
PixelMm = Annotated[
    float | None, typer.Option(help="Size of a pixel, mm, where the recording does not say it.")
]
Strict = Annotated[bool, typer.Option(help="Stop at the first refused input.")]
Allow = Annotated[
    list[str] | None,
    typer.Option(
        "--allow", help="What the gate infers and is wrong about, by name; repeat for several."
    ),
]

AsJson = Annotated[bool, typer.Option("--json", help="Print the figures as JSON on stdout.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="No progress and no notes: results, warnings, errors.")
]
Details = Annotated[bool, typer.Option("--details", help="Show further figures as well.")]
Force = Annotated[bool, typer.Option("--force", help="Take the place of what is there.")]
Resume = Annotated[
    bool | None,
    typer.Option(
        "--resume/--fresh",
        help="Continue a killed run, or start anew.  [default: continue if one is there]",
    ),
]

Out = Annotated[Path, typer.Option(help="Folder to write.")]
OwnOut = Annotated[Path | None, typer.Option("--out", help="Folder to write.  [default: by name]")]
OutFile = Annotated[Path, typer.Option("--out", help="File to write.")]
OwnOutFile = Annotated[
    Path | None, typer.Option("--out", help="File to write.  [default: by name, or none]")
]
Cards = Annotated[
    Path | None, typer.Option("--cards", help="Write the cards into this folder too.")
]
Report = Annotated[Path, typer.Option("--out", help="Writes OUT.json, and OUT.png beside it.")]

Trained = Annotated[
    Path | None, typer.Option("--run", help="Folder of the trained run.  [default: by name]")
]
Runs = Annotated[Path, typer.Option(help="Folder of the trained generators.")]
Grader = Annotated[Path | None, typer.Option(help="Folder of the grader's run.")]
NoGrader = Annotated[bool, typer.Option("--no-grader", help="Leave out what needs a grader.")]
Pose = Annotated[Path | None, typer.Option(help="Folder of the pose regressor's run.")]
NoPose = Annotated[bool, typer.Option("--no-pose", help="Leave out what needs a pose regressor.")]

Tier = Annotated[str | None, typer.Option(help="heart, patients or beating.")]
Patients = Annotated[int | None, typer.Option("--patients", min=1, help="Patients of the split.")]
View = Annotated[str | None, typer.Option(help="Target view.")]
Observation = Annotated[str | None, typer.Option(help="image, params or multimodal.")]
Reward = Annotated[str | None, typer.Option(help="paper, oracle, shaped, or another's.")]
Backend = Annotated[str | None, typer.Option(help="phantom, generator or replay.")]
Generator = Annotated[str | None, typer.Option(help="Generator: name, run folder or FILE.onnx.")]
Starts = Annotated[int | None, typer.Option(help="Episodes from each start set.")]
StartSeed = Annotated[
    int | None, typer.Option("--seed", help="Names one start set.  [default: the settings']")
]

Results = Annotated[Path, typer.Option(help="Folder of the boards.")]
Submissions = Annotated[Path, typer.Option(help="Folder of the submissions.")]
Unconfined = Annotated[
    bool,
    typer.Option(
        "--unconfined",
        help="Open others' files even where the kernel cannot confine: trust their author.",
    ),
]
Secret = Annotated[
    Path | None,
    typer.Option(
        help="Nonce of a round of fresh draws: the file of commit-secret, or, once it is revealed, "
        "secrets.json of the board."
    ),
]
Board = Annotated[str | None, typer.Option(help="Only this board.")]


def read_settings(params: Path | None, profile: str | None) -> dict[str, Any]:
    """Return the settings of a file or a profile; ./params.yaml, if it is there, for neither."""
    if params is None and profile is None and Path("params.yaml").is_file():
        params = Path("params.yaml")
    return read_params(params, profile)


def given(**options: Any) -> dict[str, Any]:
    """Return the options that were given on the command line, paths as text."""
    values = {name: value for name, value in options.items() if value is not None}
    return {name: str(each) if isinstance(each, Path) else each for name, each in values.items()}


def overrides(pairs: list[str] | None) -> dict[str, Any]:
    """Return what `--set NAME=VALUE` gives; a value is read as in a params file."""
    values = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"{pair!r}: write NAME=VALUE", param_hint="--set")
        values[name] = yaml.safe_load(value)
    return values


def matching(names: Sequence[str], known: Sequence[str], where: str) -> list[str]:
    """Return names, patterns (`ppo-*`) replaced by those of the known that match; each once.

    Raises:
        RacinesError: a pattern that matches none of them, or no name.
    """
    found: dict[str, None] = {}
    for name in names:
        pattern = any(sign in name for sign in "*?[")
        own = fnmatch.filter(known, name) if pattern else [name]
        if not own:
            raise RacinesError(
                f"{name}: matches nothing of {where}: it has {', '.join(known) or 'no entries'}"
            )
        found |= dict.fromkeys(own)
    return list(found)


def seed_of(settings: dict[str, Any], seed: int | None) -> int:
    """Return the seed that was given, or else that of the settings."""
    return settings.get("seed", 0) if seed is None else seed


def check_ending(out: Path, ending: str) -> None:
    """Refuse a file to write of another kind."""
    if out.suffix.lower() != ending:
        raise typer.BadParameter(f"{out}: end the name with {ending}", param_hint="--out")
