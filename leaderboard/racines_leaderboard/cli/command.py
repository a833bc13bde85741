"""The `racines` command, put together from the commands of the four packages and of others.

Another package adds `racines NAME …` by an entry point of the group `racines.commands`:

    [project.entry-points."racines.commands"]
    hello = "my_package.hello:hello"        # a function for typer, or a typer.Typer

A command's module is imported when the command is called, so a broken one harms no other.
"""

import os
import sys
from importlib.metadata import version
from pkgutil import resolve_name
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError, describe_os_error
from racines_data.manifest import VERIFY_VARIABLE
from racines_data.plugins import Plugins
from racines_data.terminal import be_quiet, quiet, say
from racines_leaderboard.cli.everywhere import Group, with_quiet
from racines_leaderboard.cli.examples import epilog_of, root_epilog
from racines_leaderboard.cli.renamed import RenamingGroup

GROUPS = {
    "data": "Build, check and exchange datasets.",
    "phantom": "Make a phantom of your own: of surfaces or of a label map.",
    "train": "Train a judge, a generator, an agent or what estimates motion.",
    "eval": "Score a generator, a grader, an agent or estimated motion.",
    "study": "Questions that a table or a picture answers.",
    "export": "Hand a generator, an agent, or what they answer to a program outside.",
    "weights": "The published weights: what there is, whether it is whole, its cards, the Hub.",
    "board": "What a board holds its records to, and its rounds of fresh draws.",
    "expert": "A blinded study: experts say which view an image shows, and how good it is.",
}
COMMANDS = {
    "data build": "racines_data.cli.build:build",
    "data import": "racines_data.cli.build:import_",
    "data map": "racines_data.cli.table:map_",
    "data inspect": "racines_data.cli.table:inspect",
    "data validate": "racines_data.cli.dataset:validate",
    "data annotate": "racines_models.cli.evaluate.grader:annotate",
    "data card": "racines_data.cli.dataset:card",
    "data export": "racines_data.cli.dataset:export",
    "data push": "racines_data.cli.dataset:push",
    "data pull": "racines_data.cli.dataset:pull",
    "phantom from-mesh": "racines_data.cli.phantom:from_mesh",
    "phantom from-labels": "racines_data.cli.phantom:from_labels",
    "train grader": "racines_models.cli.train.grader:train_grader",
    "train student": "racines_models.cli.train.student:train_student",
    "train pose": "racines_models.cli.train.pose:train_pose",
    "train segmentation": "racines_models.cli.train.segmentation:train_segmentation",
    "train motion": "racines_models.cli.train.motion:train_motion",
    "train encoder": "racines_envs.cli.encoder:train_encoder",
    "train generator": "racines_models.cli.train.generator:train_generator",
    "train agent": "racines_envs.cli.training:train_agent",
    "eval generator": "racines_models.cli.evaluate.generator:eval_generator",
    "eval grader": "racines_models.cli.evaluate.grader:eval_grader",
    "eval motion": "racines_models.cli.evaluate.motion:evaluate_motion",
    "eval agent": "racines_envs.cli.agents:evaluate_agent",
    "eval robustness": "racines_envs.cli.robustness:evaluate_robustness",
    "study sheet": "racines_data.cli.dataset:sheet",
    "study gallery": "racines_models.cli.study.gallery:gallery",
    "study realism": "racines_models.cli.study.realism:realism",
    "study ablation": "racines_models.cli.study.comparisons:ablation",
    "study coverage": "racines_models.cli.study.coverage:coverage",
    "study floor": "racines_models.cli.study.comparisons:floor",
    "study leakage": "racines_models.cli.study.comparisons:leakage",
    "study conditioning": "racines_models.cli.study.comparisons:conditioning",
    "study population": "racines_models.cli.study.population:population",
    "study real-heart": "racines_models.cli.study.real_heart:real_heart",
    "study sim-to-real": "racines_models.cli.study.sim_to_real:sim_to_real",
    "study transfer": "racines_envs.cli.study:transfer",
    "study rewards": "racines_envs.cli.study:reward_audit",
    "study curves": "racines_envs.cli.study:curves",
    "study ejection": "racines_envs.cli.ejection:ejection",
    "study downstream": "racines_envs.cli.downstream:downstream",
    "study forces": "racines_envs.cli.study:forces",
    "study speed": "racines_envs.cli.study:speed",
    "study determinism": "racines_leaderboard.cli.audit:determinism",
    "study weightings": "racines_leaderboard.cli.pins:weightings",
    "study processors": "racines_leaderboard.cli.processors:processors",
    "export generator": "racines_models.cli.export:export_generator",
    "export agent": "racines_envs.cli.episodes:export_agent",
    "export weights": "racines_models.cli.export:export_weights",
    "export poses": "racines_models.cli.export:export_poses",
    "export predictions": "racines_models.cli.export:export_predictions",
    "export motion": "racines_models.cli.evaluate.motion:export_motion",
    "export envhub": "racines_envs.cli.episodes:export_envhub",
    "export trace": "racines_envs.cli.episodes:export_trace",
    "board pin": "racines_leaderboard.cli.pins:pin",
    "expert sample": "racines_leaderboard.cli.expert:sample",
    "expert rate": "racines_leaderboard.cli.expert:rate",
    "expert score": "racines_leaderboard.cli.expert:score",
    "demo": "racines_envs.cli.demo:demo",
    "weights list": "racines_leaderboard.cli.weights:list_",
    "weights verify": "racines_leaderboard.cli.weights:verify",
    "weights card": "racines_leaderboard.cli.weights:card",
    "weights fetch": "racines_leaderboard.cli.weights:fetch",
    "weights push": "racines_leaderboard.cli.weights:push",
    "drive": "racines_envs.cli.episodes:drive",
    "replay": "racines_envs.cli.episodes:replay",
    "explain": "racines_envs.cli.episodes:explain",
    "submit": "racines_leaderboard.cli.submit:submit",
    "leaderboard": "racines_leaderboard.cli.board:leaderboard",
    "board commit-secret": "racines_leaderboard.cli.secret:commit_secret",
    "board reveal": "racines_leaderboard.cli.secret:reveal",
    "doctor": "racines_leaderboard.cli.doctor:doctor",
    "audit": "racines_leaderboard.cli.audit:audit",
    "studio": "racines_leaderboard.cli.studio:studio",
}
"""Where the function of each command stands; heavy imports stand inside it, for a quick --help."""

