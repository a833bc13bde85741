"""The card of a phantom of one's own: what it was made of, what was added, and what it shows."""

from collections.abc import Iterator
from typing import Any

from racines_data.escape import markdown as escape
from racines_data.tables import code, markdown_table

NOT_MEDICAL = "Research software, not a medical device."


def card_of(told: dict[str, Any]) -> str:
    """Return the Markdown of a phantom's card from its `phantom.json`."""
    return "\n".join(_lines(told)) + "\n"


def _lines(told: dict[str, Any]) -> Iterator[str]:
    yield f"# {escape(told['title'] or told['name'])}\n"
    made = {"from-mesh": "surfaces", "from-labels": "a label map"}[told["made_by"]]
    source = escape(told["source"] or "not said")
    yield f"A phantom made of {made} by `racines phantom {told['made_by']}`. {NOT_MEDICAL}\n"
    yield f"- source: {source}"
    yield f"- licence: {escape(told['licence'] or 'not said')}"
    yield f"- digest: {code(told['digest'])}\n"
    if told["synthetic"]:
        yield "## Synthetic\n"
        yield "These parts are in no file of the source; frames and records of it say so.\n"
        yield from (f"- {escape(name)}: {escape(why)}" for name, why in told["synthetic"].items())
        yield ""
    yield "## Parts\n"
    rows = [_part(told, part) for part in told["parts"]]
    yield markdown_table(("part", "tissue", "mL", "closed"), rows)
    yield "\n## Views\n"
    views = [
        (view["name"], f"{told['shown'][view['name']]:.1f}",
         ", ".join(name for name, _ in view["structures"]))
        for view in told["views"]
    ]  # fmt: skip
    yield markdown_table(("view", "grade at its pose", "has to show"), views)
    if heart := told["heart"]:
        yield from _heart(heart)


def _part(told: dict[str, Any], part: dict[str, Any]) -> tuple[str, ...]:
    tissue = told["tissues"][part["tissue"]]["name"]
    caps = "; ".join(f"{name} ({edges} edges)" for name, edges in part.get("caps", {}).items())
    if part.get("seams"):
        caps += f"; {part['seams']} edges of seams joined"
    return part["name"], tissue, f"{part['ml']:.1f}", caps or "–"


def _heart(heart: dict[str, Any]) -> Iterator[str]:
    yield "\n## Motion\n"
    yield f"{heart['phases']} phases; end systole is phase {heart['end_systole']}, counted from 0."
    if warp := heart["warp"]:
        yield (
            "Between them tissue moves by a map fitted to the vertices of all surfaces: they end "
            f"{warp['vertex_mean_mm']:.2f} mm from where they were in the mean, 95 % within "
            f"{warp['vertex_p95_mm']:.2f} mm; its least Jacobian is {warp['jacobian_least']:.2f}. "
            "Parts that are synthetic move along."
        )
