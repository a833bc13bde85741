import hashlib
import json
from collections import Counter

import numpy as np
import pytest
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.views import LABELS
from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.expert.sample import (
    RETOUCHED,
    Study,
    System,
    allocate,
    blind,
    make_kit,
    retouch,
    stratify,
)  # fmt: skip
from tests.leaderboard.expert_kit import Inverse, Judge, frames, kit_of


def test_shares_are_even_up_to_the_capacities():
    assert allocate(10, np.array([9, 9, 9])).tolist() == [4, 3, 3]
    assert allocate(10, np.array([1, 9, 2])).tolist() == [1, 7, 2]
    assert allocate(0, np.array([3])).tolist() == [0]
    with pytest.raises(RacinesError, match="13 wanted of 12"):
        allocate(13, np.array([1, 9, 2]))


def test_poses_are_balanced_over_views_grades_and_trajectories():
    store = frames()
    views, grades, places = (
        column.numpy() for column in (store.views, store.grades, store.trajectory_index)
    )
    chosen = stratify(views, grades, places, 120, len(LABELS) - 1, np.random.default_rng(0))
    assert len(set(chosen.tolist())) == 120
    assert set(Counter(views[chosen].tolist()).values()) == {20}
    for view in range(len(LABELS) - 1):
        bins = np.digitize(grades[chosen][views[chosen] == view], (4.0, 7.0))
        assert sorted(np.bincount(bins, minlength=3).tolist()) == [6, 7, 7]
    most = max(Counter(places[chosen].tolist()).values())
    assert most <= 6, "120 of 60 trajectories: two each, were views not balanced too"


def test_the_two_names_of_an_image_are_a_third_of_the_kit_apart():
    plan = blind(["a"] * 20 + ["b"] * 40, 20, np.random.default_rng(0))
    first, middle, last = plan.blocks
    assert sorted(first + middle + last) == sorted(plan.names) and len(middle) >= 80 // 3
    row = {name: int(entry) for name, entry in zip(plan.names, plan.entries, strict=True)}
    shown = Counter(plan.entries.tolist())
    twice = {entry for entry, count in shown.items() if count == 2}
    assert len(twice) == 20 and max(shown.values()) == 2
    assert Counter("a" if entry < 20 else "b" for entry in twice) == {"a": 10, "b": 10}
    assert twice <= {row[name] for name in first} and twice <= {row[name] for name in last}
    assert not twice & {row[name] for name in middle}


def test_a_kit_has_every_image_once_and_its_repeats_again(tmp_path):
    store = frames()
    kit = kit_of(tmp_path, store, Judge())
    key = kit.read_key()
    kit.check_images()
    assert len(kit.images) == 72 and sorted(key["images"]) == kit.images
    firsts = {name: e for name, e in key["images"].items() if e["repeat_of"] is None}
    assert Counter(e["system"] for e in firsts.values()) == {"inverse": 30, "true-frames": 30}
    poses = {system: {e["row"] for e in firsts.values() if e["system"] == system} for system in
             ("inverse", "true-frames")}  # fmt: skip
    assert poses["inverse"] == poses["true-frames"], "systems are compared at the same poses"
    for name, entry in key["images"].items():
        with Image.open(kit.image_path(name)) as image:
            shown = np.asarray(image).astype(int)
        assert entry["truth"]["view"] == LABELS[int(store.views[entry["row"]])]
        if abs(shown[0, 0] - 127.5) > 1:
            assert entry["grader"]["view"] == ("Random" if shown[0, 0] < 128 else "SC")
        if entry["system"] == "true-frames":
            _check_retouched(shown, store.images[entry["row"]].numpy().astype(int))
        if entry["repeat_of"] is not None:
            first = key["images"][entry["repeat_of"]]
            assert {**first, "repeat_of": entry["repeat_of"]} == entry
            with Image.open(kit.image_path(entry["repeat_of"])) as other:
                _check_retouched(shown, np.asarray(other).astype(int), RETOUCHED * 2)


def _check_retouched(shown: np.ndarray, true: np.ndarray, most: int = RETOUCHED) -> None:
    """Check that two images look the same and are not equal."""
    changed = np.abs(shown - true)
    assert changed.max() <= (1 if most == RETOUCHED else 2)
    assert most / 4 < (changed > 0).sum() <= most


def test_no_hash_tells_which_image_is_a_repeat(tmp_path):
    """Of dark, bright and flat images too, whose pixels can go one way only."""
    store = frames()
    store.images[:200], store.images[200:400] = 0, 255
    kit = kit_of(tmp_path, store, images=60, repeats=30)
    files = [kit.image_path(name).read_bytes() for name in kit.images]
    pixels = []
    for name in kit.images:
        with Image.open(kit.image_path(name)) as image:
            pixels.append(image.tobytes())
    assert sum(e["repeat_of"] is not None for e in kit.read_key()["images"].values()) == 30
    for seen in (files, pixels):
        assert len({hashlib.sha256(each).digest() for each in seen}) == len(kit.images) == 90


