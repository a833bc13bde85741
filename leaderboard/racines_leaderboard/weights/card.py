"""A card of published weights in Markdown, as model repositories have them: front matter, sections.

Every figure stands with where it is from: the record of a board, or the run's own report.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from racines_data.errors import RacinesError
from racines_data.tables import Markdown, code, escape, markdown_table
from racines_models.published.catalogue import Catalogue, WeightsSet
from racines_models.published.hub import tag_of

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

LICENCE = "Apache-2.0"
NO_DEVICE = (
    "**This is research software, not a medical device.** Trained on simulated or public research "
    "images; nothing here is for clinical use."
)
NO_ROW = "No row of a board is of these weights."
NO_RECORDS = "The records of its rows are not here: they come with a checkout of the repository."
DATA_LICENCE = "CC BY 4.0, simulated; no image is of a person"
TRAINING_DATA = f"Frames of the simulated phantom or of simulated patients: {DATA_LICENCE}."


@dataclass(frozen=True)
class Kind:
    """What a kind of weights is for, and how it is loaded."""

    used: str
    load: str
    """Code, with `place` and `name` to fill in."""
    task: str = ""
    """The hub's name of its task, where it has one."""


KINDS = {
    "racines.generator/1": Kind(
        "Draws the ultrasound image at a pose of the probe, in the scene that it learned.",
        "from racines_models.registry import load_generator\n\n"
        'generator = load_generator("{name}", "{place}")',
    ),
    "racines.grader/1": Kind(
        "Says which view a simulated image shows and how well: the judge of a board.",
        'from racines_models.judges.grader.model import Grader\n\ngrader = Grader.load("{place}")',
        "image-classification",
    ),
    "racines.pose-regressor/1": Kind(
        "Reads the probe's pose from a simulated image: a judge of boards, or an encoder.",
        "from racines_models.judges.pose.regressor import PoseRegressor\n\n"
        'regressor = PoseRegressor.load("{place}")',
    ),
    "racines.segmentation/1": Kind(
        "Outlines chambers and walls in images of simulated patients: a judge of boards.",
        "from racines_models.judges.segmentation.model import SegmentationJudge\n\n"
        'judge = SegmentationJudge.load("{place}")',
        "image-segmentation",
    ),
    "agent": Kind(
        "Steers a simulated probe to a view of a simulated heart, in the tasks of RACINES.",
        "from racines_envs.agents.protocol import load_agent\n\n"
        'agent = load_agent("{name}", "{place}")',
        "reinforcement-learning",
    ),
    ".onnx": Kind(
        "Steers a simulated probe to a view of a simulated heart, in the tasks of RACINES.",
        'from racines_envs.agents.protocol import load_agent\n\nagent = load_agent("{place}", ".")',
        "reinforcement-learning",
    ),
}
"""By the schema that `config.json` names; agents name none, and files go by their ending."""
_DATA = ("data", "dataset", "environment")
_SETS_ASIDE = "Figures of a run's own report are of its validation or test split, as it says there."


def model_card(catalogue: Catalogue, weights: WeightsSet, repo_id: str | None = None) -> str:
    """Return the card of a set of weights, for a repository of the Hub if one is named.

    Raises:
        RacinesError: a file that the card is made of is missing or damaged.
    """
    described = _read(catalogue.root / weights.folder / "config.json")
    metrics = _read(catalogue.root / weights.folder / "metrics.json")
    if Path(weights.name).suffix:  # a file of its own, beside the runs of others
        described, metrics = {}, {}
    kind = _kind(weights, described)
    found = {name: _read(catalogue.root / name) for name in weights.records}
    records = {name: record for name, record in found.items() if record}
    submission = next((each["submission"] or {} for each in records.values()), {})
    parts = [
        f"# {escape(described.get('title') or weights.name)}",
        NO_DEVICE,
        *_method(weights, described, submission),
        "## Intended use",
        *_use(kind),
        "## Load",
        *_load(weights, kind, str(described.get("name") or described.get("agent")), repo_id),
        "## Trained on",
        _trained_on(described, metrics),
        TRAINING_DATA,
        *_settings(described),
        "## Scores",
        *(_scores(records) or [NO_ROW if not weights.records else NO_RECORDS]),
        *_own_figures(weights, described, metrics),
        "## Files",
        _files(weights),
        "## Licence",
        f"Weights: {escape(submission.get('licence') or LICENCE)}. Data: {DATA_LICENCE}.",
        "## Limits",
        *_limits(described, submission),
    ]
    body = "\n\n".join(part.strip() for part in parts if part.strip())
    return f"---\n{_front_matter(weights, records, kind)}\n---\n{body}\n"


