"""The batched core of every environment: N probes, pure tensors on one device.

They scan one phantom, or a case of a world each: `World.scene` is what the rows are in now.

One step, for all rows at once and without waiting for the device (a reset waits once, to look at
the rows that ended and at no others):

    action -> candidate pose -> limits -> pose, wrench -> scene -> truth (and image, and grader)
           -> score (p, g) -> reward, hit, streak, idle -> terminated, truncated

A row's result depends on its own seed and actions alone, never on the rows beside it. A row that
has ended stays as it is until it is reset (`reset`, or `step` with `autoreset`).
"""

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, geodesic, pose_to_parameters
from racines_data.imaging import ImageSource
from racines_data.randomness import derive, uniform
from racines_data.world import World
from racines_envs.robots.arm import FREE, Arm
from racines_envs.robots.following import make_robot
from racines_envs.task import sensing
from racines_envs.task.actions import ACTIONS
from racines_envs.task.motion import DISCRETE, make_motion
from racines_envs.task.names import HEART_TIER
from racines_envs.task.rewards import Reward, RewardConfig, Score, get_reward, is_hit
from racines_envs.task.starts import check_starts, draw_starts, nearest_showing
from racines_envs.task.state import State, Transition
from racines_envs.task.tasks import DECLARED, Task
from racines_envs.task.tiers import LONGEST, STEP_SECONDS, middles
from racines_envs.task.told import told_of
from racines_models.networks.batching import in_fixed_batches
from racines_models.protocol import Judge

OBSERVATIONS = ("image", "params", "multimodal")
PARAMS_SIZE = 9
"""Position in the workspace's box (3), then the continuous rotation (6)."""
_BEGAN, _GOAL = 61, 62  # random streams of an episode


