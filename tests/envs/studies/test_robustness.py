"""Robustness: what disturbances do and leave alone, pairing, going on after a kill, refusals."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic
from racines_data.patients.bake import recipe
from racines_data.patients.population import draw_patient
from racines_data.randomness import derive
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.rollout import rollout
from racines_envs.evaluation.patients import PatientsConfig, evaluate_patients
from racines_envs.studies.robustness import run as module
from racines_envs.studies.robustness.core import DisturbedCore
from racines_envs.studies.robustness.disturbances import DISTURBANCES, disturbed
from racines_envs.studies.robustness.figures import draw_robustness
from racines_envs.studies.robustness.run import RobustnessConfig, conditions, evaluate_robustness
from racines_envs.studies.robustness.summary import found_disturbed
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import make_ward
from racines_leaderboard.cli.command import app

SEEDS = derive(torch.zeros(400, dtype=torch.int64), torch.arange(400))
QUICK = RobustnessConfig(patients=2, disturbances=("pose bias", "slip"))


def test_patients_are_examined_otherwise_and_their_hearts_stay():
    for name, each in DISTURBANCES.items():
        assert list(each.amounts) == sorted(each.amounts), name
        if each.patient is None:
            continue
        for seed in (10_000, 10_001):
            patient = draw_patient(seed)
            others = [disturbed(patient, {each: amount}) for amount in each.amounts]
            assert len({*map(repr, others), repr(patient)}) == 4, name
            assert {recipe(other) for other in others} == {recipe(patient)}, name
            for other in others:
                assert other.form == patient.form and other.seed == patient.seed
    haze = DISTURBANCES["haze"]
    before, after = draw_patient(10_000), disturbed(draw_patient(10_000), {haze: 8.0})
    assert after.examination.haze == before.examination.haze + 8.0
    told = {name: DISTURBANCES[name] for name in ("gain", "gray map")}
    for name, each in told.items():
        key = name.replace(" ", "_")
        up = [
            getattr(disturbed(draw_patient(seed), {each: each.amounts[0]}).examination, key)
            > getattr(draw_patient(seed).examination, key)
            for seed in range(1, 21)
        ]
        assert 4 < sum(up) < 16, "some one way, some the other"


def test_a_band_of_beams_goes_dark():
    white = torch.full((400, 128, 128), 200, dtype=torch.uint8)
    each = DISTURBANCES["coupling loss"]
    inside = torch.zeros(128, 128, dtype=torch.bool)
    down, across = torch.meshgrid(torch.arange(128), torch.arange(128), indexing="ij")
    inside[(across - 63.5).abs() < 0.7 * down] = True
    lost = []
    for amount in each.amounts:
        images = each.image(white, SEEDS, amount)
        assert torch.equal(images[7:8], each.image(white[7:8], SEEDS[7:8], amount)), "a row's own"
        lost.append(float((images[:, inside] < 100).float().mean()))
    assert lost == sorted(lost) and 0.05 < lost[0] < 0.12 and 0.2 < lost[2] < 0.4
    assert len({int(x) for x in images.float().mean((1, 2))}) > 10, "another band each episode"


def test_poses_are_misread_by_so_much_one_way_all_along():
    pose = Pose(torch.rand(400, 3), torch.eye(3).expand(400, 3, 3))
    each = DISTURBANCES["pose bias"]
    for amount in each.amounts:
        read = each.told(pose, SEEDS, amount)
        assert torch.allclose(
            (read.position - pose.position).norm(dim=1), torch.tensor(amount * 1e-3), atol=1e-6
        )
        turned = torch.rad2deg(geodesic(read.rotation, pose.rotation))
        assert torch.allclose(turned, torch.tensor(amount / 2), atol=0.01)
        again = each.told(Pose(pose.position + 1.0, pose.rotation), SEEDS, amount)
        assert torch.allclose(again.position - read.position, torch.ones(3), atol=1e-5)


def test_steps_go_astray_and_probes_slip_but_nobody_who_rests_is_moved():
    asked = torch.arange(400) % len(ACTIONS)
    rests, seeds = asked == IDLE, derive(SEEDS, 5)
    each = DISTURBANCES["action noise"]
    for amount in each.amounts:
        done = each.action(asked, seeds, amount)
        assert torch.equal(done[rests], asked[rests])
        share = float((done != asked)[~rests].float().mean())
        assert 0.5 * amount < share < 1.4 * amount
    pose = Pose(torch.zeros(400, 3), torch.eye(3).expand(400, 3, 3))
    slip = DISTURBANCES["slip"]
    many = [slip.slip(pose, asked, derive(SEEDS, step), 6.0).position for step in range(20)]
    moved = torch.stack(many).norm(dim=-1)
    assert float(moved[:, rests].max()) == 0.0
    assert set((moved * 1e4).round().unique().tolist()) == {0.0, 60.0}
    assert 0.01 < float((moved[:, ~rests] > 0).float().mean()) < 0.03
    assert float(torch.stack(many)[..., 2].abs().max()) == 0.0, "along the skin"


def test_the_truth_stays_where_the_probe_is():
    ward = make_ward("patients", "validation", 2)
    usual = make_core("A4C-patients", 4, observation="params", reward="oracle", phantom=ward)
    bias = DISTURBANCES["pose bias"]
    biased = DisturbedCore(usual, {bias: 10.0})
    seeds = SEEDS[:4]
    seen, told = usual.reset(seeds), biased.reset(seeds)
    assert torch.equal(usual.state.position, biased.state.position)
    assert torch.equal(usual.score.grade, biased.score.grade)
    assert float((seen["params"] - told["params"]).abs().max()) > 0.05
    same = DisturbedCore(usual, {})
    one, other = (rollout(core, PlannerAgent(), seeds) for core in (usual, same))
    assert all((one.final[key] == other.final[key]).all() for key in one.final)


def test_rows_are_disturbed_by_their_own_seeds():
    ward = make_ward("patients", "validation", 2)
    applied = {each: each.amounts[2] for each in map(DISTURBANCES.get, ("slip", "action noise"))}
    made = {}
    for count in (4, 1):
        core = make_core("A4C-patients", count, observation="params", phantom=ward)
        core = DisturbedCore(core, applied)
        core.reset(SEEDS[:count])
        for action in (1, 4, 6, 8, 11, 3) * 5:
            core.step(torch.full((count,), action))
        made[count] = core.state.position[0]
    assert torch.equal(made[4], made[1])


def test_a_study_is_paired_goes_on_and_begins_with_nothing_wrong(tmp_path, monkeypatch):
    seen: list[str] = []
    whole = evaluate_robustness("planner", tmp_path, QUICK, tmp_path / "a.json", None, seen.append)
    assert seen == [each.title for each in conditions(QUICK)] and len(seen) == 1 + 3 * 3
    plain = PatientsConfig(patients=2, starts=1)
    metrics = evaluate_patients("planner", tmp_path, plain).scores["metrics"]
    nothing = whole["conditions"]["nothing"]["metrics"]
    assert nothing["position_error_median"] == metrics["position_error_median"]
    for title, told in whole["conditions"].items():
        if title != "nothing":
            share = told["metrics"]["success_declared"]["value"]
            apart = share - nothing["success_declared"]["value"]
            assert math.isclose(told["change"]["value"], apart, abs_tol=1e-9)
    png = draw_robustness(whole)
    assert png[:4] == b"\x89PNG" and len(png) > 5000

    def killed(condition, *rest):
        if len(json.loads((tmp_path / "b.json").read_text())["conditions"]) == 3:
            raise KeyboardInterrupt
        return under(condition, *rest)

    under = module._under
    (tmp_path / "b.json").write_text(json.dumps(whole | {"conditions": {}}))
    monkeypatch.setattr(module, "_under", killed)
    with pytest.raises(KeyboardInterrupt):
        evaluate_robustness("planner", tmp_path, QUICK, tmp_path / "b.json")
    monkeypatch.undo()
    later: list[str] = []
    again = evaluate_robustness("planner", tmp_path, QUICK, tmp_path / "b.json", None, later.append)
    assert later == ["nothing", *seen[3:]], "what nothing costs is asked again, to compare with"
    assert again["conditions"] == whole["conditions"]


def test_what_a_disturbance_costs_is_told_as_a_loss(tmp_path, monkeypatch):
    under = module._under

    def worse(condition, *rest):
        values = under(condition, *rest)
        lost = {"": 1.0, "mild": 1.0, "moderate": 0.5, "strong": 0.0}[condition.strength]
        return values | {"success_declared": values["success_declared"] * lost}

    monkeypatch.setattr(module, "_under", worse)
    told = evaluate_robustness("planner", tmp_path, QUICK, tmp_path / "e.json")["conditions"]
    assert [told[f"slip, {each}"]["change"]["value"] for each in module.STRENGTHS] == [0, -0.5, -1]
    assert [name for name, _ in module.changes({"conditions": told})][0] in (
        "slip",
        "pose bias",
        "all",
    )


def test_the_figure_of_a_study_is_the_mean_of_single_disturbances_at_the_middle_strength(tmp_path):
    config = replace(QUICK, starts=2)
    document = evaluate_robustness("planner", tmp_path, config, tmp_path / "f.json")
    assert document["patients"] == [10_000, 10_000, 10_001, 10_001]
    for row in document["conditions"].values():
        assert np.shape(row["found"]) == (1, 4)
        assert math.isclose(np.mean(row["found"]), row["metrics"]["success_declared"]["value"])
    # Others than those of the middle strength, and all at once, have no say in it.
    for title, row in document["conditions"].items():
        row["found"] = [[1, 1, 1, 1]]
        if title == "pose bias, moderate":
            row["found"] = [[0, 0, 1, 0]]
        elif title == "slip, moderate":
            row["found"] = [[1, 0, 1, 0]]
        elif row["name"] == "all":
            row["found"] = [[0, 0, 0, 0]]
    metric = found_disturbed(document)
    assert metric["value"] == pytest.approx((0.25 + 0.5) / 2) and metric["n"] == 4
    assert metric["settings"]["units"] == 2 and metric["settings"]["trainings"] == 1


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(RacinesError, match="no 'fog'; choose of haze, cover"):
        conditions(replace(QUICK, disturbances=("fog",)))
    with pytest.raises(RacinesError, match="motion means nothing on tier patients"):
        conditions(replace(QUICK, disturbances=("motion",)))
    assert len(conditions(RobustnessConfig(view="A4C-beating"))) == 1 + 3 * len(DISTURBANCES) + 3
    with pytest.raises(RacinesError, match="task racines/A4C-v0 has one heart"):
        conditions(replace(QUICK, view="A4C"))
    (tmp_path / "c.json").write_text(json.dumps({"study": "another"}))
    with pytest.raises(RacinesError, match=r"c\.json: holds another study: give another --out"):
        evaluate_robustness("planner", tmp_path, QUICK, tmp_path / "c.json")
    with pytest.raises(RacinesError, match="nobody"):
        evaluate_robustness("nobody", tmp_path, QUICK, tmp_path / "c.json", force=True)
    assert "another" in (tmp_path / "c.json").read_text(), "it stays until there is something new"
    (tmp_path / "d.json").write_text("{")
    words = ["eval", "robustness", "planner", "--patients", "2", "--set", "disturbances=[slip]"]
    with pytest.raises(RacinesError, match=r"d\.json: not readable as JSON"):
        CliRunner().invoke(app, [*words, "--out", str(tmp_path / "d.json")], catch_exceptions=False)
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "d.json"), "--force"])
    assert done.exit_code == 0 and "slip, strong" in done.stdout
    assert (tmp_path / "d.png").is_file()
