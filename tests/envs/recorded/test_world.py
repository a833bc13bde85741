"""What recordings alone answer: images, labels, distances, phases, starts and refusals."""

import json
import math

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, axis_angle_to_matrix, matmul3, parameters_to_pose
from racines_data.schema import SPLITS
from racines_envs.agents.planner import PlannerAgent
from racines_envs.agents.random import RandomAgent
from racines_envs.agents.rollout import rollout
from racines_envs.task.actions import ACTIONS, IDLE
from racines_envs.worlds.making import make_core, phantom_recipe
from racines_envs.worlds.recorded import Recordings, ReplayConfig, open_recordings
from racines_envs.worlds.recorded.opening import of_split
from tests.envs.recorded.held import DOWN, HeldFrames, corner, line

SC, RANDOM = 1, 5


def labelled(count: int = 41, **more) -> HeldFrames:
    """A sweep along x whose last four frames show SC."""
    views = torch.full((count,), RANDOM)
    views[-4:] = SC
    grades = torch.where(views == SC, 8.0, 0.0)
    return HeldFrames(line(count), views=views, grades=grades, **more)


def core_of(world: Recordings, rows: int = 4, **more):
    return make_core(world.aim.view, rows, phantom=world, observation="multimodal", **more)


def pose_at(*positions: tuple[float, float, float]) -> Pose:
    return Pose(torch.tensor(positions), DOWN.expand(len(positions), 3, 3))


def test_a_recorded_pose_shows_its_own_frame_and_label():
    store = labelled()
    world = open_recordings(store, "SC")
    pose = parameters_to_pose(store.parameters)
    index, away = world.nearest(pose)
    assert torch.equal(index, torch.arange(41)) and away.max() < 1e-6
    assert torch.equal(world.render(pose, index), store.images)
    truth = world.judge(pose)
    assert torch.equal(truth.view, store.views) and torch.equal(truth.grade, store.grades)
    between = pose_at((0.0209, 0.001, 0.0), (0.0211, 0.0, 0.001))
    assert world.nearest(between)[0].tolist() == [10, 11]
    assert world.told(between)["frame"].tolist() == [10, 11]
    # Of equal grades, one of the two most central.
    assert world.aim in [("SC", SC, frame, "label") for frame in (38, 39)]
    assert torch.equal(world.judge(pose_at((0.09, 0.0, 0.0))).view, torch.tensor([RANDOM]))


@pytest.mark.parametrize("beyond", ["refuse", "mask"])
def test_a_step_beyond_is_refused_and_the_mask_tells_it_beforehand(beyond):
    world = open_recordings(labelled(), "SC", ReplayConfig(beyond=beyond))
    assert world.reach == pytest.approx(0.07 * 2 * math.sin(0.03) + 0.001, abs=1e-6)
    core = core_of(world, len(ACTIONS))
    seen = core.reset(seed=3)
    assert ("action_mask" in seen) == (beyond == "mask")
    refused = 0
    for step in range(12):
        before, hits = core.state.pose, core.state.workspace_hits.clone()
        expected = core.options()[1]
        if beyond == "mask":
            assert torch.equal(core.observe()["action_mask"], expected)
        action = (torch.arange(len(ACTIONS)) + 2 * (step % 3)) % len(ACTIONS)
        live = ~core.state.done
        core.step(action)
        stays = ~expected[torch.arange(len(ACTIONS)), action] & live
        assert torch.equal(core.state.workspace_hits > hits, stays)
        assert torch.equal(core.state.position[stays], before.position[stays])
        assert torch.equal(core.state.rotation[stays], before.rotation[stays])
        key_distance = world.nearest(core.state.pose)[1]
        assert key_distance.max() <= world.reach
        refused += int(stays.sum())
    assert refused > 10
    assert bool(core.options()[1][:, IDLE].all())  # to stay is never refused


