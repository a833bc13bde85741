"""Rounds of fresh draws: what is committed to, what is refused, and what nobody can guess."""

import hashlib
import json
import random
import stat
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_leaderboard.fresh.rounds import (
    Secret,
    commit,
    read_history,
    read_secret,
    reveal,
    round_of,
)
from tests.leaderboard.conftest import generator_scores

NONCE = hashlib.sha256(b"a test's own").digest()
OTHER = hashlib.sha256(b"another").digest()
DAY = "2026-01-31"


@pytest.fixture
def results(tmp_path) -> Path:
    """Results with one board, in a folder that is no checkout."""
    folder = tmp_path / "results"
    (folder / "tiny/generators").mkdir(parents=True)
    (folder / "tiny/generators/mine.json").write_text(json.dumps(generator_scores("mine")))
    return folder


def history(results: Path) -> dict:
    return json.loads((results / "tiny/secrets.json").read_text())


def test_a_round_is_committed_to_and_revealed(results, tmp_path):
    private = commit(results, "tiny", NONCE, DAY, tmp_path / "own/nonce.json")
    assert stat.S_IMODE(private.stat().st_mode) == 0o600
    assert stat.S_IMODE(private.parent.stat().st_mode) == 0o700
    (entry,) = history(results)["rounds"]
    assert entry["commitment"] == hashlib.sha256(NONCE).hexdigest() and entry["nonce"] is None
    for path in results.rglob("*"):
        assert path.is_dir() or NONCE.hex() not in path.read_text(), path
    secret = read_secret(private, results, "tiny")
    assert secret == Secret("tiny", 1, NONCE) and NONCE.hex() not in repr(secret)
    reveal(results, secret, "2026-02-28")
    (entry,) = history(results)["rounds"]
    assert bytes.fromhex(entry["nonce"]) == NONCE and entry["revealed"] == "2026-02-28"
    # Anybody has it from now on, and the next round is another.
    assert read_secret(results / "tiny/secrets.json", results, "tiny") == secret
    commit(results, "tiny", OTHER, "2026-03-01", tmp_path / "own/2.json")
    assert [each["nonce"] for each in history(results)["rounds"]] == [NONCE.hex(), None]
    assert history(results)["rounds"][0] == entry


def test_what_could_be_guessed_is_refused(results, tmp_path):
    out = tmp_path / "nonce.json"
    guessable = {
        "one byte": b"\x07",
        "128 bits": NONCE[:16],
        "248 bits": NONCE[:31],
        "264 bits": NONCE + b"\x00",
        "a small integer": (123456789).to_bytes(32),
        "a small integer, little-endian": (123456789).to_bytes(32, "little"),
        "a large integer that was padded": NONCE[:24].rjust(32, b"\x00"),
        "nothing": bytes(32),
        "its digits": b"123456789".ljust(32),
        "a pattern": NONCE[:16] * 2,
    }
    for what, nonce in guessable.items():
        with pytest.raises(RacinesError, match="nonce"):
            commit(results, "tiny", nonce, DAY, out)
        assert not out.exists() and not (results / "tiny/secrets.json").exists(), what
        told = {"schema": "racines.nonce/1", "board": "tiny", "round": 1, "nonce": nonce.hex()}
        aside = tmp_path / "made.json"
        aside.write_text(json.dumps(told))
        aside.chmod(0o600)
        with pytest.raises(RacinesError, match="nonce"):
            read_secret(aside, results, "tiny")
        (results / "tiny/secrets.json").write_text(
            json.dumps({
                "schema": "racines.secrets/1", "board": "tiny",
                "rounds": [{"round": 1, "commitment": hashlib.sha256(nonce).hexdigest(),
                            "committed": DAY, "nonce": nonce.hex(), "revealed": DAY}],
            })
        )  # fmt: skip
        with pytest.raises(RacinesError, match="nonce"):
            read_history(results, "tiny")
        (results / "tiny/secrets.json").unlink()