def test_the_first_and_the_repeat_are_changed_alike():
    """What was changed is no sign: as many pixels of each, whether it is shown twice or not."""
    images = np.random.default_rng(0).integers(0, 256, (40, 128, 128), np.uint8)
    shown = retouch(np.concatenate([images, images[:10]]), seed=3)
    assert (shown == retouch(np.concatenate([images, images[:10]]), seed=3)).all()
    assert not (shown == retouch(np.concatenate([images, images[:10]]), seed=4)).all()
    true = np.concatenate([images, images[:10]]).astype(int)
    steps = shown.astype(int) - true
    assert np.abs(steps).max() == 1 and abs(steps.mean()) < 1e-3
    counts = (steps != 0).sum((1, 2))
    assert counts.min() >= RETOUCHED - 4 and counts.max() <= RETOUCHED


def test_both_look_alike():
    """Beyond what an eye tells apart, about 40 dB."""
    images = np.random.default_rng(1).integers(0, 256, (8, 128, 128), np.uint8)
    one, two = retouch(images, 1).astype(float), retouch(images, 2).astype(float)
    psnr = 10 * np.log10(255**2 / ((one - two) ** 2).mean((1, 2)))
    assert psnr.min() > 65


def test_nothing_that_a_rater_sees_tells_an_answer(tmp_path):
    store = frames()
    store.images[::2] = 0
    store.images[::2, 64, :64] = 200  # images that compress far better than the others
    kit = kit_of(tmp_path, store)
    files = [kit.image_path(name) for name in kit.images]
    assert len({path.stat().st_size for path in files}) == 1
    assert len({path.stat().st_mtime for path in files}) == 1
    for path in files:
        with Image.open(path) as image:
            assert image.mode == "L" and image.size == (128, 128) and not image.info
    text = (kit.folder / "kit.json").read_text()
    for word in ("inverse", "true-frames", "trajectory", "row", "seed", "repeat_of"):
        assert f'"{word}"' not in text
    key = kit.read_key()["images"]
    for field in ("system", "repeat_of"):
        told = np.array([str(key[name][field]) for name in kit.images])
        runs = 1 + int((told[1:] != told[:-1]).sum())
        assert runs > len(set(told)) + 5, f"names stand in the order of {field}"


def test_the_same_seed_makes_the_same_kit_and_another_seed_another(tmp_path):
    one, two, three = (
        kit_of(tmp_path / name, seed=seed) for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert one.digest == two.digest != three.digest
    assert one.read_key() == two.read_key()
    assert not [path for path in tmp_path.rglob(".*")], "no temporary folder stays"


def test_what_was_sealed_cannot_be_swapped(tmp_path):
    kit = kit_of(tmp_path)
    key = kit.folder / "key.json"
    assert key.stat().st_mode & 0o077 == 0, "not for others to read"
    moved = tmp_path / "elsewhere.json"
    key.rename(moved)
    with pytest.raises(RacinesError, match="--key"):
        kit.read_key()
    assert kit.read_key(moved)["truth"] == "oracle"
    moved.write_text(moved.read_text().replace('"SC"', '"PL"'))
    with pytest.raises(RacinesError, match="not the key"):
        kit.read_key(moved)
    a, b = kit.image_path(kit.images[0]), kit.image_path(kit.images[1])
    one, two = a.read_bytes(), b.read_bytes()
    a.write_bytes(two), b.write_bytes(one)
    with pytest.raises(RacinesError, match="changed after the kit was made"):
        kit.check_images()
    a.unlink()
    with pytest.raises(RacinesError, match=f"missing: {a.name}"):
        kit.check_images()
    path = kit.folder / "kit.json"
    document = json.loads(path.read_text())
    document["views"].pop(0)
    path.write_text(json.dumps(document))
    with pytest.raises(RacinesError, match=r"kit\.json: digest"):
        Kit.open(kit.folder)


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ({"images": 1, "repeats": 0}, "fewer than the 2 systems"),
        ({"images": 10, "repeats": 6}, "--repeats 6: give 0 to 5"),
        ({"images": 1300}, "split test has 600 frames, 650 are wanted"),
    ],
)
def test_impossible_studies_are_refused(tmp_path, study, message):
    with pytest.raises(RacinesError, match=message):
        kit_of(tmp_path, **study)
    assert not list(tmp_path.iterdir())


def test_kits_are_never_overwritten_and_systems_have_names_of_their_own(tmp_path):
    kit_of(tmp_path)
    with pytest.raises(RacinesError, match="is there already"):
        kit_of(tmp_path)
    one = System("inverse", Inverse())
    for systems, message in (([one, one], "named twice"), ([], "nothing to show")):
        with pytest.raises(RacinesError, match=message):
            make_kit(tmp_path / "other", frames(), systems, Study(images=8, repeats=0))
    with pytest.raises(RacinesError, match="kept for the dataset"):
        make_kit(tmp_path / "other", frames(), [System("true-frames", Inverse())], Study())


def test_recordings_without_views_need_a_grader(tmp_path):
    store = frames(source="release")
    store.views[:] = -1
    store.grades[:] = np.nan
    with pytest.raises(RacinesError, match="--grader"):
        kit_of(tmp_path, store)
    key = kit_of(tmp_path, store, Judge()).read_key()
    assert key["truth"] == "labels"
    assert all(entry["truth"] is None for entry in key["images"].values())
