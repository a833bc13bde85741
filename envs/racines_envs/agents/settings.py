"""Settings that agents which learn share."""

from dataclasses import dataclass

from racines_envs.robots.arm import FREE


@dataclass(frozen=True)
class TrainingConfig:
    """What is learned where, and the parts of a training that no method changes."""

    view: str = "SC"
    """The target view, or a task on patients, as `SC-patients`."""
    patients: int = 64
    """On patients: how many of the train split; half as many validation patients choose."""
    observation: str = "params"
    """`image`, `params` or `multimodal`."""
    encoder: str = ""
    """What looks at the image: `explored` (published; see `networks.py`) or the folder of another
    pose regressor, frozen; "" for convolutions that learn from reward alone, as in the paper."""
    rotation: str = "continuous"
    """How a network reads the pose's rotation: `continuous`, its first two columns, or `euler`, the
    angles that the paper records, which jump by 2π near the pose that looks straight down."""
    reward: str = "shaped"
    """`paper` (needs a grader), `oracle` or `shaped`."""
    termination: str = ""
    """`first_hit`, `k_hits` or `timeout` in training; the task's own rule if empty."""
    backend: str = "phantom"
    """`phantom`, `generator` or `replay`; nothing is drawn where nothing looks."""
    generator: str = ""
    """Name or run folder, for the backend `generator`."""
    grader: str = ""
    """Run folder, for the reward `paper`; models/runs/grader if empty."""
    robot: str = FREE
    """`free`, or the arm that carries the probe: `ur5e`, another's name, `module:ARM`. What its
    joints do is not observed."""
    frames: int = 300_000
    """Environment steps in all; rounded up to whole updates."""
    envs: int = 64
    """Environments side by side."""
    collectors: int = 1
    """Groups of environments that act each by themselves, on workers with `--engine ray`."""
    update_every: int = 2_048
    """Environment steps between updates, a multiple of `envs`."""
    gamma: float = 0.97
    """Discount."""
    reward_scale: float = 0.05
    """Multiplies rewards before learning; reports stay unscaled."""
    max_gradient: float = 0.5
    """Gradient norm at which to clip."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the dense layers."""
    validate_every: int = 50_000
    """Environment steps between validations; also between checkpoints."""
    validation_starts: int = 100
    """Episodes a validation, from starts that no evaluation uses."""
    threads: int = 1
    """CPU threads; small networks are fastest with one. 0 leaves torch as it is."""
    device: str = "cpu"
