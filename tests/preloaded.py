"""What forks need not import again, imported, and the default phantom, baked.

Servers of forks import this module first: a process has one phantom, which takes a command longer
to bake than most of its own work does. Neither starts a thread, of which a fork would know nothing.
Meanwhile garbage is not looked for, a sixth of the time that it takes, nor ever among what was
imported: what is not looked at stays memory that all forks share.
"""

import gc
from importlib import import_module

from racines_data.phantom import shared_phantom

MODULES = [
    "datasets",
    "matplotlib.pyplot",
    "torch",
    "torchmetrics",
    "torchrl.envs",
    "torchrl.collectors",
    "torchrl.objectives",
    "monai.networks.nets.resnet",
    "pydantic.dataclasses",
    "pydantic.type_adapter",
    "racines_data.build.dataset",
    "racines_leaderboard.cli.command",
    "racines_leaderboard.board.pages",
    "racines_leaderboard.records.schema",
    "racines_leaderboard.submissions.intake",
    "racines_models.judges.grader.evaluation",
    "racines_models.scores.scoring",
    "racines_envs.evaluation.run",
]

gc.disable()
for name in MODULES:
    import_module(name)
shared_phantom()
gc.collect()
gc.freeze()
gc.enable()
