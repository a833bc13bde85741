"""Scouts of patients in a file: what a program outside may adapt to before it draws.

A row is a frame, in the order of the scan; `docs/patient-generators.md` describes the columns. The
metadata are those of a poses file but for the sample.
"""

from pathlib import Path

import numpy as np
import pyarrow as pa

from racines_data.records import encode_png
from racines_data.schema import PARAMETERS
from racines_models.exchange.predictions.file import GROUP, PATIENT, Task, writing

SCOUTS = "racines.scouts/1"
COLUMNS = pa.schema(
    [PATIENT, pa.field("frame", pa.int64(), False), pa.field("image", pa.binary(), False),
     *(pa.field(name, pa.float32()) for name in PARAMETERS)]
)  # fmt: skip


def write_scouts(path: Path, task: Task) -> int:
    """Write the scouts of the patients that a task asks for; return the number of frames."""
    asked, metadata = task.asked, task.metadata(SCOUTS)
    assert asked is not None and asked.patients is not None
    del metadata["sample"]
    rows = 0
    with writing(path, COLUMNS, metadata) as writer:
        for place, patient in enumerate(asked.patients):
            pngs = [encode_png(image) for image in asked.scouts[place].numpy()]
            whose, frames = np.full(len(pngs), patient), np.arange(len(pngs))
            values = [whose, frames, pngs, *asked.scout_parameters[place].numpy().T]
            table = pa.table([pa.array(each) for each in values], schema=writer.schema)
            writer.write_table(table, row_group_size=GROUP)
            rows += len(pngs)
    return rows
