"""Where a result comes from: who made it, the data, the code, and the basis of every figure."""

from typing import Any

from racines_leaderboard.board.rank import Record
from racines_leaderboard.studio.html import link, table, text

SHORT = 16
"""Characters of a digest that are shown."""


def provenance_html(record: Record) -> str:
    """Return a record's provenance and its figures as HTML."""
    entries = "".join(f"<dt>{text(name)}</dt><dd>{value}</dd>" for name, value in _facts(record))
    return f'<div class="rc-facts"><dl>{entries}</dl>{_figures(record)}</div>'


def _facts(record: Record) -> list[tuple[str, str]]:
    submission, scores = record["submission"] or {}, record["scores"]
    code = scores.get("code") or {}
    facts: list[tuple[str, str]] = [
        ("Board", text(record["board"])),
        ("Tier", text(record["tier"])),
        ("Method", text(submission.get("method", ""))),
        ("Description", text(submission.get("description", ""), 1500)),
        ("Authors", text(", ".join(submission.get("authors", [])))),
        ("Licence", text(submission.get("licence", ""))),
        ("Page", link(submission.get("url", ""))),
        ("Paper", link(submission.get("paper", ""))),
        ("Source code", _submitted_code(submission.get("code"))),
        ("Data", _data(scores)),
        ("Task", _task(scores.get("task"))),
        ("Seeds", text(", ".join(map(str, scores.get("seeds", []))))),
        ("Weights", _digests(scores.get("weights"))),
        ("Scored by", text(f"racines {code.get('version', '')} {code.get('commit') or ''}")),
        ("Environment", text(_pairs(scores.get("environment") or {}))),
        ("Seconds", text(scores.get("seconds", ""))),
    ]
    return [(name, value) for name, value in facts if value.strip()]


def _submitted_code(code: Any) -> str:
    if not isinstance(code, dict):
        return ""
    where = link(code["url"]) if "url" in code else text(code.get("package", ""))
    return f"{where} {text(code.get('commit', code.get('version', '')))}"


def _data(scores: dict[str, Any]) -> str:
    data = scores.get("dataset") or scores.get("phantom") or {}
    source = f"{data.get('source', 'phantom')} {data.get('version', '')}"
    digests = {key: data[key] for key in ("digest", "recipe_digest") if data.get(key)}
    return f"{text(source)}, {_digests(digests)}"


def _task(task: Any) -> str:
    plain = {k: v for k, v in (task or {}).items() if isinstance(v, str)}
    return text(_pairs(plain))


def _digests(digests: Any) -> str:
    if not isinstance(digests, dict):
        return ""
    shown = (
        f"{text(name)} <code>{text(str(value)[:SHORT])}…</code>" for name, value in digests.items()
    )
    return ", ".join(shown)


def _pairs(content: dict[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in content.items() if value is not None)


def _figures(record: Record) -> str:
    """Every figure with its n, its interval, and how that was made."""
    rows = []
    for name, metric in record["scores"]["metrics"].items():
        if metric["value"] is None:
            continue
        ends = [metric.get("low"), metric.get("high")]
        between = "–" if None in ends else " – ".join(f"{end:.4g}" for end in ends)
        how = (metric.get("settings") or {}).get("interval", "")
        rows.append((name, f"{metric['value']:.4g}", between, f"{metric['n']:,}", how))
    head = ("Figure", "Value", "95 %", "n", "Interval by")
    return table(head, rows, ("rc-text", "", "", "", "rc-text"))
