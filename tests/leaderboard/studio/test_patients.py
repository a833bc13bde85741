"""Patients in the Studio: their sheet, an episode in one, states handed on as links."""

import io
import json
from dataclasses import replace
from types import SimpleNamespace
from urllib.parse import parse_qsl

import numpy as np
import pytest
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_envs.agents.servo.agent import ServoAgent
from racines_envs.agents.servo.learner import ServoConfig
from racines_envs.evaluation.patients import StartSet
from racines_envs.explain.maps import integrated_gradients, view_scores
from racines_envs.task.actions import IDLE
from racines_envs.task.tasks import TASKS
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import make_ward
from racines_leaderboard.studio import driving, links, patients, watching, worlds
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.worlds import FIXED, SEEDED
from racines_models.networks.servo import ServoNetwork

PATIENT = 10_000
PLACE = Place(data=None)


def query(html: str) -> SimpleNamespace:
    """What a browser asks for that follows the link of a page."""
    address = html.split('href="?')[1].split('"')[0].replace("&amp;", "&")
    return SimpleNamespace(query_params=dict(parse_qsl(address)))


def test_a_sheet_has_five_views_that_beat_and_what_is_true():
    sheet = patients.sheet(PLACE, PATIENT)
    assert sheet is patients.sheet(PLACE, PATIENT) and sheet.split == "validation"
    assert [name for name, _ in sheet.films] == ["A4C", "SC", "PL", "PSAV", "PSMV"]
    film = Image.open(io.BytesIO(sheet.films[0][1]))
    assert film.n_frames == patients.FRAMES and film.size == (256, 256)
    frames = []
    for number in (0, patients.FRAMES // 2):
        film.seek(number)
        frames.append(np.asarray(film.convert("L")).astype(int))
    assert np.abs(frames[0] - frames[1]).mean() > 1, "it moves"
    measures = make_ward("beating", "validation", (PATIENT,)).pool.measures(0)
    facts = dict(sheet.facts)
    assert facts["Ejection fraction"] == f"{100 * measures.ejection_fraction:.0f} %"
    page = patients.html(sheet)
    assert page.count("data:image/webp") == 5 and "apical four-chamber" in page


def test_the_next_patient_is_of_the_same_split():
    assert patients.beside(10_999, 1) == 10_000 and patients.beside(10_000, -1) == 10_999
    assert patients.beside(20_000, 1) == 20_001 and patients.beside(1, -1) == 9_999
    for value in (0, 15_000, 30_000, 1.5, None, "1", float("nan")):
        with pytest.raises(RacinesError):
            patients.beside(value, 1)


@pytest.mark.parametrize("kind", [FIXED, SEEDED])
def test_an_episode_in_a_patient_is_the_evaluations(kind):
    session, lives = driving.begin("A4C-beating", kind, 2, patient=PATIENT), driving.Lives(PLACE)
    ward = make_ward("beating", "validation", (PATIENT,))
    core = make_core("A4C-beating", phantom=ward, observation="image", reward="oracle")
    seeds = StartSet((PATIENT,), 3, 0).seeds[-1:] if kind == FIXED else 2
    core.reset(seeds, case=ward.case_of([PATIENT]))
    for action in (0, 4, IDLE, IDLE, IDLE):
        core.step(torch.tensor([action]))
        session, scene = lives.step(session, action, True)
    np.testing.assert_array_equal(scene.image, core.picture()[0].numpy())
    assert scene.ended.startswith("declared by 3 steps of staying, and ")
    assert len(lives) == 1


def test_a_state_comes_back_by_its_link():
    gradio = pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
    from racines_leaderboard.studio.tabs import probe

    lives, session = driving.Lives(PLACE), driving.begin("PL-beating", SEEDED, 7, patient=PATIENT)
    for action in (1, 12, 3):
        session, _ = lives.step(session, action, True)
    image, side = probe._panels(session, lives.look(session, True))
    fields = links.told(query(image), "probe")
    assert links.told(query(image), "agent") is None and fields is not None
    *chosen, again, second, other = probe._linked(driving.Lives(PLACE), fields)
    assert chosen == ["PL-beating", SEEDED, 7, "free", PATIENT, True]
    assert (second, other) == (image, side)
    assert replace(again, token="") == replace(session, token="")
    assert isinstance(probe._patient("SC"), gradio.Number)


@pytest.mark.parametrize(
    "fields",
    [
        {"task": "<script>"},
        {"task": "SC", "number": "-1"},
        {"task": "SC", "number": "²"},
        {"task": "SC", "actions": "0z"},
        {"task": "A4C-beating", "patient": "15000"},
        {"task": "SC", "robot": "kuka"},
        {},
    ],
)
def test_an_address_that_somebody_made_up_is_refused(fields):
    pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
    from racines_leaderboard.studio.tabs import probe

    with pytest.raises(RacinesError):
        probe._linked(driving.Lives(PLACE), fields)
    with pytest.raises(RacinesError, match="200 characters"):
        links.told(SimpleNamespace(query_params={"tab": "probe", "actions": "0" * 201}), "probe")


def test_a_link_is_text():
    shown = links.link("agent", agent='"><script>alert(1)</script>&x=1')
    assert "<script" not in shown and shown.count('"') == 4
    fields = links.told(query(shown), "agent")
    assert fields == {"agent": '"><script>alert(1)</script>&x=1'}


def test_the_servo_says_what_speaks_for_the_view():
    torch.manual_seed(0)
    agent = ServoAgent(ServoConfig(), ServoNetwork(5))
    images = torch.randint(0, 255, (2, 128, 128), dtype=torch.uint8)
    maps, error = integrated_gradients(
        view_scores(agent), images, torch.zeros(2, 9), torch.tensor([0, 3])
    )
    known = agent.view_scores(images.float())[[0, 1], [0, 3]]
    black = agent.view_scores(torch.zeros(2, 128, 128))[[0, 1], [0, 3]]
    torch.testing.assert_close(maps.sum((1, 2)), known - black + error, atol=1e-3, rtol=0.0)
    assert maps.abs().max() > 0
    with pytest.raises(RacinesError, match="reads no views"):
        view_scores(SimpleNamespace(name="ppo"))


def test_who_can_be_watched_where():
    offered = watching.agents(Place(data=None))
    servo = watching.tasks_of(Place(data=None), "servo (published)")
    assert "A4C-beating" in servo and "SC-patients" in servo and "SC" not in servo
    assert set(watching.tasks_of(Place(data=None), "planner")) == set(worlds.tasks())
    assert watching.tasks_of(Place(data=None), "ppo-image (published)") == ["SC"]
    assert watching.tasks_of(Place(data=None), "hill-climber") == [*TASKS]
    belief = watching.tasks_of(Place(data=None), "ppo-belief (published)")
    assert belief == watching.tasks_of(Place(data=None), "servo-memory-plus (published)") == servo
    assert all(watching.tasks_of(Place(data=None), label) for label in offered)


def test_who_was_trained_on_patients_is_watched_there(tmp_path):
    for name, view in (("mine", "A4C-beating"), ("any", "AnyView-beating"), ("other", "kidney")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.safetensors").touch()
        told = {"agent": "ppo", "config": {"view": view}}
        (tmp_path / name / "config.json").write_text(json.dumps(told))
    place = Place(data=None, agents=tmp_path)
    assert watching.tasks_of(place, "mine") == ["A4C-beating"]
    # One that has to be told the goal, and one of an organ that is not here, fit nothing offered.
    assert not {"any", "other"} & set(watching.agents(place))


def test_a_policy_on_a_belief_finds_its_way_in_a_patient():
    episode = watching.watch(PLACE, "ppo-belief (published)", "A4C-patients", 0, patient=PATIENT)
    assert episode.steps > 3 and watching.moment(episode, episode.steps).truth
    assert watching.ACTION not in episode.explainable


def test_a_planner_finds_a_view_of_a_patient():
    episode = watching.watch(PLACE, "planner", "A4C-patients", 0, patient=PATIENT)
    last = watching.moment(episode, episode.steps)
    assert last.success and last.ended.startswith("declared") and last.truth
    assert all(0 < len(curve.grades) == episode.steps + 1 for curve in episode.curves)