def guesses(number: int):
    """Give what a careless program would make of a small number."""
    yield number.to_bytes(32)
    yield number.to_bytes(32, "little")
    yield str(number).encode()
    yield hashlib.sha256(str(number).encode()).digest()
    yield hashlib.sha256(number.to_bytes(8)).digest()
    yield random.Random(number).randbytes(32)
    yield np.random.default_rng(number).bytes(32)


def found(commitments: set[str], most: int) -> bool:
    digests = (hashlib.sha256(each).hexdigest() for i in range(most) for each in guesses(i))
    return any(digest in commitments for digest in digests)


def test_brute_force_finds_no_commitment(results, tmp_path):
    commitments = set()
    for number in (1, 2):
        out = tmp_path / f"{number}.json"
        words = ["board", "commit-secret", "tiny", "--results", str(results), "--out", str(out)]
        # A program that seeds the global generators gets the same nonces no more than any other.
        random.seed(0)
        done = CliRunner().invoke(app, [*words, "--json"])
        assert done.exit_code == 0, done.output
        nonce = json.loads(out.read_text())["nonce"]
        assert nonce not in done.output
        commitments.add(json.loads(done.stdout)["commitment"])
        words = ["board", "reveal", "tiny", "--results", str(results), "--secret", str(out)]
        assert CliRunner().invoke(app, words).exit_code == 0
    assert len(commitments) == 2 and not found(commitments, 3000)
    careless = hashlib.sha256(random.Random(2026).randbytes(32)).hexdigest()
    assert found({careless}, 3000)  # the search finds what there is to be found


def test_no_second_round_before_the_reveal(results, tmp_path):
    commit(results, "tiny", NONCE, DAY, tmp_path / "1.json")
    with pytest.raises(RacinesError, match="round 1 is open: reveal it first"):
        commit(results, "tiny", OTHER, DAY, tmp_path / "2.json")
    assert not (tmp_path / "2.json").exists()
    reveal(results, Secret("tiny", 1, NONCE), DAY)
    with pytest.raises(RacinesError, match="served a round before"):
        commit(results, "tiny", NONCE, DAY, tmp_path / "2.json")


def test_another_nonce_is_not_revealed(results, tmp_path):
    with pytest.raises(RacinesError, match="no round is open"):
        reveal(results, Secret("tiny", 1, NONCE), DAY)
    commit(results, "tiny", NONCE, DAY, tmp_path / "1.json")
    before = history(results)
    for wrong in (Secret("tiny", 1, OTHER), Secret("tiny", 2, NONCE)):
        with pytest.raises(RacinesError, match="no commitment to this nonce"):
            reveal(results, wrong, DAY)
        with pytest.raises(RacinesError, match="no commitment to this nonce"):
            round_of(results, wrong)
    assert history(results) == before
    reveal(results, Secret("tiny", 1, NONCE), DAY)
    with pytest.raises(RacinesError, match="no round is open"):
        reveal(results, Secret("tiny", 1, NONCE), DAY)


def test_a_history_that_was_edited_is_refused(results, tmp_path):
    commit(results, "tiny", NONCE, DAY, tmp_path / "1.json")
    reveal(results, Secret("tiny", 1, NONCE), DAY)
    commit(results, "tiny", OTHER, DAY, tmp_path / "2.json")
    sound, path = history(results), results / "tiny/secrets.json"
    first, last = sound["rounds"]
    for rounds, message in (
        ([last], "none is left out"),
        ([first | {"nonce": OTHER.hex()}, last], "not the commitment"),
        ([first, first | {"round": 2}], "stands there twice"),
        ([first | {"nonce": None, "revealed": None}, last], "reveal it first"),
        ([first | {"revealed": None}, last], "stand together"),
        ([first | {"revealed": "2025-01-01"}, last], "before it was committed"),
        ([first | {"seed": 7}, last], "seed"),
    ):
        path.write_text(json.dumps(sound | {"rounds": rounds}))
        with pytest.raises(RacinesError, match=message):
            read_history(results, "tiny")
    path.write_text(json.dumps(sound | {"board": "other"}))
    with pytest.raises(RacinesError, match="expected 'tiny' by its place"):
        read_history(results, "tiny")


