"""Many visitors at once: `python -m tests.leaderboard.studio.load URL --sessions 20 --seconds 60`.

Each is a session of its own that does what a browser does: it joins the queue and reads the stream
of events. It looks at boards, moves through the dataset, answers a study, drives the probe, lets
generators draw, and watches an agent, as far as the page has these tabs; every answer is checked to
come from its own sitting or episode. `--turns 2` lets each do so much, in place of so long.
"""

import argparse
import itertools
import json
import random
import statistics
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import httpx

from tests.waiting import PATIENCE

SECONDS = 60.0
"""How long a visitor stays, unless it is told how much to do."""


class Visitor:
    """One session: it sends values to the page's events, by name, and reads what comes back."""

    def __init__(self, url: str, seed: int) -> None:
        self.client = httpx.Client(base_url=url, timeout=PATIENCE)
        self.random = random.Random(seed)
        self.session = f"load{self.random.getrandbits(60):x}"
        config = self.client.get("/config").raise_for_status().json()
        self.events = {each["api_name"]: each for each in config["dependencies"]}
        self.parts = {part["id"]: part["props"] for part in config["components"]}

    def call(self, name: str, *values: Any) -> list[Any]:
        """Send an event and wait for its end; None stands for a state."""
        event = {"fn_index": self.events[name]["id"], "session_hash": self.session}
        body = event | {"data": list(values), "event_data": None, "trigger_id": None}
        joined = self.client.post("/gradio_api/queue/join", json=body).raise_for_status()
        stream = f"/gradio_api/queue/data?session_hash={self.session}"
        with self.client.stream("GET", stream) as lines:
            for line in lines.iter_lines():
                message = json.loads(line[6:]) if line.startswith("data: ") else {}
                if message.get("msg") == "process_completed":
                    assert message["event_id"] == joined.json()["event_id"]
                    if not message["success"]:
                        raise RuntimeError(f"{name}: {message['output']}")
                    return message["output"]["data"]
        raise RuntimeError(f"{name}: the stream ended without an answer")

    def offered(self, event: str, place: int) -> list[Any]:
        """Return the choices of an event's input."""
        return [each[1] for each in self.parts[self.events[event]["inputs"][place]]["choices"]]


@dataclass
class Told:
    """What visitors did: seconds of each call, by event, and what went wrong."""

    seconds: dict[str, list[float]] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)

    def __iadd__(self, other: "Told") -> "Told":
        for name, seconds in other.seconds.items():
            self.seconds.setdefault(name, []).extend(seconds)
        self.errors += other.errors
        return self


def numbers(seconds: float, turns: int | None) -> Iterable[int]:
    """Number a visitor's turns: so many, or as many as it begins within the seconds."""
    if turns is not None:
        return range(turns)
    end = time.monotonic() + seconds
    return itertools.takewhile(lambda _: time.monotonic() < end, itertools.count())


def spend(url: str, seed: int, seconds: float, turns: int | None) -> Told:
    """Be one visitor; see `numbers`."""
    told = Told()
    try:
        visitor = Visitor(url, seed)

        def call(name: str, *values: Any) -> list[Any]:
            start = time.monotonic()
            answer = visitor.call(name, *values)
            told.seconds.setdefault(name, []).append(time.monotonic() - start)
            return answer

        doings = [doing for event, doing in DOINGS.items() if event in visitor.events]
        for turn in numbers(seconds, turns):
            doings[(turn + seed) % len(doings)](visitor, call, f"load-{seed}-{turn}")
    except (AssertionError, RuntimeError, httpx.HTTPError) as error:
        told.errors.append(f"visitor {seed}: {type(error).__name__}: {error}")
    return told


def _boards(visitor: Visitor, call: Any, name: str) -> None:
    board = visitor.random.choice(visitor.offered("boards_show", 0))
    tiers = visitor.offered("boards_show", 4)
    chosen = [board, "generators", "all", "all", tiers, visitor.random.random() < 0.5]
    tables = call("boards_show", *chosen)[0]
    assert f"{board} · generators" in tables or "No result fits" in tables


