"""Results: taking scores into a board, and reading a board back.

A board is a folder `results/<board>/{generators,agents}/<name>.json`, one record a system, with the
figures that it rests on beside it, `<name>.parquet`, and the board's own file, `board.json`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_data.files import locked, write_atomic
from racines_envs.evaluation.patients import run_name
from racines_leaderboard.board.evidence import evidence_path, read_evidence
from racines_leaderboard.board.robustness import robustness_of
from racines_leaderboard.board.standing import with_standing
from racines_leaderboard.records.experts import FOLDER as EXPERTS
from racines_leaderboard.records.experts import with_experts
from racines_leaderboard.records.names import check_unlike
from racines_leaderboard.records.pins import check_fits, read_pin, recipe_of
from racines_leaderboard.records.ranges import check_possible
from racines_leaderboard.records.robustness import FOLDER as ROBUSTNESS
from racines_leaderboard.records.robustness import with_robustness
from racines_leaderboard.records.schema import KEY, check, read_json, sealed, write_record
from racines_leaderboard.records.tracks import PATIENT_AGENTS, TRACK, TRACKS, Track, track_of
from racines_leaderboard.records.verdicts import among, read_verdicts
from racines_leaderboard.submissions.document import find_submission
from racines_models.provenance import same_result

Record = dict[str, Any]


FIRST = ("patients", "beating")
"""Boards that stand before the others: on hearts that nobody trained on."""


def boards(results: Path) -> list[str]:
    """Return the names of the boards that hold a result, those on patients first."""
    paths = results.glob("*/*/*.json")
    found = {path.parts[-3] for path in paths if path.parts[-2] in TRACK}
    return [name for name in FIRST if name in found] + sorted(found.difference(FIRST))


def read_board(results: Path, board: str) -> dict[str, list[Record]]:
    """Read the records of a board by track, as they may stand on it.

    Those of a pinned board say how they stand, those of generators what experts say of them, those
    on patients what they bear, those that were audited what came out.

    Raises:
        RacinesError: a damaged record, one in another's place, or one that does not fit the board.
    """
    content, pin = {}, read_pin(results, board)
    told = read_verdicts(results / board)
    for track in TRACKS:
        content[track.name] = records = []
        for path in sorted((results / board / track.name).glob("*.json")):
            record = read_record(path, board, track)
            check_fits(record["scores"], track, pin, str(path))
            if (said := among(record, told)) is not None:
                record = record | {"verdict": said.verdict}
            records.append(with_standing(record, path, track, pin))
    content["generators"] = with_experts(content["generators"], results / board / EXPERTS)
    found = with_robustness(content[PATIENT_AGENTS.name], results / board / ROBUSTNESS)
    content[PATIENT_AGENTS.name] = found
    return content


def made_elsewhere(folders: list[Path], board: str) -> list[Path]:
    """Return the scores files that were made for another board, as another profile leaves them."""
    others = []
    for path in (path for folder in folders for path in sorted(folder.glob("*.json"))):
        scores, _ = read_scores(path)
        made_for = scores.get("board") or (scores.get("dataset") or {}).get("board")
        if made_for not in (None, board):
            others.append(path)
    return others


def collect(
    folders: list[Path], results: Path, submissions: Path, board: str,
    without: Sequence[Path] = (), force: bool = False,
) -> list[Path]:  # fmt: skip
    """Write one self-reported record for each scores file in the folders; return their paths.

    A record that has been reproduced stays so as long as its scores are the same. Nothing is
    written unless every file is sound, fits what the board is pinned to, and each track stays on
    one dataset. Files in `without` are left out. The evidence of scores is copied beside their
    record. The same results may be collected again.

    Raises:
        RacinesError: a missing folder or one without scores, a damaged file, a metric that cannot
            be, evidence that the scores do not follow from, scores of other data, judges, metrics
            or starts than the board's, two of one name, a name that looks like another's on the
            board, or, without `force`, a record of another result in the place of one.
    """
    records: dict[Path, Record] = {}
    evidence: dict[Path, bytes] = {}
    pin = read_pin(results, board)
    for folder in folders:
        paths = [folder] if folder.is_file() else sorted(folder.glob("*.json"))
        if not paths:
            raise RacinesError(f"{folder}: no scores; run `racines eval` first")
        for path in (path for path in paths if path not in without):
            record = _record(path, submissions, board)
            track = TRACK[record["track"]]
            check_fits(record["scores"], track, pin, str(path))
            read_evidence(path, record["scores"], track, pin)
            place = results / board / record["track"] / f"{record['name']}.json"
            before = read_json(place, "record") if place.is_file() else {}
            if before.get("tier") == "reproduced" and before["scores"] == record["scores"]:
                earned = {key: before[key] for key in ("tier", "reproduced") if key in before}
                record = sealed(record | earned)
            if place in records:
                raise RacinesError(f"{path}: another folder has scores of that name: keep one")
            records[place] = record
            if (beside := evidence_path(path, record["scores"])) is not None:
                evidence[place] = beside.read_bytes()
    one_dataset(records, results, board)
    write_records(records, results, submissions, board, force, evidence)
    return list(records)


def write_records(
    records: dict[Path, Record], results: Path, submissions: Path, board: str, force: bool,
    evidence: Mapping[Path, bytes] | None = None,
) -> None:  # fmt: skip
    """Write records where they belong, all or none; one process at a time writes to boards.

    `evidence` has the content of the file beside a record, by the record's path. What lies beside
    a record that has none, or none any more, is removed. So it is with what the robustness reports
    of their submissions say.

    Raises:
        RacinesError: as `collect`, of names, what the board is pinned to, and what is there; or a
            robustness report at fault.
    """
    evidence, studied = evidence or {}, results / board / ROBUSTNESS
    reported = {
        studied / path.name: robustness_of(record, submissions / record["track"])
        for path, record in records.items()
        if record["track"] == PATIENT_AGENTS.name
    }
    with locked(results):
        one_dataset(records, results, board)
        for path, record in records.items():
            beside = {each.stem for each in (*path.parent.glob("*.json"), *records)
                      if each.parent == path.parent}  # fmt: skip
            check_unlike(path.stem, beside, f"{path}: name")
            if not force and path.is_file():
                _check_replaces(path, read_json(path, "record"), record)
        tables = {path.with_suffix(".parquet"): evidence.get(path) for path in records}
        for folder in {path.parent for path in records}:
            for table in folder.glob("*.parquet"):
                if not table.with_suffix(".json").is_file():
                    tables.setdefault(table, None)
        with _undone_on_error([*records, *tables, *reported]):
            for path, content in tables.items():
                if content is None:
                    path.unlink(missing_ok=True)
                else:
                    write_atomic(path, content)
            for path, record in (reported | records).items():
                if record is None:
                    path.unlink(missing_ok=True)
                else:
                    write_record(path, record)


@contextmanager
def _undone_on_error(paths: Sequence[Path]) -> Iterator[None]:
    """Put files back as they were, if writing them ends early: with a full disk, or by hand."""
    before = {path: path.read_bytes() if path.is_file() else None for path in paths}
    try:
        yield
    except BaseException:
        for path, content in before.items():
            if content is None:
                path.unlink(missing_ok=True)
            elif not path.is_file() or path.read_bytes() != content:
                write_atomic(path, content)
        raise


def _check_replaces(path: Path, before: Record, record: Record) -> None:
    """Refuse to put a record in the place of one that says something else."""
    apart = [key for key in (*before, *record) if key not in ("scores", KEY)]
    differing = [key for key in dict.fromkeys(apart) if before.get(key) != record.get(key)]
    if not same_result(before["scores"], record["scores"]):
        differing.append("scores")
    if differing:
        raise RacinesError(
            f"{path}: holds another result, {before['tier']}; this one is {record['tier']} and "
            f"differs in {', '.join(differing)}: --force to replace it"
        )


def basis_of(record: Record) -> str | None:
    """Return the recipe digest of the dataset, or the phantom, that a result rests on."""
    return recipe_of(record["scores"])


def record_of(
    board: str, track: Track, name: str, tier: str, submission: Any, scores: dict[str, Any]
) -> Record:
    """Return a sealed record."""
    about = {"schema": "racines.record/1", "board": board, "track": track.name, "name": name}
    return sealed(about | {"tier": tier, "submission": submission, "scores": scores})


def _record(path: Path, submissions: Path, board: str) -> Record:
    scores, track = read_scores(path)
    name = scores[track.subject]
    if name != path.stem:
        raise RacinesError(f"{path}: {track.subject}: {name!r} differs from the file's name")
    # Several runs of one method share its submission; on patients one with other settings may have
    # its own, by the run's name.
    names = [scores.get("submission", name)]
    if track.name == PATIENT_AGENTS.name:
        names.insert(0, run_name(name, scores["task"]["view"]))
    found = (find_submission(submissions, track.name, each) for each in names)
    submission = next((each for each in found if each is not None), None)
    record = record_of(board, track, name, "self-reported", submission, scores)
    check(record, "record", str(path))
    return record


def read_scores(path: Path) -> tuple[dict[str, Any], Track]:
    """Read a scores file and tell its track; refuse what no scoring can have made."""
    found = read_json(path, "any")
    track = track_of(found)
    if track is None:
        known = ", ".join(dict.fromkeys(f"racines.{each.schema}/1" for each in TRACKS))
        raise RacinesError(f"{path}: schema: {found['schema']!r} is none of {known}")
    scores = read_json(path, track.schema)
    check_possible(scores, str(path))
    return scores, track


def read_record(path: Path, board: str, track: Track) -> Record:
    """Read one record; refuse what is damaged, or says that it belongs elsewhere."""
    record = read_json(path, "record")
    for key, value in (("board", board), ("track", track.name), ("name", path.stem)):
        if record[key] != value:
            raise RacinesError(f"{path}: {key}: {record[key]!r}, expected {value!r} by its place")
    check(record["scores"], track.schema, f"{path}: scores")
    if (own := track_of(record["scores"])) is None or own.name != track.name:
        place, about = ("task.view", "task") if track.steers else ("dataset.source", "dataset")
        said = record["scores"][about].get(place.partition(".")[2])
        raise RacinesError(f"{path}: scores.{place}: {said!r} is none of track {track.name}")
    check_possible(record["scores"], f"{path}: scores")
    evidence_path(path, record["scores"])
    return record


def one_dataset(new: dict[Path, Record], results: Path, board: str) -> None:
    """Check that a board is whole once new records are written.

    All fit what it is pinned to, and each track rests on one recipe, pinned or not.
    """
    pin, kept = read_pin(results, board), {}
    for track in TRACKS:
        for path in sorted((results / board / track.name).glob("*.json")):
            if path not in new:
                kept[path] = read_record(path, board, track)
    for path, record in (kept | new).items():
        check_fits(record["scores"], TRACK[record["track"]], pin, str(path))
    seen: dict[str, dict[str, Path]] = {track.name: {} for track in TRACKS}
    for path, record in (kept | new).items():
        if (digest := basis_of(record)) is not None:
            seen[record["track"]].setdefault(digest, path)
    for paths in seen.values():
        if len(paths) > 1:
            (first, a), (second, b) = list(paths.items())[:2]
            raise RacinesError(
                f"board {board}: {a} rests on recipe {first[:12]} and {b} on {second[:12]}; score "
                "both on one dataset, remove the stale record, or name another board"
            )
