from racines_leaderboard.groups import by_task, rankings
from racines_leaderboard.rank import rank
from racines_leaderboard.tracks import AGENTS, GENERATORS
from tests.leaderboard.conftest import agent_scores, generator_scores


def records(*scores: dict) -> list[dict]:
    return [{"name": s.get("generator") or s.get("agent"), "scores": s} for s in scores]


def places(track, *scores: dict) -> dict[str, int]:
    return {r.record["name"]: r.place for r in rank(track, records(*scores))}


def test_generators_rank_by_the_mean_of_four_ranks():
    sharp = generator_scores("sharp", ssim=0.4, psnr=18.0, fid=10.0, kid=0.01)
    blurred = generator_scores("blurred", ssim=0.5, psnr=19.0, fid=300.0, kid=0.5)
    good = generator_scores("good", ssim=0.5, psnr=19.5, fid=20.0, kid=0.02)
    assert places(GENERATORS, sharp, blurred, good) == {"good": 1, "sharp": 2, "blurred": 3}


def test_leaving_a_figure_out_does_not_help():
    whole = generator_scores("whole", fid=400.0)
    partial = generator_scores("partial", fid=None)
    assert places(GENERATORS, whole, partial) == {"whole": 1, "partial": 2}


def test_equal_systems_share_a_place():
    scores = [generator_scores(name) for name in ("b", "a")] + [generator_scores("c", fid=900.0)]
    assert list(places(GENERATORS, *scores).items()) == [("a", 1), ("b", 1), ("c", 3)]


def test_agents_rank_by_success_then_steps_then_grade_and_never_by_return():
    ranked = places(
        AGENTS,
        agent_scores("rich", success_true=0.2, **{"return": 4000.0}),
        agent_scores("slow", success_true=0.9, steps=80.0),
        agent_scores("quick", success_true=0.9, steps=20.0, final_grade=6.0),
        agent_scores("clear", success_true=0.9, steps=20.0, final_grade=8.0),
    )
    assert ranked == {"clear": 1, "quick": 2, "slow": 3, "rich": 4}


def test_agents_of_different_tasks_are_never_ranked_against_each_other():
    told = records(
        agent_scores("looks", success_true=0.6),
        agent_scores("looks-too", success_true=0.7),
        agent_scores("knows-its-pose", observation="params", success_true=0.9),
        agent_scores("elsewhere", view="PL", success_true=0.95),
    )
    assert {title: [r["name"] for r in group] for title, group in by_task(told).items()} == {
        "PL from the image, phantom backend": ["elsewhere"],
        "SC from the image, phantom backend": ["looks", "looks-too"],
        "SC from the pose, phantom backend": ["knows-its-pose"],
    }
    places = [(each.place, each.record["name"]) for each in rankings(AGENTS, told)]
    assert places == [(1, "elsewhere"), (1, "looks-too"), (2, "looks"), (1, "knows-its-pose")]


def test_bounds_stand_in_every_table_of_their_view_and_take_no_place():
    told = records(
        agent_scores("looks", success_true=0.6),
        agent_scores("knows-its-pose", observation="params", success_true=0.9),
        agent_scores("ceiling", observation="params") | {"sees": "truth"},
        agent_scores("floor", observation="params", success_true=0.0) | {"sees": "nothing"},
        agent_scores("floor-pl", view="PL", success_true=0.0) | {"sees": "nothing"},
    )
    tables = [
        [(each.place, each.record["name"]) for each in rank(AGENTS, group)]
        for group in by_task(told).values()
    ]
    assert tables == [
        [(None, "floor-pl")],
        [(1, "looks"), (None, "ceiling"), (None, "floor")],
        [(1, "knows-its-pose"), (None, "ceiling"), (None, "floor")],
    ]
    assert len(rankings(AGENTS, told)) == 5, "each once where all stand together"
