"""Several methods trained as one set: none waits for another's fault, and a killed set goes on."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import pytest

from racines_data.engines.local import LocalEngine
from racines_data.errors import RacinesError
from racines_models.protocol import Run
from racines_models.training.sets import FINISHED, Training, train_set


@dataclasses.dataclass(frozen=True)
class Fits:
    """Leaves its seed; refused, or killed, at a seed."""

    name: str
    refused_at: int | None = None
    killed_at: int | None = None

    def __call__(self, run: Run) -> dict[str, Any]:
        if run.seed == self.refused_at:
            raise RacinesError(f"{self.name} has no grader")
        if run.seed == self.killed_at:
            raise KeyboardInterrupt
        run.folder.mkdir(parents=True, exist_ok=True)
        with (run.folder / "trained").open("a") as file:
            file.write(f"{self.name} {run.seed} {run.resume}\n")
        return {"psnr": 20.0 + run.seed, "process": os.getpid()}


def a_set(folder: Path, *fits: Fits, repeats: int = 2, **run: Any) -> list[Training]:
    return [
        Training(each, Run(folder / each.name, 3, **run), repeats, what={"of": each.name})
        for each in fits
    ]


def trained(folder: Path) -> dict[str, str]:
    found = sorted(folder.rglob("trained"))
    return {str(path.parent.relative_to(folder)): path.read_text() for path in found}


ALL = {
    "a": "a 3 None\n", "a/seed-4": "a 4 None\n", "b": "b 3 None\n", "b/seed-4": "b 4 None\n",
}  # fmt: skip


@pytest.mark.parametrize("engine", [None, LocalEngine(2)], ids=["here", "two processes"])
def test_each_method_has_its_metrics_and_all_runs_their_folders(
    tmp_path: Path, engine: LocalEngine | None
):
    told: list[Run] = []
    metrics = train_set(
        a_set(tmp_path, Fits("a"), Fits("b")), engine, lambda run, _: told.append(run)
    )
    assert trained(tmp_path) == ALL and len(told) == 4
    assert [[each["psnr"] for each in own["seeds"].values()] for own in metrics] == [[23, 24]] * 2
    assert metrics[1] == json.loads((tmp_path / "b" / "metrics.json").read_text())
    own = {each["process"] for of in metrics for each in of["seeds"].values()}
    assert (os.getpid() in own) == (engine is None)
    assert not [*tmp_path.rglob(FINISHED)], "notes of a set that is done"


def test_what_is_refused_costs_itself_only_and_is_trained_by_the_next_command(tmp_path: Path):
    with pytest.raises(RacinesError, match=r"1 of 4 trainings were refused: .*a: a has no grader"):
        train_set(a_set(tmp_path, Fits("a", refused_at=3), Fits("b")))
    assert {*trained(tmp_path)} == {"a/seed-4", "b", "b/seed-4"}
    train_set(a_set(tmp_path, Fits("a"), Fits("b")))
    assert trained(tmp_path) == ALL, "each once"


def test_a_killed_set_goes_on_and_a_finished_one_is_trained_anew(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        train_set(a_set(tmp_path, Fits("a"), Fits("b", killed_at=3)))
    train_set(a_set(tmp_path, Fits("a"), Fits("b")))
    assert trained(tmp_path) == ALL
    train_set(a_set(tmp_path, Fits("a"), Fits("b"), resume=False))
    assert trained(tmp_path)["b"] == "b 3 None\nb 3 False\n"


def test_what_is_trained_alone_is_no_longer_what_a_killed_set_noted(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        train_set(a_set(tmp_path, Fits("a"), Fits("b", killed_at=3), repeats=1))
    assert (tmp_path / "a" / FINISHED).is_file()
    train_set(a_set(tmp_path, Fits("a"), repeats=1))
    assert not [*tmp_path.rglob(FINISHED)]


def test_fresh_forgets_what_was_done_of_a_killed_set(tmp_path: Path):
    for resume in (None, False):
        with pytest.raises(KeyboardInterrupt):
            train_set(a_set(tmp_path, Fits("a"), Fits("b", killed_at=4), resume=resume))
    assert trained(tmp_path)["a"] == "a 3 None\na 3 False\n"


@pytest.mark.parametrize("note", [None, "cut sho", '{"seed": 3, "what": {"of": "c"}}', "[]"])
def test_what_was_done_as_something_else_is_trained_anew(
    tmp_path: Path, note: str | None, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(KeyboardInterrupt):
        train_set(a_set(tmp_path, Fits("a"), Fits("b", killed_at=3)))
    first, *others = a_set(tmp_path, Fits("a"), Fits("b"))
    if note is None:
        first = dataclasses.replace(first, what={"of": "a", "images": 100})
    else:
        (tmp_path / "a" / FINISHED).write_text(note)
    train_set([first, *others])
    again = trained(tmp_path)
    assert again["a"] == ALL["a"] * 2 and again["b"] == ALL["b"]
    assert f"{tmp_path / 'a'}: done with other settings" in capsys.readouterr().err


def test_two_methods_do_not_share_a_folder(tmp_path: Path):
    one, other = a_set(tmp_path, Fits("a"), Fits("b"))
    with pytest.raises(RacinesError, match="seed-4: two trainings would write there"):
        train_set([one, dataclasses.replace(other, run=one.runs[1], repeats=1)])
    assert not trained(tmp_path)


class Elsewhere(LocalEngine):
    """Workers that see another folder."""

    def map(self, work: Any, state: Any, tasks: Any, *_: Any, **settings: Any) -> Any:
        return ({"psnr": 20.0} for _ in tasks)


def test_a_worker_that_wrote_elsewhere_is_found_out(tmp_path: Path):
    with pytest.raises(RacinesError, match="seed 3 and nothing is there: give --out a folder that"):
        train_set(a_set(tmp_path, Fits("a"), repeats=1), Elsewhere())
