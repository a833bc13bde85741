"""The commands `racines data map` and `racines data inspect`. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.errors import RacinesError
from racines_data.terminal import say, say_json

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the recording.")]


def map_(
    folder: Folder,
    guess: Annotated[bool, typer.Option("--guess", help="Propose, and ask nothing.")] = False,
    out: opt.OwnOutFile = None,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Propose what is what in a folder of poses and images, ask, and write it as mapping.yaml."""
    from racines_data.files import write_atomic
    from racines_data.sources.table.inputs import open_folder
    from racines_data.sources.table.mapping import check_mapping
    from racines_data.sources.table.propose.ask import ask_mapping
    from racines_data.sources.table.propose.guess import guess_mapping
    from racines_data.sources.table.propose.write import write_mapping
    from racines_data.sources.table.source import MAPPING

    path = out or folder / MAPPING
    if path.exists() and not force:
        raise RacinesError(f"{path}: is there already: look at it, or write it anew with --force")
    made = guess_mapping(open_folder(folder))
    if not guess:
        made.parts = ask_mapping(made.parts, lambda text, held: typer.prompt(text, default=held))
        made.notes.clear()
    text = write_mapping(made.parts, made.notes)
    write_atomic(path, text)
    if as_json:
        say_json({"out": str(path), "mapping": made.parts, "notes": made.notes})
        return
    for place, note in made.notes.items():
        say(f"{place}: {note}")
    say(f"{path}: written; look at it: racines data inspect {folder} --mapping {path}")
    check_mapping(made.parts, str(path))  # what was not found has to be filled in


def inspect(
    folder: Folder,
    mapping: opt.Mapping = None,
    out: opt.OwnOutFile = None,
    allow: opt.Allow = None,
    as_json: opt.AsJson = False,
) -> None:
    """Draw a recording on one sheet as a mapping reads it, or a dataset; say what looks wrong."""
    from racines_data.files import write_atomic
    from racines_data.manifest import MANIFEST
    from racines_data.sources.gate.bounds import READING, Bounds
    from racines_data.sources.table.inspecting import inspect_mapping
    from racines_data.sources.table.mapping import read_mapping
    from racines_data.sources.table.sheet import draw_sheet
    from racines_data.sources.table.source import MAPPING
    from racines_data.validate.inspecting import inspect_dataset

    path, name = out or Path(f"{folder.resolve().name}-sheet.png"), folder.resolve().name
    opt.check_ending(path, ".png")
    Bounds(allow=tuple(allow or ()))
    if mapping is None and (folder / MANIFEST).is_file():
        if allow:
            raise RacinesError("--allow is for a mapping that is tried; a dataset has its own")
        made, told = inspect_dataset(folder), f"{name}, the dataset"
    else:
        made = inspect_mapping(folder, read_mapping(mapping or folder / MAPPING), allow or ())
        told = f"{name}, as the mapping reads it"
    if READING in (allow or ()):
        made.doubts = [doubt for doubt in made.doubts if doubt.certain]
    write_atomic(path, draw_sheet(made, told))
    words = made.words()
    if as_json:
        doubts = [vars(doubt) for doubt in made.doubts]
        counts = {"sweeps": len(made.drafts), "frames": made.frames}
        say_json({"out": str(path), **counts, "doubts": doubts, "wrong": words})
        return
    for line in words or ["nothing looks wrong"]:
        say(line)
    say(f"{path}: drawn, {made.frames} frames of {len(made.drafts)} sweep(s)")
