"""The figure of generators that adapt: scouts, true frames, and what each method draws there.

    python -m tests.models.studies.adapted_gallery METHOD[=FOLDER] …

Of the first four test patients, at poses near to the scout's frames and far from them. FOLDER is
that of one training; a method that is not trained has none.
"""

import sys
from pathlib import Path

from racines_data.store.asked import AskedStore
from racines_models.registry import generator_class, open_generator
from racines_models.scores.adapted_sheet import SHOWN, write_adapted
from racines_models.scores.on_patients import draw_patients

ROOT = Path(__file__).parents[3]
PICTURE = ROOT / "docs/images/adapting.png"
SCANS = Path("models/runs/scores/reference")


def main(given: list[str]) -> None:
    """Draw all, and write the figure."""
    asked = AskedStore("test", SHOWN, 0, SCANS)
    drawn = {}
    for each in given:
        name, _, folder = each.partition("=")
        generator = open_generator(name, Path(folder)) if folder else generator_class(name)()
        drawn[name.replace("-", "-\n", 1)] = draw_patients(generator, asked, 0)[0]
    write_adapted(PICTURE, asked, drawn)


if __name__ == "__main__":
    main(sys.argv[1:])
