"""A merged agent on patients nobody has drawn: its policy in this repository acts there.

Its record is not scored again in public, which is what an audit does.
"""

from pathlib import Path
from typing import Any

from racines_data.errors import RacinesError
from racines_envs.evaluation.patients import start_set
from racines_leaderboard.audit import weights as files
from racines_leaderboard.audit.bench import Bench
from racines_leaderboard.audit.roads import Road, find_road, score_agent
from racines_leaderboard.board.collect import read_record
from racines_leaderboard.fresh.draws import secret_starts, told_of_patients, write_draws
from racines_leaderboard.fresh.rounds import Secret, round_of
from racines_leaderboard.records.tracks import PATIENT_AGENTS, TRACK


def merged_record(results: Path, board: str | None, name: str) -> Path | None:
    """Return the record of a board by NAME or TRACK/NAME, if it is of a merged agent on patients.

    None where there is no such record, or where it was made of artefacts that were handed in.
    """
    track = PATIENT_AGENTS.name
    bare = name.removeprefix(f"{track}/")
    if board is None or "/" in bare:
        return None
    path = results / board / track / f"{bare}.json"
    if not path.is_file() or files.submitted(read_record(path, board, TRACK[track])):
        return None
    return path


def draw_merged(
    path: Path, bench: Bench, secret: Secret, today: str, force: bool = False
) -> dict[str, Any]:
    """Let all trainings of a record's agent act on a round's patients; write and return a file.

    The file is that of `draw_in_secret`. The patients are as many as the board's, with as many
    starts on each.

    Raises:
        RacinesError: a nonce that the board did not commit to, an agent without weights, weights
            that are not here or of which the first training alone is, or, without `force`, other
            figures in the file's place.
    """
    results = path.parents[2]
    number = round_of(results, secret)
    record = read_record(path, bench.board, TRACK[path.parent.name])
    weights, folder = files.named(record), files.run_of(record, bench)
    if not weights:
        raise RacinesError(f"{path}: it learns nothing, so that nothing is to be confirmed")
    road = find_road(record, bench)
    if not isinstance(road, Road) or road.trainings is not None:
        why = road if isinstance(road, str) else f"{folder} has its first training alone"
        raise RacinesError(f"{path}: cannot be drawn in secret: {why}")
    starts = secret_starts(secret, start_set(bench.on_patients(record["scores"]["task"]["view"])))
    made = score_agent(record, bench, folder, starts=starts).scores
    if made["runs"] != record["scores"]["runs"]:
        raise RacinesError(
            f"{path}: {made['runs']} of its {record['scores']['runs']} trainings acted: with a "
            "grader that it goes by, the first alone can be drawn"
        )
    about = {"track": record["track"], "name": record["name"], "weights": weights, "reason": None}
    about |= told_of_patients(record, starts, made["metrics"])
    return write_draws(about, results, secret, number["nonce"] is not None, today, force)
