"""Tables of any kind as polars frames, and their columns as numbers.

A byte order mark is passed over, as is UTF-16. Numbers with decimal commas are told by their column
and never read as something else.
"""

import io
import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from racines_data.errors import RacinesError

ENDINGS = (".csv", ".tsv", ".txt", ".parquet", ".json", ".jsonl", ".ndjson")
LARGEST = 2_000_000_000
"""Bytes of a table, at most."""
_COMMA = re.compile(r"\s*[-+]?\d+,\d+\s*")
_NULLS = ("", "NA", "N/A", "na", "null", "None", "-")
_SHOWN = 12
_PADDED = re.compile(r"(?<![\d.])0\d")


def read_table(
    path: Path, separator: str | None = None, comma: bool = False, records: str | None = None
) -> pl.DataFrame:
    """Return a table; nested records are columns with dots, as `pose.x`.

    Args:
        path: A file of one of `ENDINGS`.
        separator: Of a CSV; found out where it is left out.
        comma: Numbers have decimal commas.
        records: Key of a JSON document that holds the rows.

    Raises:
        RacinesError: another ending, too large, or not what its name says.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise RacinesError(f"{path}: {size / 1e9:.1f} GB: a table of poses has at most 2; cut it")
    try:
        table = _read(path, separator, comma, records)
    except RacinesError:
        raise
    except (pl.exceptions.PolarsError, OSError, ValueError, RecursionError) as error:
        said = " ".join(str(error).split())[:200]
        hint = ""
        if path.suffix.lower() in (".csv", ".tsv", ".txt") and "found more fields" in said:
            hint = ": decimal commas in a table whose columns are parted by commas?"
        raise RacinesError(f"{path}: cannot be read as a table ({said}){hint}") from error
    while nested := [name for name, kind in table.schema.items() if isinstance(kind, pl.Struct)]:
        table = table.unnest(*nested, separator=".")
    if not len(table):
        raise RacinesError(f"{path}: a table without rows")
    return table


def _read(path: Path, separator: str | None, comma: bool, records: str | None) -> pl.DataFrame:
    ending = path.suffix.lower()
    if ending == ".parquet":
        return pl.read_parquet(path)
    if ending not in ENDINGS:
        raise RacinesError(f"{path}: not a table that is read here: {', '.join(ENDINGS)}")
    text = _text(path)
    if ending in (".jsonl", ".ndjson"):
        return pl.read_ndjson(io.StringIO(text), infer_schema_length=None)
    if ending == ".json":
        return _from_json(path, text, records)
    separator = separator or _separator(text)
    read = partial(pl.read_csv, separator=separator, null_values=list(_NULLS))
    table = read(io.StringIO(text), decimal_comma=comma, infer_schema_length=None)
    # 001 is a name: where a column of whole numbers has zeros before them, it stays text.
    whole = [name for name, kind in table.schema.items() if kind.is_integer()]
    if whole and _PADDED.search(text):
        words = read(io.StringIO(text), columns=whole, infer_schema=False)
        padded = [each for each in words.iter_columns() if each.str.contains(r"^\s*0\d").any()]
        table = table.with_columns(padded)
    return table.rename(lambda name: name.strip())


def _text(path: Path) -> str:
    content = path.read_bytes()
    code = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return content.decode(code)
    except UnicodeDecodeError as error:
        raise RacinesError(f"{path}: not {code} text ({error.reason}): save it as UTF-8") from error


def _from_json(path: Path, text: str, records: str | None) -> pl.DataFrame:
    content = json.loads(text)
    for key in records.split(".") if records else ():
        if not isinstance(content, dict) or key not in content:
            raise RacinesError(f"{path}: poses.records: no key {records!r}")
        content = content[key]
    if isinstance(content, dict) and content and all(isinstance(v, list) for v in content.values()):
        return pl.DataFrame(content, strict=False)
    if not isinstance(content, list) or not all(isinstance(each, dict) for each in content):
        keys = f" of {', '.join(list(content)[:_SHOWN])}" if isinstance(content, dict) else ""
        raise RacinesError(
            f"{path}: poses.records: not a list of rows; name the key{keys} that holds it"
        )
    return pl.from_dicts(content, infer_schema_length=None)


def _separator(text: str) -> str:
    """Return which of the usual separators stands most often in the first line.

    A space is one only where there is no other: names of columns may have spaces in them.
    """
    head = text.split("\n", 1)[0].strip()
    counts = {mark: head.count(mark) for mark in (";", "\t", ",")}
    if any(counts.values()):
        return max(counts, key=lambda mark: counts[mark])
    return " " if " " in head else ","


def has_commas(table: pl.DataFrame) -> bool:
    """Return whether a column holds numbers with decimal commas, which were read as text."""
    texts_of = (each.drop_nulls() for each in table.iter_columns() if each.dtype == pl.String)
    return any(len(each) and all(map(_COMMA.fullmatch, each)) for each in texts_of)


def column(table: pl.DataFrame, name: str, field: str, path: Path | str) -> pl.Series:
    """Return a column; else raise `RacinesError` with the field of the mapping and the columns."""
    if name not in table.columns:
        shown = ", ".join(table.columns[:_SHOWN]) + (", …" if table.width > _SHOWN else "")
        raise RacinesError(f"{path}: {field}: no column {name!r}; it has {shown}")
    return table[name]


def numbers(table: pl.DataFrame, names: Sequence[str], field: str, path: Path | str) -> np.ndarray:
    """Return (T, K) float64 of K columns, or of one column that holds lists; NaN for nothing.

    Raises:
        RacinesError: no such column, text in it (decimal commas by name), or lists of different
            lengths.
    """
    if len(names) == 1:
        series = column(table, names[0], field, path)
        if series.dtype.is_nested():
            return _listed(series, field, path)
        if series.dtype == pl.String and series.str.contains(r"^\s*\[").any():
            return _listed(_parsed(series, field, path), field, path)
    return np.stack([_plain(column(table, name, field, path), field, path) for name in names], -1)


def _plain(series: pl.Series, field: str, path: Path | str) -> np.ndarray:
    if series.dtype == pl.String:
        filled = series.drop_nulls()
        if len(filled) and all(_COMMA.fullmatch(each) for each in filled):
            raise RacinesError(
                f"{path}: {field}: column {series.name!r} has decimal commas ({filled[0]!r}): set "
                "poses.decimal_comma: true, or write points"
            )
        values = series.str.strip_chars().cast(pl.Float64, strict=False)
        wrong = (values.is_null() & series.is_not_null()).arg_max()
        if values.null_count() > series.null_count() and wrong is not None:
            raise RacinesError(
                f"{path}: {field}: column {series.name!r}, row {wrong}: {series[wrong]!r} is no "
                "number"
            )
        series = values
    if not (series.dtype.is_numeric() or series.dtype == pl.Null):
        raise RacinesError(f"{path}: {field}: column {series.name!r} is {series.dtype}: no numbers")
    return series.cast(pl.Float64).fill_null(np.nan).to_numpy()


def _parsed(series: pl.Series, field: str, path: Path | str) -> pl.Series:
    """Return lists that stand as text in a CSV, as `[[1, 0, …], …]`."""
    try:
        return pl.Series(series.name, [json.loads(each) if each else None for each in series])
    except (ValueError, TypeError, pl.exceptions.PolarsError) as error:
        raise RacinesError(
            f"{path}: {field}: column {series.name!r} holds no lists of numbers ({error})"
        ) from error


def _listed(series: pl.Series, field: str, path: Path | str) -> np.ndarray:
    rows: list[Any] = [None if each is None else np.ravel(each) for each in series.to_list()]
    width = next((len(row) for row in rows if row is not None), 0)
    for number, row in enumerate(rows):
        if row is not None and (len(row) != width or row.dtype.kind not in "iuf"):
            raise RacinesError(
                f"{path}: {field}: column {series.name!r}, row {number}: not {width} numbers, as "
                "the rows before it"
            )
    none = np.full(width, np.nan)
    return np.stack([none if row is None else row.astype(float) for row in rows])


def texts(table: pl.DataFrame, name: str, field: str, path: Path | str) -> list[str]:
    """Return a column as text, empty where there is nothing."""
    return column(table, name, field, path).cast(pl.String).fill_null("").to_list()
