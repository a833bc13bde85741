"""A card of published weights in Markdown, as model repositories have them: front matter, sections.

Every figure stands with where it is from: the record of a board, or the run's own report.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.tables import Markdown, code, escape, markdown_table
from racines_models.published.catalogue import Catalogue, WeightsSet

LICENCE = "Apache-2.0"
NO_DEVICE = (
    "**This is research software, not a medical device.** Trained on simulated or public research "
    "images; nothing here is for clinical use."
)
NO_ROW = "No row of a board is of these weights."
NO_RECORDS = "The records of its rows are not here: they come with a checkout of the repository."
_DATA = ("data", "dataset", "environment")
_SETS_ASIDE = "Figures of a run's own report are of its validation or test split, as it says there."


def model_card(catalogue: Catalogue, weights: WeightsSet) -> str:
    """Return the card of a set of weights.

    Raises:
        RacinesError: a file that the card is made of is missing or damaged.
    """
    described = _read(catalogue.root / weights.folder / "config.json")
    metrics = _read(catalogue.root / weights.folder / "metrics.json")
    if Path(weights.name).suffix:  # a file of its own, beside the runs of others
        described, metrics = {}, {}
    found = {name: _read(catalogue.root / name) for name in weights.records}
    records = {name: record for name, record in found.items() if record}
    submission = next((each["submission"] or {} for each in records.values()), {})
    parts = [
        f"# {escape(described.get('title') or weights.name)}",
        NO_DEVICE,
        *_method(weights, described, submission),
        "## Trained on",
        _trained_on(described, metrics),
        *_settings(described),
        "## Scores",
        *(_scores(records) or [NO_ROW if not weights.records else NO_RECORDS]),
        *_own_figures(weights, described, metrics),
        "## Files",
        _files(weights),
        "## Licence",
        escape(submission.get("licence") or LICENCE),
        "## Limits",
        *_limits(described, submission),
    ]
    body = "\n\n".join(part.strip() for part in parts if part.strip())
    return f"---\n{_front_matter(weights, records)}\n---\n{body}\n"


def _read(path: Path) -> dict[str, Any]:
    """Return a JSON document; empty where there is none."""
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text()))
    except (ValueError, TypeError) as error:
        raise RacinesError(
            f"{path}: damaged ({error}); get it again: git restore {path}"
        ) from error


def _front_matter(weights: WeightsSet, records: Mapping[str, Any]) -> str:
    """Return the YAML that a hub reads: licence, library, tags, and the ranked scores."""
    from huggingface_hub import EvalResult, ModelCardData

    results = [
        EvalResult(
            task_type=record["track"],
            dataset_type="racines",
            dataset_name=f"{record['board']}, {Path(name).stem}",
            metric_type=metric,
            metric_value=told["value"],
        )
        for name, record in records.items()
        for metric, told in record["scores"]["metrics"].items()
        if told["value"] is not None
    ]
    data = ModelCardData(
        license=LICENCE.lower(),
        library_name="racines",
        tags=["ultrasound", "echocardiography", "simulation", *weights.boards],
        model_name=weights.name,
        eval_results=results or None,
    )
    return data.to_yaml()


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
