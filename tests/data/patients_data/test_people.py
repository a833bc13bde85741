from racines_data.build.beside import summary
from racines_data.card.patients import people_table


def who(split, pathology, shown, female=True):
    return {"split": split, "pathology": pathology, "female": female, "shown": shown}


def test_whose_views_are_not_all_shown_is_counted_by_pathology():
    people = [
        who("train", "healthy", ["A4C", "SC"]),
        who("train", "dilated", ["A4C"]),
        who("train", "dilated", [], female=False),
        who("test", "healthy", ["SC"]),
    ]
    found = summary(people, 2)
    assert found["train"] == {
        "patients": 3,
        "female": 2,
        "pathology": {"dilated": 2, "healthy": 1},
        "unshown": 2,
        "unshown_pathology": {"dilated": 2},
    }
    assert found["test"]["unshown_pathology"] == {"healthy": 1}
    assert found["validation"]["unshown_pathology"] == {}
    table = people_table({"patients": {"people": found}}, ["patients"])
    assert "2 (dilated 2)" in table and "1 (healthy 1)" in table
    # A dataset of before the count by pathology shows the sum.
    del found["train"]["unshown_pathology"]
    assert "| 2 | dilated 2, healthy 1 |" in people_table(
        {"patients": {"people": found}}, ["patients"]
    )
