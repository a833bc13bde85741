import pickle

import numpy as np
import pytest

from racines_data.errors import RacinesError
from racines_data.phantom.acquisition import AcquisitionConfig, plan_lengths, plan_targets
from racines_data.schema import PARAMETERS
from racines_data.sources.phantom import PhantomSource
from racines_data.views import PAPER_STATISTICS, RANDOM_LABEL, VIEWS


def source(**config: object) -> PhantomSource:
    return PhantomSource.from_config({"frames": 700, **config}, [])


def test_lengths_add_up_to_the_frames_asked_for() -> None:
    for frames in (50, 700, 6000, 14_467):
        lengths = plan_lengths(AcquisitionConfig(frames=frames))
        assert sum(lengths) == frames
        assert min(lengths) >= 2
    assert min(plan_lengths(AcquisitionConfig(frames=6000))) > 80


def test_every_view_and_random_scanning_are_planned() -> None:
    targets = plan_targets(50, AcquisitionConfig())
    assert set(targets) == {*VIEWS, "Random"}
    assert targets.count("Random") == 8
    assert max(targets.count(v) for v in VIEWS) - min(targets.count(v) for v in VIEWS) <= 1


def test_a_unit_gives_the_same_bytes_wherever_it_is_made() -> None:
    first = source()
    second = pickle.loads(pickle.dumps(first))
    unit = first.plan()[2]
    a, b = first.produce(unit), second.produce(unit)
    for name in ("images", "parameters", "timestamps", "controls", "views", "grades"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert not np.array_equal(
        a.images, source(seed=1).produce(source(seed=1).plan()[2]).images[: len(a)]
    )


def test_a_sweep_reaches_its_view_and_holds_it() -> None:
    made = source()
    for unit in made.plan()[:5]:
        trajectory = made.produce(unit)
        assert len(trajectory) == unit.frames
        if unit.target_view == "Random":
            continue
        held = trajectory.views == VIEWS.index(unit.target_view)
        assert held.mean() > 0.35
        assert trajectory.grades[held].max() > 8
        assert (trajectory.grades[trajectory.views == RANDOM_LABEL] == 0).all()
        assert (trajectory.grades[held] >= 1).all()
        # Approach from above: the first frame is off the block, the held ones touch it.
        assert trajectory.parameters[0, 8] > 0.065 > trajectory.parameters[held, 8].mean()


def test_motion_is_smooth_and_control_is_its_velocity() -> None:
    made = source()
    trajectory = made.produce(made.plan()[0])
    position = trajectory.parameters[:, 6:9]
    assert np.abs(np.diff(position, axis=0)).max() < 0.01, "no jumps: 10 mm in 40 ms at most"
    moved = np.cumsum(trajectory.controls[:, :3], axis=0) / 25.0
    drift = (position - position[0]) - (moved - moved[0])
    assert np.abs(drift).max() < 0.006


@pytest.mark.slow
def test_parameters_lie_near_the_papers_table() -> None:
    """Loose here (the table is met at full size, with its own check): centre and spread agree."""
    made = source(frames=1500)
    rows = np.concatenate([made.produce(unit).parameters for unit in made.plan()])
    for column, name in enumerate(PARAMETERS):
        paper = PAPER_STATISTICS[name]
        assert abs(rows[:, column].mean() - paper.mean) < 0.8 * paper.std, name
        assert 0.5 < rows[:, column].std() / paper.std < 1.6, name
    assert (np.abs(rows[:, 9]) > 2.0).all(), "rotation_x in two modes at ±π"
    assert (rows[:, 9] > 0).any()
    assert (rows[:, 9] < 0).any()


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"frmes": 3}, "data.phantom.frmes: unknown key"),
        ({"phantom": {"probe": {"depht": 1.0}}}, "data.phantom.phantom.probe.depht"),
        ({"frames": "many"}, "data.phantom.frames: 'many' is str, expected a valid integer"),
        ({"frames": 1}, "at least 2"),
    ],
)
def test_bad_settings_are_named(config: dict, message: str) -> None:
    with pytest.raises(RacinesError, match=message):
        PhantomSource.from_config(config, [])