def test_a_masked_random_agent_is_never_refused_and_uses_all_that_is_left():
    world = open_recordings(labelled(), "SC", ReplayConfig(beyond="mask", max_steps=40))
    core = core_of(world, 30)
    episodes = rollout(core, RandomAgent(), torch.arange(30))
    assert episodes.final["workspace_hits"].max() == 0
    assert len(torch.stack(episodes.actions).unique()) == len(ACTIONS)
    allowed = torch.zeros(1, 13, dtype=torch.bool)
    allowed[0, 4] = allowed[0, 9] = True
    drawn = RandomAgent().act({"action_mask": allowed.expand(500, -1)}, torch.arange(500))
    assert drawn.unique().tolist() == [4, 9] and 200 < int((drawn == 4).sum()) < 300


def test_success_by_label_ends_with_three_hits():
    core = core_of(open_recordings(labelled(), "SC"))
    episodes = rollout(core, PlannerAgent(), torch.arange(4))
    assert episodes.final["success"].all() and episodes.final["success_graded"].all()
    assert (episodes.final["view"] == SC).all() and (episodes.final["steps"] < 200).all()


def test_by_pose_a_hit_is_within_both_bounds_and_the_grade_falls_evenly():
    config = ReplayConfig(goal="sweep-0:20", within=4.0, within_degrees=6.0)
    world = open_recordings(HeldFrames(line()), config=config)
    assert world.views == ("Goal",) and world.aim.by == "pose"
    goal = world.target("Goal")
    for millimetres, degrees, shown, grade in (
        (0, 0, True, 10.0), (3.9, 0, True, 5.125), (4.1, 0, False, 0), (0, 5.9, True, 5.083),
        (0, 6.1, False, 0), (2, 3, True, 7.5), (2, 7, False, 0),
    ):  # fmt: skip
        turn = axis_angle_to_matrix(torch.tensor([[0.0, math.radians(degrees), 0.0]]))
        pose = Pose(goal.position + 1e-3 * torch.tensor([millimetres, 0, 0]),
                    matmul3(goal.rotation, turn))  # fmt: skip
        truth = world.judge(pose)
        assert (truth.view.item() == 0) == shown, (millimetres, degrees)
        assert truth.grade.item() == pytest.approx(grade, abs=2e-2)
        assert truth.membership.item() == float(shown)
        near = world.own_nearest(pose, 0, (0.003, 0.06))
        inside = world._off(near)
        assert max(inside).item() <= 1.0 + 1e-3
        if shown:
            assert torch.allclose(near.position, pose.position, atol=1e-7)
    core = core_of(world)
    episodes = rollout(core, PlannerAgent(), torch.arange(4))
    assert episodes.final["success"].all() and (episodes.final["position_error"] <= 4e-3).all()


def test_views_may_be_judged_by_pose_and_goals_by_their_label():
    by_pose = open_recordings(labelled(), "SC", ReplayConfig(judged_by="pose"))
    assert by_pose.views == ("SC",) and by_pose.task().view == "SC"
    by_label = open_recordings(labelled(), "", ReplayConfig(goal="sweep-0:40", judged_by="label"))
    assert by_label.aim == ("SC", SC, 40, "label")
    with pytest.raises(RacinesError, match="bears no view: leave replay.judged_by out"):
        open_recordings(labelled(), "", ReplayConfig(goal="sweep-0:3", judged_by="label"))
    with pytest.raises(RacinesError, match="goal sweep-0:3: the frame bears no view, not SC"):
        open_recordings(labelled(), "SC", ReplayConfig(goal="sweep-0:3"))


def test_where_no_grades_are_given_the_label_alone_decides():
    store = labelled()
    store.grades = torch.full_like(store.grades, torch.nan)
    world = open_recordings(store, "SC")
    assert not world.frames.graded
    assert world.judge(world.target("SC")).grade.item() == 10.0
    assert rollout(core_of(world), PlannerAgent(), torch.arange(4)).final["success_graded"].all()


def test_labels_that_are_not_known_show_nothing():
    store = labelled()
    store.views[:30] = -1
    world = open_recordings(store, "SC")
    assert (world.frames.views[:30] == RANDOM).all()


