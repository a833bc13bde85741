"""How much memory is left, and pools of patients that it does not hold."""

from collections.abc import Callable
from pathlib import Path

import gymnasium
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.patients import memory
from racines_data.patients import pool as pools
from racines_data.patients.memory import PoolTooLarge, available_memory, check_memory
from racines_data.patients.pool import Pool
from racines_data.patients.volume import HEART_BYTES
from racines_envs.worlds import ward
from racines_envs.worlds.ward import make_ward
from racines_leaderboard.cli.command import app

Left = Callable[[int], None]
SEEDS = (10_000, 10_001, 10_002)


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> Left:
    """Let the machine have memory for so many hearts; those kept from before are forgotten."""
    ward._pool.cache_clear()

    def set_to(hearts: int) -> None:
        monkeypatch.setattr(pools, "available_memory", lambda device: hearts * HEART_BYTES + 5)

    return set_to


def test_what_linux_says_is_available_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    told = tmp_path / "meminfo"
    told.write_text("MemTotal:  8000 kB\nMemFree:  100 kB\nMemAvailable:  5000 kB\n")
    monkeypatch.setattr(memory, "MEMINFO", told)
    monkeypatch.setattr(memory, "OWN_GROUP", tmp_path / "none")
    assert available_memory() == available_memory(torch.device("cpu")) == 5000 * 1024


def test_the_limit_of_a_group_or_of_one_above_counts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    own, groups = tmp_path / "cgroup", tmp_path / "groups"
    own.write_text("4:memory:/old\n0::/job/task\n")
    for group, limit, used in (("job", 90_000, 50_000), ("job/task", "max", 40_000)):
        place = groups / group
        place.mkdir(parents=True)
        (place / "memory.max").write_text(f"{limit}\n")
        (place / "memory.current").write_text(f"{used}\n")
        (place / "memory.stat").write_text("anon 40000\ninactive_file 7000\n")
    monkeypatch.setattr(memory, "OWN_GROUP", own)
    monkeypatch.setattr(memory, "GROUPS", groups)
    assert available_memory() == 90_000 - 50_000 + 7_000


def test_without_linux_all_memory_counts_or_nothing_is_known(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    for name in ("MEMINFO", "OWN_GROUP"):
        monkeypatch.setattr(memory, name, tmp_path / "none")
    whole = available_memory()
    assert whole is not None and whole > 100_000_000
    monkeypatch.delattr(memory.os, "sysconf")
    assert available_memory() is None


def test_the_lesser_of_what_may_be_taken_and_what_is_there_counts():
    check_memory(3, 3 * HEART_BYTES, 3 * HEART_BYTES)
    check_memory(3, None, None)
    for memory_, free, told in (
        (2, 9, "a pool may take 0.0 GB: 2 fit; .* raise `memory`"),
        (
            9,
            2,
            "0.0 GB of memory are free: 2 fit; take fewer patients, or fewer at a time by `chunk`",
        ),
        (9, 0, "0 fit; end other programs"),
    ):
        with pytest.raises(PoolTooLarge, match=f"3 hearts take 0.1 GB and .*{told}"):
            check_memory(3, memory_ * HEART_BYTES, free * HEART_BYTES)
    with pytest.raises(PoolTooLarge, match="200 hearts take 4.0 GB.* 150 fit"):
        check_memory(200, None, 150 * HEART_BYTES)


def test_a_pool_that_the_machine_does_not_hold_is_refused_before_it_is_made(
    left: Left, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Pool, "_heart", None)  # calling it fails
    left(2)
    with pytest.raises(RacinesError, match="of memory are free: 2 fit"):
        Pool(SEEDS, memory=1 << 50)


def test_poses_take_no_memory_but_pictures_do(left: Left):
    left(0)
    pool, rows = Pool(SEEDS[:1], memory=None), torch.zeros(1, dtype=torch.int64)
    assert pool.targets(rows).position.shape == (1, 5, 3)
    with pytest.raises(PoolTooLarge, match="0 fit; end other programs"):
        pool.render(Pose(*(part[:, 0] for part in pool.targets(rows))), rows)


def test_pools_that_are_kept_give_way(left: Left, monkeypatch: pytest.MonkeyPatch):
    left(2)
    first = make_ward("patients", "validation", SEEDS[:1])
    kept = ward._pool.cache_info

    def while_kept(device: torch.device) -> int:
        return (2 - kept().currsize) * HEART_BYTES

    monkeypatch.setattr(pools, "available_memory", while_kept)
    assert make_ward("patients", "validation", SEEDS[:1]).pool is first.pool
    assert len(make_ward("patients", "validation", SEEDS[:2]).pool) == 2
    assert kept().currsize == 1


def test_environments_and_commands_say_what_fits(
    left: Left, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.chdir(tmp_path)
    left(2)
    said = r"8 hearts take 0\.2 GB and 0\.0 GB of memory are free: 2 fit; .*`chunk`"
    with pytest.raises(RacinesError, match=said):
        gymnasium.make_vec("racines_envs:racines/SC-patients-v0", num_envs=2, reward="oracle")
    words = ["eval", "agent", "random", "--view", "A4C", "--tier", "patients"]
    words += ["--set", "patients=3", "--set", "starts=1"]
    refused = CliRunner().invoke(app, words)
    assert isinstance(refused.exception, RacinesError)
    assert "3 hearts take 0.1 GB" in str(refused.exception)
    done = CliRunner().invoke(app, [*words, "--set", "chunk=2"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
