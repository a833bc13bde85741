"""What the records of a board are held against: its settings, the data and the judges here."""

import contextlib
import functools
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from racines_data.build.dataset import recipe_of
from racines_data.build.planning import DataConfig
from racines_data.config import PROFILES, fill, read_params, section
from racines_data.errors import RacinesError
from racines_data.files import sha256_file
from racines_data.manifest import MANIFEST
from racines_data.store.asked import AskedStore
from racines_data.store.frames import FrameStore, open_store
from racines_envs.evaluation.patients import PatientsConfig
from racines_envs.evaluation.run import EvaluationConfig
from racines_envs.task.names import PATIENTS
from racines_envs.worlds.backends import GRADERS
from racines_leaderboard.board.collect import Record, basis_of, read_record
from racines_leaderboard.records.motions import MOVING, SIMULATED
from racines_leaderboard.records.schema import read_json
from racines_leaderboard.records.tracks import HELD_OUT, TRACK
from racines_leaderboard.submissions.confined.session import Limits
from racines_models.published.places import published
from racines_models.sample import Sample, take_sample
from racines_models.scores import scoring
from racines_models.scores.on_patients import PatientScoresConfig
from racines_models.scores.scoring import ScoresConfig
from racines_models.trackerless.scoring import MotionScoresConfig
from racines_models.trackerless.sweeps import SweepSet

JUDGES = {
    "grader": "grader.safetensors",
    "pose": "model.safetensors",
    "segmentation": "model.safetensors",
}
"""File of a judge's weights in its folder."""
PINS = "board.json"
"""What a board is pinned to, in its folder."""
SETTINGS = "params.yaml"
"""Settings of a board that no profile is for, in its folder."""
RECORDED = "frames"
PHANTOM = DataConfig.source
"""The source whose recipe settings name."""
"""The config of a dataset that is no added one."""
KINDS = {key: key for key in JUDGES} | {"guide": "grader"}
"""What judge an extractor of a record is; a guide is the grader that an agent goes by."""


@dataclass(frozen=True)
class Places:
    """Where things lie."""

    results: Path = Path("leaderboard/results")
    submissions: Path = Path("leaderboard/submissions")
    data: Path = Path("data/racines")
    """Where a board's dataset is looked for first; then in `further`, then beside it."""
    params: Path = Path("params.yaml")
    """Settings of its own board; those of other boards are packaged."""
    runs: Path = Path("models/runs")
    """Of generators and judges, each in a folder of its name."""
    weights: Path = Path("models/weights")
    """Half-precision copies, likewise."""
    agents: Path = Path("envs/runs")
    policies: Path = Path("envs/weights")
    """Of agents that come with the repository, as they were trained."""
    judges: dict[str, Path] = field(default_factory=dict)
    """Folders of a grader and a pose regressor, before those in `runs` and `weights`."""
    limits: Limits = field(default_factory=Limits)
    further: tuple[Path, ...] = ()
    """More folders of datasets."""