def beating(beat: float = 1.0) -> Recordings:
    """Eleven poses, at four phases each."""
    position = line(11).repeat_interleave(4, 0)
    phases = torch.stack([torch.arange(44) % 4 / 4, torch.full((44,), torch.nan)], 1).double()
    trajectory = torch.arange(44) // 4
    store = HeldFrames(position, phases=phases, trajectory=trajectory)
    return open_recordings(store, "", ReplayConfig(goal="sweep-8:32", beat_seconds=beat))


def test_the_frame_is_the_nearest_in_phase_as_well():
    world = beating()
    pose = pose_at(*[(0.0041, 0.0, 0.0)] * 6)
    case, time = torch.zeros(6, dtype=torch.int64), torch.tensor([0.0, 0.3, 0.45, 0.8, 0.95, 7.2])
    scene = world.scene(case, time.double())
    assert (scene.nearest(pose)[0] % 4).tolist() == [0, 1, 2, 3, 0, 1]
    assert (scene.nearest(pose)[0] // 4).tolist() == [2] * 6
    assert torch.allclose(scene.nearest(pose)[1], torch.tensor(0.0001), atol=1e-6)
    some = scene.at(torch.tensor([3, 1]))
    assert (some.nearest(Pose(*(x[:2] for x in pose)))[0] % 4).tolist() == [3, 1]
    still = beating(0.0).scene(case, time.double())
    assert (still.nearest(pose)[0] % 4).tolist() == [0] * 6


def test_a_heart_beats_while_the_probe_rests():
    core = core_of(beating(), 2)
    core.reset(seed=0)
    seen = []
    for _ in range(10):
        seen.append(core.step(torch.full((2,), IDLE)).observation["image"][:, 0, 0] % 4)
    phases = torch.stack(seen)
    assert phases.unique().tolist() == [0, 1, 2, 3]
    assert core.phantom.recipe["phases"] is True


def test_starts_are_frames_of_the_split_that_do_not_show_the_goal_and_are_joined_to_it():
    store = labelled(splits=(20, 30))
    for split, low, high in zip(SPLITS, (0, 20, 30), (19, 29, 36), strict=True):
        world = open_recordings(store, "SC", ReplayConfig(split=split))
        assert world.start_frames.tolist() == list(range(low, high + 1))
        drawn = world.drawn_starts(torch.arange(400))
        assert torch.equal(drawn.unique(), world.start_frames)
        assert torch.equal(drawn[7:8], world.drawn_starts(torch.tensor([7])))
        core = core_of(world, 50)
        core.reset(seed=0)
        assert torch.equal(world.nearest(core.state.pose)[1].max(), torch.tensor(0.0))
        assert not bool(core.info()["success"].any())
    assert of_split(world, "validation").start_frames.tolist() == list(range(20, 30))
    assert of_split(world, "validation").aim.frame == world.aim.frame
    own = open_recordings(store, "SC", ReplayConfig(split="test", frames="split"))
    assert len(own.frames) == 11 and own.frames.rows[0] == 30
    near = open_recordings(store, "SC", ReplayConfig(start=(50.0, 60.0)))
    away = (near.frames.pose.position[near.start_frames] - near.target("SC").position).norm(dim=-1)
    assert away.min() > 0.0499 and away.max() < 0.0601 and len(away) in (5, 6)


def test_frames_that_no_way_joins_to_the_goal_are_no_starts_and_are_counted():
    far = torch.cat([line(10) + 0.3, line(41)])
    views = torch.full((51,), RANDOM)
    views[-3:] = SC
    world = open_recordings(HeldFrames(far, views=views), "SC")
    assert world.start_frames.min() == 10
    assert world.recipe["starts_cut_off"] == 10 and world.recipe["starts"] == 38


def test_the_planner_goes_round_corners_along_recorded_poses():
    store = HeldFrames(corner(20), splits=(5, 5))
    config = ReplayConfig(goal=f"sweep-0:{len(store) - 1}")
    core = core_of(open_recordings(store, "", config), 8)
    episodes = rollout(core, PlannerAgent(), torch.arange(8))
    assert episodes.final["success"].all()
    assert (episodes.final["steps"] > 25).all()  # 106 mm and more in steps of 3, not 38


def test_frames_without_poses_are_left_out_and_counted():
    store = labelled()
    store.parameters[5:9] = torch.nan
    world = open_recordings(store, "SC")
    assert len(world.frames) == 37 and world.frames.left_out == 4
    assert not bool(torch.isin(torch.arange(5, 9), world.frames.rows).any())


def test_a_session_alone_can_be_replayed():
    store = labelled(trajectory=(torch.arange(41) >= 20).long())
    world = open_recordings(store, "SC", ReplayConfig(session="day-1"))
    assert len(world.frames) == 21 and world.frames.rows.min() == 20


def test_pixels_are_the_unit_where_the_scale_is_unknown():
    pixels = open_recordings(
        HeldFrames(line() * 1e3, scale="unknown"), "", ReplayConfig(goal="sweep-0:20")
    )
    metres = open_recordings(HeldFrames(line()), "", ReplayConfig(goal="sweep-0:20"))
    assert (pixels.unit, metres.unit) == ("px", "mm")
    assert torch.allclose(pixels.frames.pose.position, metres.frames.pose.position, atol=1e-7)
    assert pixels.reach == pytest.approx(metres.reach)
    assert pixels.recipe["unit"] == "px" and pixels.recipe != metres.recipe


def test_forces_are_recorded_and_what_was_not_measured_is_none():
    store = labelled()
    store.parameters[:, 2] = -torch.arange(41.0)
    store.parameters[3, :6] = torch.nan
    world = open_recordings(store, "SC")
    wrench = world.wrench(parameters_to_pose(store.parameters))
    assert wrench[:, 2].tolist()[:5] == [0, -1, -2, 0, -4]
    assert world.task().force_limit == 40.0  # where somebody pressed, a probe may press
    with pytest.raises(RacinesError, match="forces='contact' needs a phantom"):
        core_of(world, forces="contact")
    with pytest.raises(RacinesError, match="forces='fitted' are for phantoms"):
        core_of(world, forces="fitted")


def test_a_row_is_as_if_it_were_alone_and_a_seed_walks_the_same():
    world = beating()
    many, one = core_of(world, 6), core_of(world, 1)
    seen, alone = many.reset(seed=0), one.reset(seed=4)
    for step in range(20):
        for name in seen:
            assert torch.equal(seen[name][4], alone[name][0]), (step, name)
        action = (torch.arange(6) * 5 + step) % 12
        seen, alone = many.step(action).observation, one.step(action[4:5]).observation


def test_the_recipe_names_dataset_settings_and_goal_and_differs_by_each():
    world = open_recordings(labelled(), "SC")
    told = json.loads(json.dumps(phantom_recipe(world)))
    assert told["dataset"]["digest"] == "ab" * 32 and told["aim"]["frame"] in (
        "sweep-0:38",
        "sweep-0:39",
    )
    assert told["settings"]["reach"] == pytest.approx(1e3 * world.reach)
    assert json.loads(json.dumps(world.task().definition))["views"] == list(world.views)
    others = [ReplayConfig(turn=50.0), ReplayConfig(goal="sweep-0:40", judged_by="label")]
    digests = {open_recordings(labelled(), "SC", each).recipe["recipe_digest"] for each in others}
    assert len(digests | {told["recipe_digest"]}) == 3


def bare(store: HeldFrames) -> HeldFrames:
    store.parameters = torch.full_like(store.parameters, torch.nan)
    return store


@pytest.mark.parametrize(
    ("make", "view", "config", "match"),
    [
        (lambda: bare(labelled()), "SC", {}, "held: frames without poses .held. cannot be"),
        (lambda: HeldFrames(line()), "", {}, "bear no view, and no goal is given: give"),
        (lambda: HeldFrames(line()), "SC", {}, "bear no view, and no goal"),
        (labelled, "PSAX", {}, "unknown view 'PSAX': choose one of A4C"),
        (labelled, "PL", {}, "none of the frames replayed shows PL: choose one of SC"),
        (lambda: HeldFrames(line(), views=[RANDOM] * 41), "SC", {}, "shows a view: give"),
        (labelled, "", {"goal": "sweep-0:99"}, "no frame 'sweep-0:99' .* as sweep-0:20"),
        (labelled, "", {"goal": "sweep-7:1"}, "no frame 'sweep-7:1'"),
        (labelled, "", {"goal": "nothing"}, "no frame 'nothing'"),
        (lambda: HeldFrames(line(1)), "", {"goal": "sweep-0:0"}, "one frame alone: there is nowh"),
        (labelled, "SC", {"split": "test"}, "split 'test' has no frames with poses to start from"),
        (labelled, "SC", {"split": "all"}, "unknown split 'all': choose one of train"),
        (labelled, "SC", {"session": "night"}, "no session 'night': it has day-0"),
        (labelled, "SC", {"reach": 1.0}, "replay.reach is 1: less than a unit step, .* 4.20 mm"),
        (labelled, "SC", {"start": (500.0, 600.0)}, "every frame shows it, or is not as far"),
        (labelled, "SC", {"beyond": "stop"}, "replay.beyond is 'stop': choose one of refuse"),
        (labelled, "SC", {"judged_by": "me"}, "replay.judged_by is 'me': choose one of label"),
        (labelled, "SC", {"within": 0.0}, "replay.within is 0.0: give more than 0"),
        (labelled, "SC", {"reach": -1.0}, "replay.reach is -1.0: give 0 or more"),
        (labelled, "SC", {"start": (5.0, 1.0)}, "replay.start is .5.0, 1.0.: give the least, then"),
        (
            lambda: HeldFrames(torch.cat([line(5), line(5) + 0.3]), splits=(5, 5)), "",
            {"goal": "sweep-0:7"}, "none of 5 frames is joined to it .* raise replay.reach",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_replayed_is_refused_in_one_line(make, view, config, match):
    with pytest.raises(RacinesError, match=match) as error:
        open_recordings(make(), view, ReplayConfig(**config))
    assert "\n" not in str(error.value)


def test_a_world_is_for_its_own_view_and_starts_lie_within_reach():
    world = open_recordings(labelled(), "SC")
    with pytest.raises(RacinesError, match="looks for SC, not PL"):
        make_core("PL", 1, phantom=world)
    core = core_of(world, 1)
    core.reset(pose=pose_at((0.0105, 0.002, 0.0)))
    with pytest.raises(RacinesError, match="outside the workspace"):
        core.reset(pose=pose_at((0.01, 0.02, 0.0)))
    masked = open_recordings(labelled(), "SC", ReplayConfig(beyond="mask"))
    with pytest.raises(RacinesError, match="mask.* use action='discrete'"):
        core_of(masked, action="velocity")
    twists = core_of(world, 2, action="velocity")
    twists.reset(seed=0)
    twists.step(torch.zeros(2, 6))


def test_the_shaped_reward_pays_for_the_way_along_recorded_poses_not_for_the_straight_one():
    store = HeldFrames(corner(20), splits=(5, 5))
    world = open_recordings(store, "", ReplayConfig(goal=f"sweep-0:{len(store) - 1}"))
    pose = parameters_to_pose(store.parameters)
    left = world.steps_left(pose)
    step = 0.07 * 2 * math.sin(0.03)
    along = 0.002 * torch.arange(len(store) - 1, -1, -1.0) / step
    assert (along - left).min() > -0.1 and (along - left).max() < 3.0  # corners are cut a little
    straight = (pose.position - pose.position[-1]).norm(dim=-1) / step
    assert left[0] > 2 * straight[0]
    core = core_of(world, reward="shaped")
    core.reset(seed=0)
    assert torch.allclose(core.score.distance, world.steps_left(core.state.pose))