def _data(visitor: Visitor, call: Any, name: str) -> None:
    config = visitor.offered("data_show", 0)[0]
    sweep = visitor.random.choice(visitor.offered("data_show", 1))
    assert f"{sweep}: " in call("data_show", config, sweep)[0]
    for frame in (2, 1):
        assert f"frame {frame} of" in call("data_move", config, sweep, frame)[0]


def _study(visitor: Visitor, call: Any, name: str) -> None:
    kit = visitor.offered("study_begin", 0)[0]
    kind = visitor.offered("study_begin", 2)[0]
    call("study_begin", kit, name, kind, "", "")
    for done in range(1, 4):
        shown = call("study_save", None, "Random", None)
        progress = next(part for part in shown if isinstance(part, str) and "answered" in part)
        assert f"{done} of " in progress and progress.count(name) == 1
    call("study_leave")


def _probe(visitor: Visitor, call: Any, name: str) -> None:
    task = visitor.random.choice(visitor.offered("probe_start", 0))
    patient = visitor.random.choice(PATIENTS)
    number, truth = visitor.random.randrange(2**31), visitor.random.random() < 0.5
    call("probe_start", task, "seed", number, "free", patient, truth)
    for step in range(1, 4):
        action = visitor.random.randrange(12)
        shown = call(f"probe_step_{action}", None, truth)[1]
        assert f"{task}-v0</b>" in shown and f"step <b>{step}</b> of" in shown


def _generators(visitor: Visitor, call: Any, name: str) -> None:
    offered = visitor.offered("generators_draw", 1)
    ticked = visitor.random.sample(offered, min(2, len(offered)))
    pose = visitor.random.choice(visitor.offered("generators_set", 0))
    note, *values = call("generators_set", pose)
    assert pose in note
    cards = call("generators_draw", visitor.random.randrange(2**31), ticked, *values)[0]
    assert all(f"<b>{each}</b>" in cards for each in ticked)


def _agent(visitor: Visitor, call: Any, name: str) -> None:
    agent = visitor.random.choice(visitor.offered("agent_watch", 0)[:2])
    task = visitor.random.choice(visitor.offered("agent_watch", 1))
    number = visitor.random.randrange(4)
    first = call("agent_watch", agent, task, number, "free", PATIENTS[0])[3]
    assert f"{task}-v0</b>" in first and "step <b>0</b> of" in first
    for step in (1, 2):
        shown = call("agent_show", None, step, "off")[0]
        assert f"{task}-v0</b>" in shown and f"step <b>{step}</b> of" in shown


PATIENTS = (10_000, 10_001)
DOINGS = {
    "boards_show": _boards,
    "data_show": _data,
    "study_begin": _study,
    "probe_start": _probe,
    "generators_draw": _generators,
    "agent_watch": _agent,
}
"""What a visitor does, by the event that its tab has."""


def run(url: str, sessions: int, seconds: float = SECONDS, turns: int | None = None) -> Told:
    """Let many visitors in at once and return what they did.

    Args:
        url: Of the Studio.
        sessions: Visitors.
        seconds: How long each begins another turn, unless `turns` is given.
        turns: Turns of each, however long they take.
    """
    told = Told()
    with ThreadPoolExecutor(sessions) as pool:
        for each in pool.map(lambda seed: spend(url, seed, seconds, turns), range(sessions)):
            told += each
    return told


def main() -> None:
    """Print a line for each kind of event; exit with 1 after an error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url")
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--turns", type=int, help="of each session, in place of the seconds")
    given = parser.parse_args()
    began = time.monotonic()
    told = run(given.url, given.sessions, given.seconds, given.turns)
    took = time.monotonic() - began
    for name, seconds in sorted(told.seconds.items()):
        middle, worst = statistics.median(seconds), max(seconds)
        print(f"{name:20} {len(seconds):6} calls, median {middle:.2f} s, longest {worst:.2f} s")
    print(f"{given.sessions} sessions, {took:.0f} s, errors: {len(told.errors)}")
    for error, count in Counter(told.errors).items():
        print(f"{count} x {error}")
    raise SystemExit(bool(told.errors))


if __name__ == "__main__":
    main()
