from racines_leaderboard.board.rank import by_task, rank, rankings
from racines_leaderboard.board.table import board_tables
from racines_leaderboard.records.tracks import AGENTS, GENERATORS
from tests.leaderboard.conftest import agent_scores, generator_scores


def records(*scores: dict) -> list[dict]:
    """Records whose figures are known exactly, but for those that were given an interval."""
    for each in scores:
        for metric in each["metrics"].values():
            if "given" not in metric:
                metric |= {"low": metric["value"], "high": metric["value"]}
    return [{"name": s.get("generator") or s.get("agent"), "scores": s} for s in scores]


def places(track, *scores: dict) -> dict[str, int]:
    return {r.record["name"]: r.place for r in rank(track, records(*scores))}


def test_generators_rank_by_the_mean_of_their_ranks():
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


def interval(scores: dict, key: str, low: float, high: float) -> dict:
    scores["metrics"][key] |= {"low": low, "high": high, "given": True}
    return scores


def test_figures_within_the_interval_of_the_best_share_a_rank():
    apart = [generator_scores("a", ssim=0.90), generator_scores("b", ssim=0.89)]
    assert places(GENERATORS, *apart) == {"a": 1, "b": 2}
    near = [
        interval(generator_scores("a", ssim=0.90), "ssim", 0.88, 0.92),
        interval(generator_scores("b", ssim=0.89), "ssim", 0.87, 0.91),
    ]
    assert places(GENERATORS, *near) == {"a": 1, "b": 1}


def test_a_chain_of_neighbours_is_no_tie():
    steps = [(0.90, 0.87, 0.93), (0.86, 0.83, 0.89), (0.82, 0.79, 0.85), (0.78, 0.75, 0.81)]
    chain = [
        interval(generator_scores(f"s{i}", ssim=value), "ssim", low, high)
        for i, (value, low, high) in enumerate(steps)
    ]
    assert places(GENERATORS, *chain) == {"s0": 1, "s1": 1, "s2": 3, "s3": 3}


def test_a_wide_interval_never_overtakes_a_better_figure():
    best = interval(generator_scores("best", ssim=0.90), "ssim", 0.89, 0.91)
    second = interval(generator_scores("second", ssim=0.85), "ssim", 0.84, 0.86)
    wide = interval(generator_scores("wide", ssim=0.80), "ssim", 0.60, 0.99)
    assert places(GENERATORS, best, second, wide) == {"best": 1, "second": 2, "wide": 2}


def test_a_tie_of_others_neither_helps_nor_hurts():
    # By SSIM: lone, then two alike; by FID: the two, then lone. Three ranks stay with the figures.
    lone = generator_scores("lone", ssim=0.9, fid=90.0)
    alike = [
        interval(generator_scores("a", ssim=0.5, fid=50.0), "ssim", 0.4, 0.6),
        interval(generator_scores("b", ssim=0.5, fid=51.0), "ssim", 0.4, 0.6),
    ]
    apart = [generator_scores("a", ssim=0.51, fid=50.0), generator_scores("b", fid=51.0)]
    assert places(GENERATORS, lone, *apart) == {"a": 1, "lone": 2, "b": 3}
    assert places(GENERATORS, lone, *alike) == {"a": 1, "lone": 2, "b": 3}


def test_agents_tied_in_success_are_told_apart_by_steps():
    quick = interval(agent_scores("quick", success_true=0.95, steps=20.0), "success_true", 0.9, 1)
    sure = interval(agent_scores("sure", success_true=0.97, steps=40.0), "success_true", 0.93, 1)
    poor = interval(agent_scores("poor", success_true=0.5, steps=10.0), "success_true", 0.4, 0.6)
    assert places(AGENTS, quick, sure, poor) == {"quick": 1, "sure": 2, "poor": 3}


def test_a_bound_leads_no_group():
    ceiling = interval(agent_scores("c", success_true=1.0), "success_true", 0.987, 1.0)
    ceiling |= {"sees": "truth"}
    a = interval(agent_scores("a", success_true=0.985, steps=30.0), "success_true", 0.96, 0.995)
    b = interval(agent_scores("b", success_true=0.97, steps=30.0), "success_true", 0.945, 0.985)
    told = [(each.place, each.record["name"]) for each in rank(AGENTS, records(a, b, ceiling))]
    assert told == [(None, "c"), (1, "a"), (1, "b")]


def test_a_shared_place_is_marked_in_the_table():
    scores = [generator_scores(name) for name in ("a", "b")] + [generator_scores("c", fid=900.0)]
    told = [record | {"tier": "self-reported", "submission": None} for record in records(*scores)]
    table = board_tables("b", {"generators": told, "agents": []})[0]
    assert [row[:2] for row in table.rows] == [("1=", "a"), ("1=", "b"), ("3", "c")]
