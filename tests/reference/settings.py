"""The page of the settings: every field of every section, from the dataclasses that it fills."""

import ast
import dataclasses
import inspect
import json
import textwrap
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from racines_data.config import PROFILES
from racines_data.tables import Markdown, code, markdown_table
from tests.conftest import ROOT

SECTIONS = {
    "": "racines_data.config:_Top",
    "data": "racines_data.build.planning:DataConfig",
    "data.phantom": "racines_data.phantom.acquisition:AcquisitionConfig",
    "data.multi_phantom": "racines_data.sources.phantom:MultiPhantomConfig",
    "data.SOURCE": "racines.sources",
    "grader": "racines_models.judges.grader.model:GraderConfig",
    "grader: {architecture: servo}": "racines_models.judges.grader.servo:ServoGraderConfig",
    "student": "racines_models.judges.student.model:StudentConfig",
    "pose": "racines_models.judges.pose.regressor:PoseConfig",
    "segmentation": "racines_models.judges.segmentation.model:SegmentationConfig",
    "encoder": "racines_envs.worlds.exploration:ExplorationConfig",
    "generators.NAME": "racines.generators",
    "scores": "racines_models.scores.scorer:ScoresConfig",
    "realism": "racines_models.studies.realism.report:RealismConfig",
    "scouts": "racines_data.store.scouts:ScoutsConfig",
    "patient_generators.NAME": "",
    "patient_scores": "racines_models.scores.on_patients:PatientScoresConfig",
    "motions.NAME": "racines.motions",
    "motion_scores": "racines_models.trackerless.scoring:MotionScoresConfig",
    "agents.NAME": "racines.agents",
    "patient_agents.NAME": "",
    "evaluation": "racines_envs.evaluation.run:EvaluationConfig",
    "evaluation_patients": "racines_envs.evaluation.patients:PatientsConfig",
    "robustness": "racines_envs.studies.robustness.run:RobustnessConfig",
    "downstream": "racines_envs.studies.downstream.config:DownstreamConfig",
    "replay": "racines_envs.worlds.recorded.settings:ReplayConfig",
    "explain": "racines_envs.explain.run:ExplainConfig",
    "rewards": "racines_envs.studies.rewards:RewardReportConfig",
    "transfer": "racines_envs.studies.transfer:TransferConfig",
    "speed": "racines_envs.studies.step_profile:SpeedConfig",
    "ejection": "racines_envs.studies.ejection:EjectionConfig",
}
"""What fills each section: a dataclass, or that of each plug-in of a kind."""
KINDS = {bool: "true or false", int: "integer", float: "number", str: "text", Path: "path"}
TOLD = {
    "grader: {architecture: servo}": "A grader that begins as a servo; `architecture` is "
    "`resnet18`, the section above, where it is left out.",
    "": "What stands beside the sections.",
    "speed": "Of `racines study speed --set NAME=VALUE` alone: a file has no such section.",
    "patient_generators.NAME": "Generators that meet a patient by a scout: the fields of "
    "`generators.NAME`.",
    "patient_agents.NAME": "Agents that are judged on patients: the fields of `agents.NAME`. Where "
    "the name is no agent's, `agent` says which.",
}
SHARED = {
    "seed": "Seed of what is drawn by chance.",
    "board": "Name of the board that these settings are for.",
    "shortest": "Frames of the shortest trajectory.",
    "longest": "Frames of the longest trajectory.",
    "minimum": "Lowest corner in the robot's frame, m.",
    "beams": "Beams of the sector.",
    "lowest": "Least height of the tip, m.",
    "validation": "The same of the validation split.",
    "test": "The same of the test split.",
    "batch_size": "Rows of a gradient step.",
    "epochs": "Passes over the train split.",
    "weight_decay": "Decoupled weight decay of AdamW.",
    "learning_rate": "Learning rate.",
    "discriminator_learning_rate": "Learning rate of the discriminator.",
    "actor_lr": "Learning rate of the actor.",
    "critic_lr": "Learning rate of the critic.",
    "field_rate": "Learning rate of the field.",
    "coarse_rate": "Learning rate of the field's coarse part.",
    "decoder_rate": "Learning rate of the decoder.",
    "encoder_width": "Channels of the encoder's first layer.",
    "discriminator_width": "Channels of the discriminator's first layer.",
    "latent": "Size of the latent code.",
    "mapping_layers": "Layers of the mapping network.",
    "reconstruction_weight": "Weight of the reconstruction in the loss.",
    "gradient_clip": "Largest norm of a gradient.",
    "split": "Split that is scored: train, validation or test.",
    "kid_subsets": "Subsets over which KID is averaged.",
    "view": "Target view.",
    "step": "What is found in training: the mean motion between frames, m and rad.",
    "device": "Where it computes: cpu, cuda, or auto.",
    "anatomy": "Name of an anatomy.",
    "observation": "What the agent is shown: image, params or multimodal.",
    "reward": "Name of the reward.",
    "backend": "Who draws the images: phantom, generator or replay.",
    "generator": "Generator that draws, where the backend is one.",
}
"""What is said of fields of which their dataclass says nothing: they mean the same everywhere."""
HEAD = f"""# Settings

Every section and field of a `params.yaml`, drawn from the code by `python -m tests.reference`. What
a file leaves out keeps its default. An unknown key, or a value of another type, is refused with its
full name and what is allowed. Units stand in the descriptions.

Packaged settings, for `--profile`: {", ".join(f"`{name}`" for name in PROFILES)}.
`--set NAME=VALUE` of a command overrides a field of its section. Fields of fields are written with
a dot here, and nested in YAML.
"""


