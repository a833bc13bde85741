"""Names of what is outlined: a world's labels, the judge's structures, and CAMUS's numbers.

All go by name, so that a world may number its labels as it likes and have more of them.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from racines_data.errors import RacinesError

STRUCTURES = ("LV", "LV myocardium", "LA", "RV", "RA")
"""What the judge outlines by default; 0 of its masks is all else."""
MERGED = {"papillary muscle": "LV", "mitral leaflet": "LV", "tricuspid leaflet": "RV"}
"""Labels that are part of a structure as echocardiographers draw it: papillary muscles and leaflets
lie in the cavity (Lang et al., JASE 2015)."""
CAMUS = {"LV": 1, "LV myocardium": 2, "LA": 3}
"""Numbers of Leclerc et al., IEEE TMI 2019."""


def to_structures(labels: Sequence[str], structures: Sequence[str]) -> Tensor:
    """Return the (256,) uint8 table from a world's label numbers to those of the judge's masks.

    Args:
        labels: names of the world's labels by number.
        structures: names by number, from 1 on.

    Raises:
        RacinesError: a structure that the world has no label of.
    """
    table = torch.zeros(256, dtype=torch.uint8)
    for number, label in enumerate(labels):
        name = label if label in structures else MERGED.get(label)
        if name in structures:
            table[number] = structures.index(name) + 1
    absent = [name for name in structures if name not in labels]
    if absent:
        known = ", ".join(labels)
        raise RacinesError(f"segmentation.structures {', '.join(absent)}: the masks have {known}")
    return table


def to_camus(structures: Sequence[str]) -> Tensor:
    """Return the (256,) uint8 table from the judge's numbers to CAMUS's, 0 for what it lacks."""
    table = torch.zeros(256, dtype=torch.uint8)
    for number, name in enumerate(structures, start=1):
        table[number] = CAMUS.get(name, 0)
    return table


def relabel(masks: Tensor, table: Tensor) -> Tensor:
    """Return uint8 masks of any shape through a (256,) table."""
    return table.to(masks.device)[masks.long()]