class Bench:
    """One board's settings, data and judges, each opened once and when it is asked for."""

    def __init__(self, board: str, places: Places) -> None:
        self.board, self.places = board, places
        self.no_settings = f"no settings of board {board} here: give --params"
        self.no_data = f"no dataset of its recipe in {places.data}, nor beside it"
        self._sweeps: dict[tuple[str, str], SweepSet | None] = {}
        self._records: dict[str, tuple[tuple[int, int, int], Record | None]] = {}
        self._hashes: dict[Path, tuple[tuple[int, int, int], str]] = {}

    def peers(self, path: Path) -> list[Record]:
        """Return the sound records beside one, each read once for as long as its file stays."""
        # A board of N records asks N times: no paths are made of what is known already.
        with os.scandir(path.parent) as found:
            others = {each.name: each for each in found if each.name.endswith(".json")}
        others.pop(path.name, None)
        beside = (self._beside(others[name]) for name in sorted(others))
        return [record for record in beside if record is not None]

    def _beside(self, entry: os.DirEntry[str]) -> Record | None:
        try:
            about = entry.stat()
        except FileNotFoundError:  # it went while the folder was read
            return None
        state = about.st_ino, about.st_size, about.st_mtime_ns
        known = self._records.get(entry.path)
        if known is not None and known[0] == state:
            return known[1]
        path = Path(entry.path)
        try:
            record = read_record(path, self.board, TRACK[path.parent.name])
        except RacinesError:
            record = None
        self._records[entry.path] = state, record
        return record

    @functools.cached_property
    def settings(self) -> dict[str, Any] | None:
        """The settings of the board; None where neither params file nor profile is for it."""
        found = [read_params(own) for own in self._files if own.is_file()]
        found += [read_params(profile=name) for name in PROFILES]
        return next((values for values in found if self._is_for(values)), None)

    @property
    def _files(self) -> tuple[Path, ...]:
        places, own = self.places, f"{self.board}.yaml"
        beside = places.results / self.board / SETTINGS, places.results.parent / "params" / own
        return (places.params, *beside)

    @property
    def params(self) -> Path:
        """The params file that is for the board, or else the one that was given."""
        files = (each for each in self._files if each.is_file())
        return next((each for each in files if self._is_for(read_params(each))), self.places.params)

    def _is_for(self, values: dict[str, Any]) -> bool:
        return self.board in (values.get("board"), *values.get("patient_boards", ()))

    @functools.cached_property
    def scores(self) -> ScoresConfig:
        """How the board scores generators; defaults where its settings are unknown."""
        return fill(ScoresConfig, section(self.settings or {}, "scores"), "scores")

    @functools.cached_property
    def evaluation(self) -> EvaluationConfig:
        """How the board evaluates agents, likewise."""
        return fill(EvaluationConfig, section(self.settings or {}, "evaluation"), "evaluation")

    def on_patients(self, view: str) -> PatientsConfig:
        """Return how the board evaluates agents at a task on patients."""
        settings = section(self.settings or {}, "evaluation_patients")
        return fill(PatientsConfig, settings | {"view": view}, "evaluation_patients")

    @functools.cached_property
    def patient_scores(self) -> PatientScoresConfig:
        """How the board scores generators on patients, likewise."""
        stated = section(self.settings or {}, "patient_scores")
        return fill(PatientScoresConfig, stated, "patient_scores")

    @functools.cached_property
    def asked(self) -> AskedStore:
        """What the board asks of generators on patients, drawn anew: no former run is looked at."""
        config = self.patient_scores
        return AskedStore(config.split, config.patients, config.seed)

    @functools.cached_property
    def motion_scores(self) -> MotionScoresConfig:
        """How the board scores estimated motion, likewise."""
        stated = section(self.settings or {}, "motion_scores")
        return fill(MotionScoresConfig, stated, "motion_scores")

    @functools.cached_property
    def recipe(self) -> str | None:
        """Recipe digest of the dataset that the settings build; None for imported data."""
        with contextlib.suppress(RacinesError):
            return None if self.settings is None else recipe_of(section(self.settings, "data"))
        return None

    def recipe_for(self, record: Record) -> tuple[str | None, str]:
        """Return the recipe digest that a record has to rest on, and who says so.

        That of recordings is known once they are read, and no settings name it: of these it is the
        one that the record's track is pinned to.
        """
        data = record["scores"]["dataset"]
        named = section(self.settings or {}, "data").get("source")
        if {named, data["source"]} & {*SIMULATED}:
            recipe = self.recipe_with(data.get("config", RECORDED))
            return recipe, "the recipe that the board's settings build"
        pinned = self.pins.get(record["track"], {}).get("recipe_digest")
        return pinned, "the recipe that the board is pinned to"

    def recipe_with(self, config: str) -> str | None:
        """Return the recipe digest of a config of the dataset that the settings build, likewise."""
        if config == RECORDED or self.settings is None:
            return self.recipe
        with contextlib.suppress(RacinesError):
            return recipe_of(section(self.settings, "data"), config)
        return None

    @functools.cached_property
    def profile(self) -> str | None:
        """The packaged profile that is for the board; None if it has a params file of its own."""
        every = (name for name in PROFILES if self._is_for(read_params(profile=name)))
        return next(every, None)

    @functools.cached_property
    def data(self) -> Path:
        """The folder of the board's dataset: the one of its recipe, or else the first."""
        found = (each for each in self._folders if self._is_of_recipe(each))
        return next(found, self.places.data)

    @property
    def _folders(self) -> list[Path]:
        places = self.places
        beside = sorted(path.parent for path in places.data.parent.glob(f"*/{MANIFEST}"))
        return [places.data, *places.further, *beside]

    def _is_of_recipe(self, folder: Path) -> bool:
        try:
            told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return told.get("recipe_digest") in {self.recipe, *self.recipes} - {None}

    @functools.cached_property
    def store(self) -> FrameStore | None:
        """The dataset here, if there is one."""
        return open_store(self.data) if self.data.is_dir() else None

    @functools.cached_property
    def pins(self) -> dict[str, Any]:
        """What the board's own file pins by track; nothing where there is none.

        Raises:
            RacinesError: a damaged file.
        """
        path = self.places.results / self.board / PINS
        return read_json(path, "any") if path.is_file() else {}

    @property
    def recipes(self) -> set[str]:
        """The recipe digests that the board's tracks are pinned to."""
        parts = (part for part in self.pins.values() if isinstance(part, dict))
        return {part["recipe_digest"] for part in parts if "recipe_digest" in part}

    def pinned(self, track: str, kind: str) -> str | None:
        """Return the sha256 of the judge of a kind that the board is pinned to, if it is."""
        return self.pins.get(track, {}).get("judges", {}).get(kind)

    def data_for(self, record: Record) -> FrameStore | None:
        """Return the dataset here if it is of the recipe that a record rests on."""
        store, recipe = self.store, basis_of(record)
        return store if store is not None and store.manifest["recipe_digest"] == recipe else None

    def sweeps_for(self, record: Record) -> SweepSet | None:
        """Return the sweeps here if they are of the recipe that estimated motion rests on."""
        return self.sweeps_of(record["scores"]["dataset"])

    def sweeps_of(self, card: dict[str, Any]) -> SweepSet | None:
        """Return the sweeps here if they are of the config and the recipe that a card names."""
        key = str(card.get("config")), str(card.get("recipe_digest"))
        if key not in self._sweeps:
            self._sweeps[key] = self._find_sweeps(*key)
        return self._sweeps[key]

    def _find_sweeps(self, config: str, recipe: str) -> SweepSet | None:
        for folder in self._folders:
            with contextlib.suppress(RacinesError):
                store = open_store(folder, config)
                if store.manifest.get("recipe_digest") == recipe:
                    return SweepSet(store)
        return None

    def lacks_for(self, record: Record) -> str | None:
        """Say what is not here of what a record's scores are made on; None if nothing."""
        if self.settings is None:
            return self.no_settings
        if record["track"] in MOVING:
            return self.no_data if self.sweeps_for(record) is None else None
        generator = record["track"] in HELD_OUT
        return self.no_data if generator and self.data_for(record) is None else None

    @functools.cached_property
    def sample(self) -> Sample:
        """The frames of the dataset here that generators are scored on."""
        assert self.store is not None
        return take_sample(self.store, self.scores.split, self.scores.samples)

    @functools.cached_property
    def inception(self) -> dict[str, Any]:
        """The settings of Inception's features here."""
        return scoring.InceptionFeatures("cpu").settings

    def judge(self, kind: str, sha256: str | None) -> Path | None:
        """Return the folder of the judge whose weights have a hash, if it is here."""
        folders = self.judge_folders(kind)
        return next((f for f in folders if sha256 == self._sha256(f / JUDGES[kind])), None)

    def _sha256(self, path: Path) -> str:
        """Return the hash of a judge's weights, taken once for as long as their file stays."""
        about = path.stat()
        state = about.st_ino, about.st_size, about.st_mtime_ns
        known = self._hashes.get(path)
        if known is None or known[0] != state:
            known = self._hashes[path] = state, sha256_file(path)
        return known[1]

    def judge_folders(self, kind: str) -> list[Path]:
        """Return where judges of a kind lie: the one given, or else those of the usual places.

        Published ones are also those of the checkout, or of the wheel, whose code runs.
        """
        runs, weights = self.places.runs, self.places.weights
        of_patients = getattr(self.patient_scores, kind, None)
        usual = [runs / kind, published(weights / kind)]
        usual += [Path(of_patients)] if of_patients else []
        if kind == "grader":  # of patients, which an agent may go by
            own, folders = GRADERS[PATIENTS]
            copies = (published(weights.joinpath(*each.parts[-2:])) for each in folders)
            usual += [runs / own.name, *copies]
        places = [self.places.judges[kind]] if kind in self.places.judges else usual
        return [folder for folder in places if (folder / JUDGES[kind]).is_file()]