HELP = ["-h", "--help"]
PLUGINS = Plugins("command", "racines.commands", or_give="")

app = typer.Typer(
    help="RACINES, the open benchmark for robotic cardiac ultrasound. Not a medical device.",
    cls=RenamingGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": HELP},  # which all commands below take over
    epilog=root_epilog(),
)


def _assemble() -> None:
    groups = {"": app}
    for name, told in GROUPS.items():
        groups[name] = typer.Typer(help=told, cls=Group, no_args_is_help=True)
        app.add_typer(groups[name], name=name)
    for words, function in COMMANDS.items():
        group, _, name = words.rpartition(" ")
        groups[group].command(name, epilog=epilog_of(words))(with_quiet(resolve_name(function)))
    taken = {each.name for each in (*app.registered_commands, *app.registered_groups)}
    passed_on = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
    for name, point in PLUGINS.points().items():
        if name not in taken:  # ours keep their names
            about = f"Of another package ({point.value})."
            app.command(name, help=about, context_settings=dict(passed_on))(_call)


def _call(context: typer.Context) -> Any:
    """Run the command of another package."""
    name = str(context.info_name)
    made = PLUGINS.load(name)
    if not isinstance(made, typer.Typer):
        function, made = made, typer.Typer(add_completion=False)
        made.command()(function)
    command = typer.main.get_command(made)
    told = {"prog_name": f"racines {name}", "help_option_names": HELP}
    return command.main(context.args, standalone_mode=False, **told)


_assemble()


@app.callback(invoke_without_command=True)
def root(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and stop.", is_eager=True)
    ] = False,
    verify: opt.Verify = False,
    as_json: opt.AsJson = False,
    hushed: opt.Quiet = False,
) -> None:
    """RACINES, the open benchmark for robotic cardiac ultrasound. Not a medical device."""
    if hushed or quiet():
        be_quiet()
    if verify:
        os.environ[VERIFY_VARIABLE] = "1"  # which worker processes have, too
    if show_version:
        say(f"racines {version('racines')}")
        raise typer.Exit


def main() -> None:
    """Run the command; what is refused, by us or the system, is one line on stderr, exit code 1."""
    # A plug-in named module:Class may stand in the current folder; last, so that it hides nothing.
    sys.path.append(os.getcwd())
    # Threads of OpenMP that wait spin for long, unless told before torch loads it. On cores that
    # other programs use too that makes short operations many times slower; not to spin at all
    # makes them slower on quiet ones.
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", "1000")
    try:
        app()
    except RacinesError as error:
        say(f"racines: {error}", err=True)
        raise SystemExit(1) from error
    except RuntimeError as error:
        if not isinstance(error.__context__, OSError):  # pathlib's word for a circle of links
            raise
        say(f"racines: {describe_os_error(error.__context__)}", err=True)
        raise SystemExit(1) from error
    except OSError as error:
        say(f"racines: {describe_os_error(error)}", err=True)
        raise SystemExit(1) from error
