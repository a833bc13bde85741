"""Making trajectories in the workers of an engine, each staged as one file that survives a kill.

    plan()  ──>  unit 0, 1, 2 …  ──>  workers: produce, check, PNG  ──>  units/00000.arrow …

A staged file is complete or absent (written aside, then renamed), so that a build that was killed
goes on where it stopped. What a unit's file holds does not depend on the worker that made it.
"""

import hashlib
import inspect
import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import pyarrow as pa

from racines_data.digest import trajectory_digest
from racines_data.engines import Engine
from racines_data.files import naming, working_folder, write_atomic
from racines_data.progress import progress_bar
from racines_data.records import MASK_PIXELS, RAW_PIXELS, pixels_array, trajectory_to_table
from racines_data.sources.base import Source, Unit, has_poses, labels_of_source
from racines_data.sources.gate.bounds import Bounds, bounds_of
from racines_data.sources.gate.check import check_trajectory

_DIGEST = b"racines.digest"
REMEDY = "to go on, with fewer workers"


def staging_folder(
    out: Path, source: Source, recipe_digest: str, allow: Sequence[str] = ()
) -> AbstractContextManager[Path]:
    """Open the staging folder of a build, beside its output; removed when the build succeeds.

    Its name tells the recipe, the code and what the gate allows apart, so that units of another are
    never taken up; if another build of the same dataset is running, that is a `RacinesError`.
    """
    code = hashlib.sha256()
    rooms = (Path(__file__).parent, Path(inspect.getfile(Bounds)).parent)
    own = {path for room in rooms for path in room.rglob("*.py")}
    for file in sorted({*own, Path(inspect.getfile(type(source)))}):
        code.update(file.read_bytes())
    key = "/".join([recipe_digest, code.hexdigest(), *sorted(allow)])
    return working_folder(out, "staging", key, "another build of it is running; wait for it")


def unit_path(folder: Path, index: int) -> Path:
    """Return the file of a staged unit."""
    return folder / "units" / f"{index:05d}.arrow"


def open_unit(path: Path) -> tuple[pa.Table, str]:
    """Return a staged unit, memory-mapped (rows of `frames` and a `pixels` column), its digest."""
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    return table, (table.schema.metadata or {})[_DIGEST].decode()


def stage_units(
    parts: Sequence[tuple[Source, Sequence[Unit], Path, bool]],
    engine: Engine,
    progress: bool,
    allow: Sequence[str] = (),
) -> None:
    """Make the units of all parts that are not staged yet, by the workers of one engine.

    A part is a source, its units, their folder, and whether one worker makes all units of a
    session: for a source to which a session costs something (a heart is baked once). What the gate
    infers is not held against them where `allow` names it.
    """
    tasks: list[tuple[int, list[tuple[Unit, Path]]]] = []
    with progress_bar(progress) as bar:
        shown = []
        for number, (_, units, folder, by_session) in enumerate(parts):
            (folder / "units").mkdir(parents=True, exist_ok=True)
            missing: dict[str | int, list[tuple[Unit, Path]]] = {}
            staged = 0
            for index, unit in enumerate(units):
                path = unit_path(folder, index)
                try:
                    open_unit(path)
                    staged += unit.frames
                except (OSError, KeyError, pa.ArrowInvalid):
                    group = unit.session if by_session else index
                    missing.setdefault(group, []).append((unit, path))
            tasks += [(number, members) for members in missing.values()]
            total = sum(unit.frames for unit in units)
            shown.append(bar.add_task(f"{folder.name} frames", total=total, completed=staged))
        sources = [(source, bounds_of(source, allow)) for source, *_ in parts]
        # Workers that see this machine's folders write there: what they made survives a kill.
        make = _stage if engine.own_files else _send
        made = engine.map(make, sources, tasks, remedy=REMEDY)
        for (number, members), contents in zip(tasks, made, strict=True):
            for (unit, path), content in zip(members, contents, strict=True):
                if content is not None:
                    write_atomic(path, content)
                bar.advance(shown[number], unit.frames)


def _stage(
    sources: Sequence[tuple[Source, Bounds]], task: tuple[int, Sequence[tuple[Unit, Path]]]
) -> list[None]:
    """Make some units of a source, each into its file."""
    number, members = task
    for unit, path in members:
        table, aside = _make(*sources[number], unit), path.with_suffix(f".{os.getpid()}")
        with naming(path):
            with pa.OSFile(str(aside), "wb") as file:
                _write(table, file)
            os.replace(aside, path)
    return [None] * len(members)


def _send(
    sources: Sequence[tuple[Source, Bounds]], task: tuple[int, Sequence[tuple[Unit, Path]]]
) -> list[bytes]:
    """Make some units of a source; return what their files hold."""
    number, members = task
    contents = []
    for unit, _ in members:
        _write(_make(*sources[number], unit), buffer := pa.BufferOutputStream())
        contents.append(buffer.getvalue().to_pybytes())
    return contents


def _write(table: pa.Table, sink: pa.NativeFile) -> None:
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)


def _make(source: Source, bounds: Bounds, unit: Unit) -> pa.Table:
    """Make and check a unit; return its rows, with pixels, and in the schema its digest."""
    labels = labels_of_source(source)
    trajectory = source.produce(unit)
    check_trajectory(trajectory, unit, labels, has_poses(source), bounds, source.name)
    table = trajectory_to_table(trajectory, source.name, labels)
    table = table.append_column(RAW_PIXELS, pixels_array(trajectory.images))
    if trajectory.masks is not None:
        table = table.append_column(MASK_PIXELS, pixels_array(trajectory.masks))
    digest = {_DIGEST: trajectory_digest(trajectory).encode()}
    return table.replace_schema_metadata((table.schema.metadata or {}) | digest)
