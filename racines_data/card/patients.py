"""What a card says of simulated patients: who they are, their columns, masks and measures."""

from collections.abc import Iterator, Mapping
from typing import Any

from racines_data.card.columns import PATIENT_COLUMNS, columns_table
from racines_data.manifest import added_configs, measures_name
from racines_data.sources.base import manifest_card
from racines_data.tables import code, markdown_table


def patients_section(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parts of the section; nothing of a dataset without patients."""
    names = added_configs(manifest)
    if not names:
        return
    yield "## Patients"
    yield manifest_card(manifest[names[0]]).origin.capitalize() + "."
    yield (
        "A patient is one seed and lies wholly in one split, the one to which the seed belongs for "
        "ever. In `patients` hearts stand still at end diastole, breathed out, and both phases are "
        "0; in `beating` they move, and times are of the patient's own rhythm. Frames of both have "
        "these columns besides:"
    )
    yield columns_table(PATIENT_COLUMNS)
    yield from _sheets(manifest, names)
    yield people_table(manifest, names)
    yield (
        "*Not all shown*: patients of whom some view is shown at no pose that was found, for ribs "
        "or lung lie before it. They are kept: no patient is drawn again."
    )
    yield _masks(manifest, names)
    files = " and ".join(code(measures_name(name)) for name in names)
    yield (
        f"{files}: a row a patient. Sex, body (m, kg, m²), pathology, split; volumes of chambers "
        "and walls (ml) at `phases` of the beat, the last of which is end systole; ejection "
        "fractions; lengths and diameters (mm) at end diastole and end systole; the views that are "
        "shown at their nominal poses. They are counted in what is drawn, no formula's. "
        f'`racines_data.open_store(config="{names[0]}").measures()` reads them, digest checked.'
    )


def _sheets(manifest: Mapping[str, Any], names: list[str]) -> Iterator[str]:
    """Yield each config's contact sheet; older datasets have none."""
    for name in names:
        own = manifest[name]
        if "sheet" in own:
            over = ", and a mask over a frame" if own["mask_labels"] else ""
            caption = f"Patients of `{name}`, a row each: the best frame of each view{over}"
            yield f"![{caption}]({own['sheet']})\n\n*{caption}.*"


def people_table(manifest: Mapping[str, Any], names: list[str]) -> str:
    """Return patients of each config and split, by sex and pathology."""
    rows = []
    for name in names:
        for split, own in manifest[name]["people"].items():
            kinds = ", ".join(f"{kind} {count}" for kind, count in own["pathology"].items())
            told = own["patients"], own["female"]
            # Datasets of before the count by pathology have the sum alone.
            lack = ", ".join(
                f"{kind} {count}" for kind, count in own.get("unshown_pathology", {}).items()
            )
            unshown = f"{own['unshown']:,}" + (f" ({lack})" if lack else "")
            rows.append((name, split, *(f"{each:,}" for each in told), unshown, kinds or "–"))
    head = ("config", "split", "patients", "female", "not all shown", "pathology")
    return markdown_table(head, rows)


def _masks(manifest: Mapping[str, Any], names: list[str]) -> str:
    """Return what the masks say; the labels are one list, whichever config has masks."""
    masked = [name for name in names if manifest[name]["mask_labels"]]
    without = [f"Frames of `{name}` have no masks: the column is null." for name in names
               if name not in masked]  # fmt: skip
    if not masked:
        return " ".join(without)
    labels = enumerate(manifest[masked[0]]["mask_labels"])
    named = ", ".join(f"{number} {label}" for number, label in labels)
    told = (
        "A `mask` labels each pixel with what lies there in the middle plane of the slice, moved "
        f"by the phase; 0 outside the sector too. Labels: {named}."
    )
    return " ".join([told, *without])