def _read(path: Path) -> dict[str, Any]:
    """Return a JSON document; empty where there is none."""
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise RacinesError(
            f"{path}: damaged ({error}); get it again: git restore {path}"
        ) from error


def _front_matter(weights: WeightsSet, records: Mapping[str, Any], kind: str) -> str:
    """Return the YAML that a hub reads: licence, library, tags, task, and the boards' figures."""
    from huggingface_hub import ModelCardData

    task = KINDS[kind].task if kind in KINDS else ""
    data = ModelCardData(
        license=LICENCE.lower(),
        library_name="racines",
        tags=["ultrasound", "echocardiography", "simulation", *weights.boards],
        pipeline_tag=task or None,
        model_name=weights.name,
        eval_results=[each for record in records.values() for each in _results(record)] or None,
    )
    return data.to_yaml()


def _results(record: Mapping[str, Any]) -> Iterator["EvalResult"]:
    """Yield the figures of a record, each with its n and interval, as a hub's model index has them.

    The data are named by board, source, version and recipe; agents' by the task as well.
    """
    from huggingface_hub import EvalResult

    scores = record["scores"]
    data = scores.get("dataset") or scores.get("phantom") or {}
    told = {key: data[key] for key in ("source", "version", "recipe_digest") if key in data}
    task = scores.get("task") or {}
    view = task.get("view", "")
    for metric, figure in scores["metrics"].items():
        if figure["value"] is None:
            continue
        yield EvalResult(
            task_type=record["track"],
            task_name=f"{record['track']} {view}".strip(),
            dataset_type="racines",
            dataset_name=" ".join(filter(None, (record["board"], view))),
            dataset_split=data.get("split") or (task.get("start_set") or {}).get("split") or "test",
            dataset_args=told | {"board": record["board"], "record_seal": record.get("seal")},
            metric_type=metric,
            metric_value=figure["value"],
            metric_args={key: figure.get(key) for key in ("n", "low", "high", "unit")},
        )


def _kind(weights: WeightsSet, described: Mapping[str, Any]) -> str:
    """Return what a set is, a key of `KINDS`: by its file, its schema, or that it is an agent."""
    if suffix := Path(weights.name).suffix:
        return suffix
    return str(described.get("schema", "agent"))


def _use(kind: str) -> Iterator[str]:
    used = KINDS[kind].used if kind in KINDS else "See the repository."
    yield f"{used} For research on simulated data, and to hold one's own method against."
    yield (
        "Not for diagnosis, not for guiding a probe over a person, not as a judge of real images: "
        "none of that was measured."
    )


def _load(weights: WeightsSet, kind: str, name: str, repo_id: str | None) -> Iterator[str]:
    """Say how a set is loaded by its name, from a checkout and from the Hub."""
    is_file = bool(Path(weights.name).suffix)
    place = f"{weights.folder}/{next(iter(weights.files))}" if is_file else weights.folder
    if kind in KINDS:
        yield "In a checkout of the repository, after `pip install -e .`:"
        yield f"```python\n{KINDS[kind].load.format(place=place, name=name)}\n```"
    if repo_id is not None:
        owner = repo_id.partition("/")[0]
        yield "From the Hub, held to the sha256 of the checkout's manifest:"
        yield f"    racines weights fetch {weights.name} --hub {owner}"
        yield (
            f"The files of this card are those of the tag {code(tag_of(weights))} of "
            f"{code(repo_id)}, which is never moved."
        )


