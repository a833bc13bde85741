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
