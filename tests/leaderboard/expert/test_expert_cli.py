"""The study by its commands, on the tiny dataset."""

import json

from tests.conftest import command


def test_a_study_from_sample_to_score(workplace):
    command(workplace, "racines", "train", "generator", "mean-image")
    words = ("racines", "expert", "sample", "--truth", "--images", "12", "--repeats", "4")
    given = ("--generator", "mean-image=models/runs/mean-image", "--out", "study/kit")
    done = command(workplace, *words, *given)
    assert "keep study/kit/key.json from them" in done.stdout
    assert len(list((workplace / "study/kit/images").glob("*.png"))) == 16
    key = json.loads((workplace / "study/kit/key.json").read_text())
    assert list(key["systems"]["mean-image"]["weights"]) == ["model.safetensors"]
    assert "is there already" in command(workplace, *words, *given, code=1).stderr
    rate = ("racines", "expert", "rate", "study/kit")
    command(workplace, *rate, "--by", "simulated", "--error-view", "0")
    ratings = "study/kit-ratings/simulated-0.jsonl"
    done = command(workplace, "racines", "expert", "score", "study/kit", ratings, "--json")
    report = json.loads(done.stdout)
    view = report["systems"]["mean-image"]["references"]["oracle"]["metrics"]["view_agreement"]
    assert (view["value"], view["n"]) == (1.0, 6)
    command(workplace, *rate)
    words = ("racines", "expert", "score", "study/kit", "study/kit-ratings/oracle.jsonl")
    assert "--grader" in command(workplace, *words, code=1).stderr
    command(workplace, "racines", "expert", "score", "study/kit", code=2)