def _method(
    weights: WeightsSet, described: Mapping[str, Any], submission: Mapping[str, Any]
) -> Iterator[str]:
    yield f"{escape(weights.what[:1].upper() + weights.what[1:])}."
    told = described.get("summary") or submission.get("description")
    yield escape(told) if told else ""
    named = described.get("name") or described.get("agent") or described.get("schema")
    rows = [("method", escape(submission.get("method") or named or weights.name))]
    if described.get("source"):
        rows.append(("after", escape(described["source"])))
    if weights.boards:
        rows.append(("boards that name it", ", ".join(weights.boards)))
    rows.append(("where", code(f"{weights.folder}")))
    yield markdown_table(("", ""), [(name, Markdown(told)) for name, told in rows])


def _trained_on(described: Mapping[str, Any], metrics: Mapping[str, Any]) -> str:
    """Return what is told of the data, by the run."""
    places = [described, metrics]
    data = next((each[key] for each in places for key in _DATA if each.get(key)), None)
    data = data or metrics.get("phantom") or described.get("phantom")
    rows = list(_flat(data)) if isinstance(data, Mapping) else []
    if described.get("seed") is not None:
        rows.append(("seed", described["seed"]))
    return markdown_table(("what", "value"), rows) if rows else "The run does not say."


def _settings(described: Mapping[str, Any]) -> Iterator[str]:
    rows = list(_flat(described.get("config") or {}))
    if rows:
        yield "## Training settings"
        yield markdown_table(("setting", "value"), [(code(name), told) for name, told in rows])


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Yield nested settings by dotted name."""
    for name, told in values.items():
        if isinstance(told, Mapping):
            yield from _flat(told, f"{before}{name}.")
        else:
            yield f"{before}{name}", told if isinstance(told, str) else json.dumps(told)


def _scores(records: Mapping[str, Any]) -> list[str]:
    """Return a table for each record, with its place and seal."""
    parts = []
    for name, record in records.items():
        parts.append(f"### Board {escape(record['board'])}, {escape(record['track'])}")
        parts.append(f"From {code(name)}, seal {code(record['seal'][:12])}.")
        parts.append(_figures(record["scores"]["metrics"]))
    return parts


def _figures(metrics: Mapping[str, Any]) -> str:
    rows = []
    for name, told in metrics.items():
        if not isinstance(told, Mapping) or told.get("value") is None:
            continue
        low, high = told.get("low"), told.get("high")
        interval = "–" if low is None or high is None else f"{low:.4g} to {high:.4g}"
        unit = told.get("unit") or ""
        rows.append((code(name), f"{told['value']:.4g}", interval, unit, told.get("n", "")))
    return markdown_table(("figure", "value", "95 % interval", "unit", "n"), rows)


def _own_figures(
    weights: WeightsSet, described: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Iterator[str]:
    """Yield what the run measured of itself, where it did so with intervals."""
    for name, report in (("config.json", described.get("training")), ("metrics.json", metrics)):
        figures = (report or {}).get("metrics") if isinstance(report, Mapping) else None
        if isinstance(figures, Mapping) and figures:
            split = (report or {}).get("split")
            yield f"### By the run itself{f', {escape(split)} split' if split else ''}"
            yield f"From {code(f'{weights.folder}/{name}')}. {_SETS_ASIDE}"
            yield _figures(figures)


def _files(weights: WeightsSet) -> str:
    rows = [
        (code(name), f"{told['bytes']:,}", code(told["sha256"]))
        for name, told in weights.files.items()
    ]
    return markdown_table(("file", "bytes", "sha256"), rows)


def _limits(described: Mapping[str, Any], submission: Mapping[str, Any]) -> Iterator[str]:
    limits = [*(described.get("limits") or ()), *(submission.get("limits") or ())]
    limits.append("scores hold on the data that the boards name, and on no others")
    limits.append("simulated and research images alone: nothing is known of use on people")
    yield "\n".join(f"- {escape(each)}" for each in limits)