class ScanCore:
    """N environments of one task."""

    def __init__(
        self, task: Task, phantom: World, images: ImageSource, grader: Judge | None = None,
        observation: str = "params", reward: str | Reward = "oracle",
        rewards: RewardConfig | None = None, num_envs: int = 1, device: torch.device | str = "cpu",
        encoder: sensing.Encoder | None = None, forces: sensing.ForceSource | None = None,
        action: str = DISCRETE, robot: str | Arm = FREE,
    ) -> None:  # fmt: skip
        """Join a task, a phantom (truth, limits) and a source of images.

        An `encoder` looks once at each image; its answer is observed as `features`. Forces are of
        `forces`, else of the source of images if it has a `wrench(pose)`, else the phantom's
        contact's. A reward that needs a grader is refused without one. A `robot` that is an arm
        carries the probes, and refuses steps that its joints cannot follow.
        """
        if observation not in OBSERVATIONS:
            known = ", ".join(OBSERVATIONS)
            raise RacinesError(f"unknown observation {observation!r}: choose one of {known}")
        self.reward = get_reward(reward)
        if self.reward.needs_judge and grader is None:
            raise RacinesError(
                f"reward {self.reward.name!r} needs a trained grader: run `racines train grader`, "
                "or use reward='oracle'"
            )
        if num_envs < 1:
            raise RacinesError(f"num_envs is {num_envs}: give at least 1")
        self.task, self.phantom, self.images, self.grader = task, phantom, images, grader
        self.observation = observation
        self.rewards, self._reward = rewards or RewardConfig(), self.reward.pay
        self.num_envs, self.device = num_envs, torch.device(device)
        self.encoder = encoder if observation != "params" else None
        own = images if isinstance(images, sensing.ForceSource) else phantom
        self.forces: sensing.ForceSource = own if forces is None else forces
        self.masks = isinstance(phantom, sensing.MasksSteps) and phantom.masks
        self.motion = make_motion(action, task, self.device)
        self.table = self.motion.table
        self.robot = make_robot(robot, self.device)
        one_heart = task.tier == HEART_TIER
        self._one = phantom.target(task.view).to(self.device) if one_heart else None
        self._box = tuple(x.to(self.device) for x in sensing.box_of(phantom.workspace))
        self._seed(0)
        self._sensed: dict[str, Tensor] = {}
        self.state: State

    def reset(
        self, seed: int | Tensor | None = None, mask: Tensor | None = None,
        pose: Pose | None = None, case: Tensor | None = None,
    ) -> dict[str, Tensor]:  # fmt: skip
        """Start episodes and return the observations of all rows.

        Row i gets `seed` + i, or its own of (N,) int64; without it each row goes on to the next
        episode of its seed. Only rows of the (N,) bool `mask` are reset; all by default, and at the
        first reset. An episode may start at a given `pose`, in the workspace, not at a drawn one,
        and be of a given `case` of the world, (N,), not of the one that its seed names.
        """
        if seed is not None:
            self._seed(seed, mask)
        if mask is None or not self._sensed:
            self.state = self._begin(torch.arange(self.num_envs, device=self.device), pose, case)
            self._sense()
        else:
            rows = mask.nonzero().squeeze(1)
            self.state = self.state.replaced(rows, self._begin(rows, pose, case))
            self._sense(rows)
        return self.observe()

    def _seed(self, seed: int | Tensor, mask: Tensor | None = None) -> None:
        index = torch.arange(self.num_envs, dtype=torch.int64, device=self.device)
        given = seed.to(self.device, torch.int64) if isinstance(seed, Tensor) else index + seed
        if given.shape != (self.num_envs,):
            raise RacinesError(f"seeds have shape {tuple(given.shape)}: give ({self.num_envs},)")
        new = torch.stack([given, torch.full_like(given, -1)])
        if mask is not None:
            new = torch.where(mask, new, torch.stack([self._env_seed, self._episode]))
        self._env_seed, self._episode = new

    def _begin(self, rows: Tensor, pose: Pose | None = None, case: Tensor | None = None) -> State:
        """Return fresh states of (K,) rows, each at the next episode of its seed."""
        self._episode = self._episode.index_add(0, rows, torch.ones_like(rows))
        seed = derive(self._env_seed[rows], self._episode[rows])
        case = self.phantom.cases(seed) if case is None else case[rows]
        goal = self._goals(seed)
        began = uniform(seed, 1, _BEGAN)[:, 0].double() * LONGEST
        if pose is None:
            about = middles(goal) if self._one is None else self._one
            pose = draw_starts(self.task, self.phantom.scene(case, began), about, seed, goal)
        else:
            given = check_starts(pose, self.num_envs, self.phantom.workspace, self.device)
            pose = Pose(*(x[rows] for x in given))
        wrench = self.wrench(pose)
        none, zero = torch.zeros_like(seed), torch.zeros_like(wrench[:, 0])
        false = torch.zeros_like(seed, dtype=torch.bool)
        return State(
            *pose, wrench, self.robot.begin(pose), seed, case, goal, began, steps=none,
            streak=none, reached=false, idle=none, workspace_hits=none, force_hits=none,
            arm_hits=none, peak_force=-wrench[:, 2], force_sum=zero, total=zero, done=false,
        )  # fmt: skip

    def _goals(self, seed: Tensor) -> Tensor:
        """Return the (K,) labels that episodes of (K,) seeds look for."""
        if not self.task.any_view:
            return torch.full_like(seed, self.task.target)
        return (uniform(seed, 1, _GOAL)[:, 0] * len(self.phantom.views)).long()

    def scene(self, rows: Tensor | None = None) -> World:
        """Return the world that (K,) rows, or all, are in at this step."""
        state = self.state.taken(rows)
        return self.phantom.scene(state.case, state.began + STEP_SECONDS * state.steps)

    def step(
        self, action: Tensor, autoreset: bool = False, rows: Tensor | None = None,
        strict: bool = False,
    ) -> Transition:  # fmt: skip
        """Move every row by one of the 13 actions, (N,) integers, or as its `motion` takes them.

        With `autoreset`, a row that ended in the step before ignores its action and starts its next
        episode instead (Gymnasium's NEXT_STEP): reward 0, neither terminated nor truncated.
        Only the (K,) `rows` move and are looked at, by default all; the others stay as they are.

        Raises:
            RacinesError: no reset before; wrong actions; an image, a judgement or a force that is
                not what it has to be; with `strict` (which waits for the device), a row has ended.
        """
        if not self._sensed:
            raise RacinesError("step before reset: call reset first")
        chosen = torch.ones_like(self.state.done)
        if rows is not None:
            chosen = torch.zeros_like(chosen).index_fill(0, rows, True)
        if strict and bool((self.state.done & chosen).any()):
            row = int((self.state.done & chosen).nonzero()[0])
            raise RacinesError(
                f"the episode of row {row} has ended after {int(self.state.steps[row])} steps: "
                "call reset before the next step"
            )
        state, before = self.state, self.score
        live = chosen & ~state.done
        self.state = self._move(state, self.motion.check(action, self.num_envs), live)
        if autoreset:
            ended = (chosen & state.done).nonzero().squeeze(1)
            if len(ended):
                self.state = self.state.replaced(ended, self._begin(ended))
        return self._look(before, live) if rows is None else self._look(before, live, rows)

    def _look(self, before: Score, live: Tensor, rows: Tensor | None = None) -> Transition:
        """See where the rows are now, all by default, and what that is worth to the live ones."""
        self._sense(rows)
        return self._judge(before, live)

    def _move(self, state: State, action: Tensor, live: Tensor) -> State:
        """Apply actions within the limits to the live rows, and count what was refused."""
        candidate = self.motion.move(state.pose, action)
        wrench = self.wrench(candidate)
        inside, soft = self.limits(candidate, wrench, state.force)
        joints, follows = self.robot.follow(state.joints, candidate)
        free = inside & soft & follows & live
        wrench = torch.where(free[:, None], wrench, state.wrench)
        force = -wrench[:, 2]
        return replace(
            state,
            position=torch.where(free[:, None], candidate.position, state.position),
            rotation=torch.where(free[:, None, None], candidate.rotation, state.rotation),
            wrench=wrench,
            joints=torch.where(free[:, None], joints, state.joints),
            steps=state.steps + live,
            idle=torch.where(live, (state.idle + 1) * self.motion.idles(action), state.idle),
            workspace_hits=state.workspace_hits + (live & ~inside),
            force_hits=state.force_hits + (live & inside & ~soft),
            arm_hits=state.arm_hits + (live & inside & soft & ~follows),
            peak_force=torch.maximum(state.peak_force, force),
            force_sum=state.force_sum + force * live,
        )

    def wrench(self, pose: Pose) -> Tensor:
        """Return the (B, 6) wrench, N and N·m, of probes at rest at any poses."""
        wrench = self.forces.wrench(pose)
        if self.forces is not self.phantom:
            sensing.check_finite(wrench, f"forces of {type(self.forces).__name__}")
        return wrench

    def limits(self, pose: Pose, wrench: Tensor, force: Tensor) -> tuple[Tensor, Tensor]:
        """Return whether poses lie in the workspace, and whether they press within the limit.

        From a force, N, already over the limit, a step that eases it is let through.
        """
        pressing = -wrench[:, 2]
        soft = (pressing <= self.task.force_limit) | (pressing <= force)
        return self.phantom.workspace.contains(pose), soft

    def options(self, rows: Tensor | None = None) -> tuple[Pose, Tensor]:
        """Return where each of the thirteen steps leads (K,) rows or all, and whether they may go.

        Poses are (K × 13), row after row; the rest is (K, 13) bool, of workspace and force.
        """
        state, count = self.state.taken(rows), len(ACTIONS)
        each = Pose(*(x.repeat_interleave(count, 0) for x in state.pose))
        step = torch.arange(count, device=self.device).repeat(len(state.steps))
        moved = self.table.move(each, step)
        force = state.force.repeat_interleave(count)
        inside, soft = self.limits(moved, self.wrench(moved), force)
        return moved, (inside & soft).view(-1, count)

    def _judge(self, before: Score, live: Tensor) -> Transition:
        """Reward the live rows and end those that are through."""
        state, needed = self.state, self.task.hits_to_end
        hit = is_hit(self.score, self.rewards)
        state.streak = torch.where(live, (state.streak + 1) * hit, state.streak)
        state.reached = state.reached | (state.streak >= self.task.hits)
        if self.task.termination == DECLARED:
            terminated = live & (state.idle >= self.task.idles)
        else:
            terminated = live & (state.streak >= needed) if needed else torch.zeros_like(live)
        truncated = live & ~terminated & (state.steps >= self.task.max_steps)
        # Who declares at the wrong place ends the episode, and wins nothing by it.
        reward = self._reward(before, self.score, terminated & hit, self.rewards) * live
        state.total = state.total + reward
        state.done = state.done | terminated | truncated
        return Transition(self.observe(), reward, terminated, truncated)

    def _sense(self, rows: Tensor | None = None) -> None:
        """Look at the rows (all by default): parameters, truth, and image and scores if needed."""
        state, scene = self.state.taken(rows), self.scene(rows)
        pose, wrench, seeds = state.pose, state.wrench, derive(state.seed, state.steps)
        parameters, truth = pose_to_parameters(pose, wrench), scene.judge_alike(pose)
        sensed = {
            "parameters": parameters,
            "view": truth.view,
            "grade": truth.grade,
            "oracle_p": _of(truth.membership, state.goal),
            "oracle_g": _of(truth.view_grade, state.goal),
        }
        if self.observation != "params" or self.reward.needs_judge:
            sensed["image"] = self._draw(parameters, seeds, scene)
        if self.masks:
            sensed["action_mask"] = self.options(rows)[1]
        if self.encoder is not None:
            sensed["features"] = in_fixed_batches(self.encoder, sensed["image"])
        if self.reward.needs_judge and self.grader is not None:
            p, g = self.grader.probabilities_and_grade(sensed["image"])
            sensing.check_judged(p, g, len(seeds), truth.membership.shape[1] + 1, self.grader)
            sensed |= {"grader_p": _of(p, state.goal).float(), "grader_g": g.float()}
        if rows is not None:
            sensed = {k: self._sensed[k].index_copy(0, rows, v) for k, v in sensed.items()}
        self._sensed = sensed
        self.score = self.scored_by(self.reward.judged_by)

    def scored_by(self, source: str) -> Score:
        """Return the scores of all rows by the `oracle` or, where one looks, the `grader`."""
        return Score(self._sensed[f"{source}_p"], self._sensed[f"{source}_g"], self._distance())

    def _distance(self) -> Tensor:
        """Return (N,) unit steps to the nominal pose, or zeros where the reward has no use.

        Where the straight way may be closed, those of the shortest open one to a hit.
        """
        if not self.reward.needs_distance:
            return torch.zeros_like(self.state.total)
        if isinstance(self.phantom, sensing.KnowsWays):
            return self.phantom.steps_left(self.state.pose)
        metres, radians = self.pose_error()
        return metres / self.task.step_translation + radians / self.task.step_rotation

    @property
    def target(self) -> Pose:
        """The nominal poses of the rows' goals now, (N,), or the one that all rows have."""
        return self.scene().nominal(self.state.goal) if self._one is None else self._one

    def pose_error(self) -> tuple[Tensor, Tensor]:
        """Return (N,) m and (N,) rad to the nominal pose of the target view."""
        target = self.target
        metres = (self.state.position - target.position).norm(dim=-1)
        return metres, geodesic(self.state.rotation, target.rotation)

    def view_error(self, rows: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return m and rad, at most, from (K,) rows or all to a pose that truly shows the view."""
        state, scene = self.state.taken(rows), self.scene(rows)
        target = scene.nominal(state.goal) if self._one is None else self._one
        units = self.task.step_translation, self.task.step_rotation
        label = state.goal if self.task.any_view else self.task.target
        near = nearest_showing(scene, state.pose, target, label, units)
        moved = (near.position - state.position).norm(dim=-1)
        return moved, geodesic(near.rotation, state.rotation)

    def sees_target(self) -> Tensor:
        """Return (N,) bool: the true view is the target's, by the oracle."""
        return self._sensed["view"] == self.state.goal

    def succeeds(self) -> Tensor:
        """Return (N,) bool: what counts as success where episodes stand now, by the oracle.

        On the one heart the true view is the target's; on patients it is so with a p and a grade
        that make a hit.
        """
        if self._one is not None:
            return self.sees_target()
        return is_hit(self.scored_by("oracle"), self.rewards)

    @property
    def parameters(self) -> Tensor:
        """(N, 12) parameters of the probes at rest."""
        return self._sensed["parameters"]

    def decision_seeds(self) -> Tensor:
        """Return (N,) int64 seeds for agents that draw their actions at this step."""
        return derive(self.state.seed, self.state.steps, 7)

    def picture(self) -> Tensor:
        """Return the (N, 128, 128) images at the present poses, drawn now if no step drew them."""
        if "image" in self._sensed:
            return self._sensed["image"]
        seeds = derive(self.state.seed, self.state.steps)
        return self._draw(self.parameters, seeds, self.scene())

    def _draw(self, parameters: Tensor, seeds: Tensor, scene: World) -> Tensor:
        source = self.images
        if isinstance(source, sensing.DrawsScenes):
            source = source.of(scene)
        return sensing.check_drawn(source.generate(parameters, seeds), len(seeds), source)

    def told_pose(self) -> Pose:
        """Return the (N,) poses that the arm reports: those where the probes are."""
        return self.state.pose

    def observe(self) -> dict[str, Tensor]:
        """Return what an agent sees: `image` (N, 128, 128) uint8, `params` (N, 9) float32.

        With an encoder also `features`, what it says of the images; where the goal is drawn for
        each episode also `goal`, (N, V) float32, 1 for the goal's label and else 0. Where an arm
        carries the probe and its pose is seen, also `joints` (N, J) float32, rad. Where recordings
        mask steps, also `action_mask` (N, 13) bool: what will not be refused.
        """
        names = [] if self.observation == "params" else ["image"]
        names += [] if self.encoder is None else ["features"]
        seen = {name: self._sensed[name] for name in names}
        if self.observation != "image":
            seen["params"] = sensing.encode_pose(self.told_pose(), *self._box)
            if self.robot.joints:
                seen["joints"] = self.state.joints.float()
        if self.task.any_view:
            seen["goal"] = one_hot(self.state.goal, len(self.phantom.views)).float()
        if self.masks:
            seen["action_mask"] = self._sensed["action_mask"]
        return seen

    def info(self, view_error: bool = True) -> dict[str, Tensor]:
        """Return what the agent is not told, N rows each; see `told_of`."""
        return told_of(self, self._sensed, view_error)


def _of(values: Tensor, labels: Tensor) -> Tensor:
    """Return each row's entry of (N, V) values at its label, (N,)."""
    return values.gather(1, labels.unsqueeze(1)).squeeze(1)
