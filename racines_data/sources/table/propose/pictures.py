"""Which images go with the rows of a table: named in a column, numbered, in order, in one file."""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from racines_data.sources.table.inputs import Folder
from racines_data.sources.table.pictures import dicom, files
from racines_data.sources.table.pictures.opening import ONE_A_SWEEP

_TRIED = 5


def guess_images(
    folder: Folder, found: Sequence[Path], table: pl.DataFrame, sweeps: Sequence[str]
) -> tuple[str, str]:
    """Return `images.path`, empty where nothing fits, and why.

    Args:
        folder: The folder.
        found: All its files.
        table: One of its tables.
        sweeps: Names of its sweeps.
    """
    single = [path for path in found if path.suffix.lower() in (*files.ENDINGS, *dicom.ENDINGS)]
    inside = {parent for path in single for parent in path.parents if parent != folder.root}
    inside = {parent for parent in inside if parent.is_relative_to(folder.root)}
    places = [".", *sorted(map(folder.name, inside))]
    for name in table.columns:
        if template := _named(folder, table, name, places):
            return template, f"column {name!r} names files that are there"
    for name in table.columns:
        if table.schema[name].is_integer() and (made := _numbered(folder, table, name, single)):
            return made, f"column {name!r} numbers files that are there"
    for place in places:
        own = [path for path in single if folder.name(path.parent) == place]
        if not own:
            continue
        pattern = f"{place}/*{own[0].suffix}".removeprefix("./")
        if len(sweeps) > 1 and Path(place).name in sweeps:
            parent = folder.name(own[0].parent.parent)
            return f"{parent}/{{sweep}}/*{own[0].suffix}".removeprefix("./"), "a folder a sweep"
        if len(own) == len(table) and len(sweeps) == 1:
            return pattern, f"as many files in {place} as rows, in order"
    return _whole(folder, found, sweeps)


def _named(folder: Folder, table: pl.DataFrame, name: str, places: Sequence[str]) -> str:
    """Return the template of a column of file names, if its first rows name files."""
    if table.schema[name] != pl.String:
        return ""
    values = [each for each in table[name].head(_TRIED).to_list() if each]
    for place in ("", *(f"{place}/" for place in places if place != ".")):
        for ending in ("", *files.ENDINGS, *dicom.ENDINGS):
            paths = [folder.root / f"{place}{each}{ending}" for each in values]
            if paths and all(path.suffix and path.is_file() for path in paths):
                return f"{place}{{{name}}}{ending}"
    return ""


def _numbered(folder: Folder, table: pl.DataFrame, name: str, single: Sequence[Path]) -> str:
    values = table[name].head(_TRIED).to_list()
    if not single or None in values or min(values) < 0:
        return ""
    stem = single[0].stem
    head, digits = stem.rstrip("0123456789"), len(stem) - len(stem.rstrip("0123456789"))
    place = folder.name(single[0].parent)
    place = "" if place == "." else f"{place}/"
    for width in (f":0{digits}d", ""):
        template = f"{place}{head}{{{name}{width}}}{single[0].suffix}"
        if all((folder.root / template.format_map({name: each})).is_file() for each in values):
            return template
    return ""


def _whole(folder: Folder, found: Sequence[Path], sweeps: Sequence[str]) -> tuple[str, str]:
    """Return the video, array or sequence of all, or of each sweep."""
    whole = [path for path in found if path.suffix.lower() in (*ONE_A_SWEEP, *dicom.ENDINGS)]
    stems = {path.stem for path in whole}
    if whole and len(sweeps) > 1 and stems >= set(sweeps):
        own = next(path for path in whole if path.stem == sweeps[0])
        return folder.name(own.with_name(f"{{sweep}}{own.suffix}")), "a file a sweep"
    if len(whole) == 1:
        return folder.name(whole[0]), "the one file that holds images"
    return "", "no images found that go with the rows"