def page() -> str:
    """Return the page in Markdown."""
    return HEAD + "\n" + "\n".join(_section(name, what) for name, what in SECTIONS.items())


def _section(name: str, what: str) -> str:
    title = f"## `{name}`" if name else "## Top level"
    told = TOLD.get(name, "")
    if what.startswith("racines."):
        return f"{title}\n\n" + "\n".join(_plugins(name, what))
    if not what:
        return f"{title}\n\n{told}\n"
    return f"{title}\n\n{_config(resolve_name(what), told)}"


def _plugins(section: str, group: str) -> Iterator[str]:
    """Yield a part for each plug-in of ours; those that share a dataclass have one together."""
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][group]
    parent, names = section.partition(".")[0], {}
    for name, where in points.items():
        config = getattr(resolve_name(where), "Config", None)
        if config is not None and f"{parent}.{name}" not in SECTIONS:
            names.setdefault(config, []).append(name)
    for config, those in names.items():
        title = ", ".join(f"`{parent}.{name}`" for name in those)
        yield f"### {title}\n\n{_config(config, '')}"


def _config(config: type, told: str) -> str:
    told = told or inspect.cleandoc(config.__doc__ or "").replace("\n", " ").replace("  ", "\n\n")
    if told.startswith(f"{config.__name__}("):  # dataclasses' own, where there is none
        told = ""
    rows = list(_rows(config()))
    if not rows:
        return f"{told}\n\nNo fields.\n" if told else "No fields.\n"
    return f"{told}\n\n{markdown_table(('field', 'type', 'default', 'what it is'), rows)}\n"


def _rows(config: Any, before: str = "") -> Iterator[tuple[str, ...]]:
    """Yield a row for each field; those of a dataclass within come in its place."""
    hints, told = typing.get_type_hints(type(config)), described(type(config))
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{before}{field.name}"
        if dataclasses.is_dataclass(value):
            yield from _rows(value, f"{name}.")
        else:
            about = told.get(field.name) or SHARED.get(field.name, "")
            default = code(_shown(value))
            yield code(name), _kind(hints[field.name]), default, Markdown(about.replace("|", "\\|"))


def _shown(value: Any) -> str:
    """Return a default as YAML may write it."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not value.is_integer():
        return f"{value:.6g}"
    return json.dumps(value, ensure_ascii=False, default=str) if value != "" else '""'


def _kind(hint: Any) -> str:
    """Return a type in the words of YAML."""
    if hint is type(None):
        return "null"
    if hint in KINDS:
        return KINDS[hint]
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _kind(inner[0])
    if origin is typing.Literal:
        return " or ".join(map(str, inner))
    if origin in (typing.Union, types.UnionType):
        return " or ".join(map(_kind, inner))
    if origin is tuple and inner[-1] is not ...:
        return f"list of {len(inner)}: {', '.join(map(_kind, inner))}"
    if origin in (tuple, list):
        return f"list of {_kind(inner[0])}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"mapping of {_kind(inner[1])}"
    return getattr(hint, "__name__", str(hint))


@cache
def described(config: type) -> dict[str, str]:
    """Return what is said of each field: the text below it, or else the comment beside it."""
    found: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        source = textwrap.dedent(inspect.getsource(base))
        (tree,) = ast.parse(source).body
        body = tree.body  # pyright: ignore[reportAttributeAccessIssue]
        for node, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                text = _text(after) or _comment(source.splitlines()[node.lineno - 1])
                if text:
                    found[node.target.id] = text
    return found


def _text(node: ast.AST | None) -> str:
    """Return the text that a node is, on one line."""
    match node:
        case ast.Expr(value=ast.Constant(value=str(text))):
            return " ".join(text.split())
    return ""


def _comment(line: str) -> str:
    return line.partition("  # ")[2] if "  # " in line and "noqa" not in line else ""


def undescribed() -> list[str]:
    """Return the fields of which nothing is said."""
    found = []
    for line in page().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| `") and not cells[-1]:
            found.append(cells[0])
    return found
