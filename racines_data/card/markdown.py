"""The dataset card: YAML that `datasets` reads, and what a reader has to know."""

from collections.abc import Mapping
from typing import Any

import yaml
from datasets import Features

from racines_data.card import sections
from racines_data.card.croissant_rai import rai_fields
from racines_data.card.datasheet import datasheet
from racines_data.card.realism import realism_section
from racines_data.manifest import describe, manifest_labels
from racines_data.records import features_of
from racines_data.schema import trajectory_features
from racines_data.sources.card import SourceCard, manifest_card
from racines_data.views import LABELS

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))


def write_card(manifest: Mapping[str, Any]) -> str:
    """Return README.md of a dataset: YAML front matter, the card, the datasheet.

    Figures and pictures are those that the manifest names (`statistics`, `pictures`, `realism`);
    without them their sections are left out.
    """
    head = yaml.safe_dump(_front_matter(manifest), sort_keys=False, allow_unicode=True, width=1000)
    card, rai = manifest_card(manifest), rai_fields(manifest)
    parts = [
        sections.summary(manifest, card.origin),
        sections.rows(manifest),
        sections.configs(manifest),
        sections.loading(manifest),
        sections.contents(manifest),
        sections.making(manifest, rai["rai:dataCollection"]),
        sections.statistics(manifest),
        sections.shares(manifest),
        realism_section(manifest),
        sections.limits(manifest, rai["rai:dataUseCases"][0], card.limits),
        "## Datasheet",
        datasheet(manifest),
    ]
    body = "\n\n".join(part.strip() for part in parts if part.strip())
    return f"---\n{head}---\n{body}\n"


def _front_matter(manifest: Mapping[str, Any]) -> dict[str, Any]:
    configs, infos = [], []
    for name, paths in manifest["configs"].items():
        files = [{"split": split, "path": list(paths[split])} for split in paths]
        config: dict[str, Any] = {"config_name": name, "data_files": files}
        if name == "frames":
            config["default"] = True
        configs.append(
            {**config, "version": manifest["version"], "description": describe(manifest, name)}
        )
        features: Features = (
            trajectory_features()
            if name == "trajectories"
            else features_of(manifest["source"], manifest_labels(manifest))
        )
        infos.append({"config_name": name, "features": features._to_yaml_list()})
    source, card = manifest["source"], manifest_card(manifest)
    return {
        "pretty_name": f"RACINES ({source} {manifest['version']})",
        "license": card.license,
        "language": ["zxx"],  # ISO 639-2: no linguistic content
        "annotations_creators": ["machine-generated" if card.simulated else "other"],
        "task_categories": _tasks(manifest, card),
        "size_categories": [_size(manifest["counts"]["frames"])],
        "tags": _tags(manifest, card),
        "configs": configs,
        "dataset_info": infos,
    }


def _tags(manifest: Mapping[str, Any], card: SourceCard) -> list[str]:
    heart = card.labelled and manifest_labels(manifest) == LABELS
    organ = ["echocardiography"] if heart else []
    return ["ultrasound", *organ, "robotics", "medical", manifest["source"], *card.tags]


def _tasks(manifest: Mapping[str, Any], card: SourceCard) -> list[str]:
    poses, labels = manifest.get("poses", True), card.labelled
    return ["image-classification"] * labels + ["reinforcement-learning", "robotics"] * poses


def _size(frames: int) -> str:
    return next((name for limit, name in _SIZES if frames < limit), "1M<n<10M")
