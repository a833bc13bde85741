"""Modules that moved: their old names still import, with a warning that says the new one.

One finder at the end of `sys.meta_path` serves the names that no file answers to any more. The old
name stands for the very module of the new one: an object has one identity under both.
"""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    "racines_data": "card_style=plotting",
    "racines_data.build": "canonical=writer shards=writer splits=writer staging writer",
    "racines_data.card": (
        "card_frames=frames card_paths=plots card.paths=plots card_pictures=pictures "
        "card_plots=plots card_realism=realism card_rewrite=rewrite card_samples=pictures "
        "card.samples=pictures card_sections=markdown card.sections=markdown "
        "card_statistics=frames card.statistics=frames card_tables=frames croissant "
        "croissant_rai=croissant card.croissant_rai=croissant datasheet=datasheet"
    ),
    "racines_data.cli": (
        "cli_card=dataset cli_export=dataset cli_hub=dataset cli_import=build cli_phantom=dataset"
    ),
    "racines_data.export.lerobot": "export.lerobot_statistics=writer",
    "racines_data.hub": "push",
    "racines_data.sources": (
        "sources.multi_phantom=phantom sources.crop=cactus.source "
        "sources.release.kinds=folder sources.release_kinds=folder sources.card=base"
    ),
    "racines_data.sources.cactus": "sources.cactus_files=source",
    "racines_data.sources.release": (
        "sources.release_checks=source sources.release.checks=source sources.release_log=layout "
        "sources.release_survey=source sources.release_tree=layout"
    ),
    "racines_data.sources.tracked": "sources.mha=source",
    "racines_data.store": (
        "batch_memory=frames export.sweeps=sweeps loader=frames restore=sweeps store_writer=sweeps"
    ),
    "racines_data.validate": (
        "validate_duplicates=identity validate_files=identity validate_labels=meaning "
        "validate_oracle=meaning validate_report=run validate_rows=survey "
        "validate_splits=identity validate_statistics=meaning validate_survey=survey"
    ),
    "racines_envs.agents": (
        "agents.encoders=networks agents.identity=training agents.registry=protocol "
        "agents.trace_agent=trace agents.trace_file=trace agents.training_config=training "
        "agents.training_run=training rollout trace"
    ),
    "racines_envs.agents.onnx": (
        "agents.onnx.export=policy agents.onnx.format=policy agents.onnx_policy=policy "
        "agents.onnx_policy_export=policy agents.onnx_policy_format=policy"
    ),
    "racines_envs.apis": "apis.gym_vector=gym_env gym_env gym_vector=gym_env rendering torchrl_env",
    "racines_envs.cli": (
        "cli_drive=episodes cli_encoder=encoder cli_eval=study cli_explain=episodes "
        "cli_export=episodes cli_forces=study cli_speed=study settings"
    ),
    "racines_envs.driving": "keyboard terminal=keyboard",
    "racines_envs.evaluation": (
        "entries=agent_specs evaluation.entries=agent_specs evaluation.latency=measures "
        "evaluation.trace_recording=run latency=measures measures pictures runs=agent_specs "
        "trace_recording=run"
    ),
    "racines_envs.explain": (
        "explain.scores=maps explain_figure=run explain_maps=maps explain_scores=maps "
        "explain_truth=maps"
    ),
    "racines_envs.recordings": (
        "racines_data.export.minari=minari recorder=episodes recordings.episode_writer=episodes "
        "recordings.rerun=episodes replay=episodes"
    ),
    "racines_envs.studies": (
        "curves rank_correlation=transfer reward_pages=rewards reward_report=rewards "
        "reward_trace=rewards step_profile task_table transfer transfer_pages=transfer"
    ),
    "racines_envs.task": (
        "actions core names rewards sensing starts state "
        "task.view_error=starts tasks view_error=starts"
    ),
    "racines_envs.worlds": (
        "backends backends_replay=replay data_versions=making exploration forces "
        "forces_report=forces making pose_index=replay recorded=replay studies.forces=forces "
        "worlds.data_versions=making worlds.pose_index=replay worlds.recorded_world=replay "
        "worlds.replay_images=replay"
    ),
    "racines_leaderboard.audit": "audit.compare=numbers audit.figures=numbers",
    "racines_leaderboard.board": "chart=pages collect groups=rank pages rank recompute table",
    "racines_leaderboard.cli": (
        "cli_audit=audit cli_determinism=audit cli_studio=studio cli_submit=submit "
        "commands=board expert.cli=expert"
    ),
    "racines_leaderboard.expert": (
        "expert.figures=agreement expert.instructions=kit expert.session=ratings"
    ),
    "racines_leaderboard.records": (
        "expert.board=experts expert.names=experts records.seal=schema schema seal=schema tracks"
    ),
    "racines_leaderboard.studio": (
        "studio.boards_html=boards studio.browsing_html=browsing "
        "studio.compare=side_by_side studio.escape=html studio.compare_page=side_by_side "
        "studio.labelling_html=labelling studio.place=parts studio.scene_page=scene "
        "studio.sweep_figures=browsing studio.watch_page=watching"
    ),
    "racines_leaderboard.submissions": (
        "artefacts=document content_checks=intake fetch=intake file_checks=document intake "
        "submission=document submission_text=document template"
    ),
    "racines_leaderboard.submissions.confined": (
        "confined=session confined_child=child confined_roads=session confined_wire=child"
    ),
    "racines_leaderboard.weights": "board.model_card=card",
    "racines_models": "bootstrap=statistics publish=weights racines_envs.intervals=statistics",
    "racines_models.cli": (
        "cli_conditioning=study.comparisons cli_data=study.comparisons cli_floor=study.comparisons "
        "cli_export=export cli_gallery=study.gallery cli_generators=train.generator "
        "cli_grader=evaluate.grader cli_output=output cli_pose=train.pose "
        "cli_publish=export cli_realism=study.realism cli_scores=evaluate.generator"
    ),
    "racines_models.exchange": "naming",
    "racines_models.exchange.onnx": (
        "onnx_export=generator exchange.onnx.export=generator onnx_file=file "
        "onnx_format=generator onnx_generator=generator onnx_session=file"
    ),
    "racines_models.exchange.predictions": "png=file predictions=file predictions_reader=file",
    "racines_models.judges.grader": (
        "annotate grader=model grader_calibration=report grader_evaluation=evaluation "
        "grader_loss=training grader_plots=evaluation grader_report=report grader_training=training"
    ),
    "racines_models.judges.pose": "pose_regressor=regressor pose_training=training",
    "racines_models.judges.student": (
        "student=model student_labels=training student_report=training student_training=training"
    ),
    "racines_models.networks": (
        "conditioning=layers onnx_module=painting networks.onnx_module=painting"
    ),
    "racines_models.networks.scene_field": (
        "networks.scene_field_echo=echo networks.scene_field_loss=echo "
        "networks.scene_field_probe=probe"
    ),
    "racines_models.scores": (
        "diversity features frechet=metrics gallery inception=features judge=scoring "
        "memorisation=diversity metrics prdc=metrics scoring"
    ),
    "racines_models.studies": "conditioning_ablation=conditioning floor leakage",
    "racines_models.studies.ablation": (
        "ablation=run ablation_hearts=hearts ablation_picture=run ablation_variants=run"
    ),
    "racines_models.studies.realism": "realism=report realism_figures=report",
    "racines_models.training": (
        "adversary differentiable_augmentation=adversary grader_augment=augmentation trainer"
    ),
}
"""By room, what moved there: `old` where the module kept its name, `old=new` where it did not.

An old name is one of the room's package, unless it names its own."""


def renamed_modules() -> dict[str, str]:
    """Return the new name of every module that moved, by its old one."""
    names = {}
    for room, moved in MOVED.items():
        package = room.partition(".")[0]
        for entry in moved.split():
            old, _, new = entry.partition("=")
            whole = old if old.startswith("racines_") else f"{package}.{old}"
            names[whole] = f"{room}.{new or old.rpartition('.')[2]}"
    return names


class RenamedFinder:
    """Finds modules under the names that they had; both finder and loader."""

    def __init__(self) -> None:
        self.names = renamed_modules()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a spec for an old name, None for any other."""
        return ModuleSpec(name, self) if name in self.names else None  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> None:
        """Let the import system make an empty module, which `exec_module` replaces."""

    def exec_module(self, module: ModuleType) -> None:
        """Put the module of the new name in the place of the old one."""
        old = module.__name__
        new = self.names[old]
        warnings.warn(f"{old} is now {new}", DeprecationWarning, stacklevel=2)
        sys.modules[old] = import_module(new)


def install() -> None:
    """Serve the old names in this process; once is enough, more changes nothing."""
    if not any(isinstance(finder, RenamedFinder) for finder in sys.meta_path):
        sys.meta_path.append(RenamedFinder())  # type: ignore[arg-type]
