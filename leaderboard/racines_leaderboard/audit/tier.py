"""The tier of a record: what the evidence at hand gives it, whatever it says of itself.

recomputed      its submission holds artefacts that can be scored, and they are what was scored
reproduced      it keeps how it came out when it was trained again
self-reported   neither
"""

from collections.abc import Iterator
from typing import Any

from racines_leaderboard.audit.numbers import bounds_of
from racines_leaderboard.audit.verdicts import Verdict, equal, fails, holds, unknown
from racines_leaderboard.audit.weights import named, submitted
from racines_leaderboard.board.collect import Record
from racines_leaderboard.records.ranges import ENDS
from racines_leaderboard.records.tracks import TRACK
from racines_leaderboard.submissions.document import rescored

SELF_REPORTED, RECOMPUTED, REPRODUCED = "self-reported", "recomputed", "reproduced"
ANEW = ("fitted", "no weights")
"""Roads that make the system itself anew."""


def tier_of(record: Record) -> str:
    """Return the tier that a record's own content gives it; its checks say if that is true."""
    if submitted(record):
        handed_in = {each["path"]: each["sha256"] for each in rescored(record["submission"])}
        return RECOMPUTED if named(record) == handed_in else SELF_REPORTED
    return REPRODUCED if "reproduced" in record else SELF_REPORTED


def check_tier(record: Record) -> Iterator[Verdict]:
    """Check the tier that a record says it has."""
    reason = "derived: artefacts that were scored, or another training that is kept, or neither"
    yield equal("tier", record["tier"], tier_of(record), reason)


def check_reproduced(
    record: Record, made: dict[str, Any] | None, road: str, tier: str
) -> Iterator[Verdict]:
    """Check how a record says that it came out when it was trained again."""
    again = record.get("reproduced")
    if again is None:
        return
    for key in TRACK[record["track"]].ranked_by:
        ends, metric = record["scores"]["metrics"].get(key), again["metrics"].get(key)
        if ends is None or ends["low"] is None:
            continue
        if metric is None or metric["value"] is None:
            yield fails(f"reproduced.{key}", "it ranks, and did not come out")
        elif not ends["low"] <= metric["value"] <= ends["high"]:
            reason = f"outside its 95 % interval {ends['low']:.6g} to {ends['high']:.6g}"
            yield fails(f"reproduced.{key}", reason, ends["value"], metric["value"])
    if made is None or road not in ANEW:
        reason = "rests on another training, which --retrain makes again"
        yield unknown("reproduced", reason)
        return
    wrong = [
        f"{key}.{end}"
        for key, metric in again["metrics"].items()
        if (here := made["metrics"].get(key)) is not None
        for end in (*ENDS, "n")
        if not _within(metric[end], here[end], bounds_of(key, here, tier, record["track"])[0])
    ]
    # Scores of who draws nothing name no seed: those of its trainings are as many as those are.
    told = {"seeds": again["seeds"][: made.get("runs", 1)]} | made
    wrong += [key for key in ("seeds", "weights") if again[key] != told[key]]
    wrong += [key for key in again["metrics"] if key not in made["metrics"]]
    for place in wrong:
        yield fails(f"reproduced.{place}", "made anew here, it comes out otherwise")
    if not wrong:
        yield holds("reproduced", "made anew here, and came out so")


def _within(claimed: float | None, here: float | None, bound: float) -> bool:
    if claimed is None or here is None:
        return claimed is here
    return abs(claimed - here) <= bound