def test_the_private_file_stays_private(results, tmp_path):
    for out in (results / "nonce.json", results / "tiny/nonce.json"):
        with pytest.raises(RacinesError, match="are published"):
            commit(results, "tiny", NONCE, DAY, out)
    (tmp_path / "checkout/.git").mkdir(parents=True)
    with pytest.raises(RacinesError, match="git checkout"):
        commit(results, "tiny", NONCE, DAY, tmp_path / "checkout/deep/nonce.json")
    (tmp_path / "link").symlink_to(results)
    with pytest.raises(RacinesError, match="are published"):
        commit(results, "tiny", NONCE, DAY, tmp_path / "link/nonce.json")
    (tmp_path / "there").write_text("mine")
    with pytest.raises(RacinesError, match="no secret is replaced"):
        commit(results, "tiny", NONCE, DAY, tmp_path / "there")
    assert (tmp_path / "there").read_text() == "mine"
    assert not (results / "tiny/secrets.json").exists()
    private = commit(results, "tiny", NONCE, DAY, tmp_path / "nonce.json")
    private.chmod(0o640)
    with pytest.raises(RacinesError, match="others may read it"):
        read_secret(private, results, "tiny")


def test_errors_never_show_a_nonce(results, tmp_path):
    private = commit(results, "tiny", NONCE, DAY, tmp_path / "nonce.json")
    told = json.loads(private.read_text())
    for change in (
        {"board": "other"},
        {"round": "1"},
        {"schema": "other"},
        {"nonce": NONCE.hex()[:-2]},
        {"nonce": NONCE.hex().upper()},
        {"nonce": [NONCE.hex()]},
    ):
        private.write_text(json.dumps(told | change))
        with pytest.raises(RacinesError) as caught:
            read_secret(private, results, "tiny")
        assert NONCE.hex()[:16] not in str(caught.value).lower()
    private.write_text(private.read_text()[:-3])
    with pytest.raises(RacinesError, match="not a file of"):
        read_secret(private, results, "tiny")


def test_seeds_follow_from_nonce_board_round_and_purpose():
    secret = Secret("tiny", 1, NONCE)
    beside = (Secret("tiny", 2, NONCE), Secret("large", 1, NONCE), Secret("tiny", 1, OTHER))
    others = [secret.seed("starts/0"), *(each.seed("poses") for each in beside)]
    seeds = {secret.seed("poses"), *others}
    assert len(seeds) == 5 and all(0 <= seed < 2**62 for seed in seeds)
    assert secret.seed("poses") == Secret("tiny", 1, NONCE).seed("poses")
    bits = np.array([[secret.seed(f"{i}") >> j & 1 for j in range(62)] for i in range(500)])
    assert np.abs(bits.mean(0) - 0.5).max() < 0.12


def test_an_unknown_board_is_refused(results, tmp_path):
    words = ["board", "commit-secret", "tyni", "--results", str(results)]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "n.json")])
    assert done.exit_code == 1 and "no results of tyni" in str(done.exception)
    assert not (tmp_path / "n.json").exists()


def test_a_reveal_before_its_commitment_changes_nothing(results, tmp_path):
    private = commit(results, "tiny", NONCE, "2026-10-02", tmp_path / "own/nonce.json")
    secret, before = read_secret(private, results, "tiny"), history(results)
    with pytest.raises(RacinesError, match="committed to on 2026-10-02: set the clock right"):
        reveal(results, secret, "2026-10-01")
    assert history(results) == before
    reveal(results, secret, "2026-10-02")
