import hashlib
import pickle

import pytest
import yaml

from racines_data.errors import RacinesError
from racines_leaderboard.submission import read_submission

SOUND = {
    "name": "mine",
    "track": "generators",
    "authors": ["Somebody"],
    "method": "a method",
    "source": "my_package:Model",
    "licence": "MIT",
    "description": "What it is.",
}
SAFETENSORS = (2).to_bytes(8, "little") + b"{}"


def write(tmp_path, weights: dict | None = None, **changes):
    document = {k: v for k, v in (SOUND | changes).items() if v is not None}
    if weights is not None:
        document["weights"] = [weights]
    path = tmp_path / "submission.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def test_a_sound_submission_with_weights(tmp_path):
    (tmp_path / "w.safetensors").write_bytes(SAFETENSORS)
    weights = {"path": "w.safetensors", "sha256": hashlib.sha256(SAFETENSORS).hexdigest()}
    assert read_submission(write(tmp_path, weights))["weights"] == [weights]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"score": 1}, "'score' was unexpected"),
        ({"licence": None}, "'licence' is a required"),
        ({"track": "both"}, "track: 'both'"),
        ({"authors": []}, "authors"),
        ({"name": "My Model"}, "name"),
    ],
)
def test_unknown_and_missing_keys_fail(tmp_path, changes, message):
    with pytest.raises(RacinesError, match=message):
        read_submission(write(tmp_path, **changes))


def test_pickles_are_refused_by_name_and_by_content(tmp_path):
    data = pickle.dumps({"weights": [1.0]})
    sha256 = hashlib.sha256(data).hexdigest()
    for name in ("model.pt", "model.pkl"):
        with pytest.raises(RacinesError, match=rf"weights\.0\.path: '{name}' refused"):
            read_submission(write(tmp_path, {"path": name, "sha256": sha256}))
    (tmp_path / "model.onnx").write_bytes(data)
    with pytest.raises(RacinesError, match="holds a pickle"):
        read_submission(write(tmp_path, {"path": "model.onnx", "sha256": sha256}))


def test_weights_must_be_there_and_have_their_digest(tmp_path):
    path = write(tmp_path, {"path": "w.safetensors", "sha256": "0" * 64})
    with pytest.raises(RacinesError, match="no such file"):
        read_submission(path)
    (tmp_path / "w.safetensors").write_bytes(SAFETENSORS)
    with pytest.raises(RacinesError, match=r"weights\.0\.sha256: the file has"):
        read_submission(path)


def test_the_name_is_that_of_its_folder(tmp_path):
    folder = tmp_path / "submissions" / "other"
    folder.mkdir(parents=True)
    with pytest.raises(RacinesError, match="stands in folder 'other'"):
        read_submission(write(folder))


def test_files_that_are_not_submissions(tmp_path):
    with pytest.raises(RacinesError, match="no such file"):
        read_submission(tmp_path / "absent.yaml")
    (tmp_path / "broken.yaml").write_text("a: [")
    with pytest.raises(RacinesError, match="not readable as YAML"):
        read_submission(tmp_path / "broken.yaml")
    (tmp_path / "list.yaml").write_text("- a")
    with pytest.raises(RacinesError, match="object"):
        read_submission(tmp_path / "list.yaml")
