"""The pictures of the page on architecture are those of the code."""

from pathlib import Path

from docs.pictures import PAGE, floors, imports, pictures, replace_pictures


def test_the_page_has_the_pictures_of_the_code(native: Path) -> None:
    """If this fails, `python docs/pictures.py` draws them again."""
    page = PAGE.read_text(encoding="utf-8")
    assert replace_pictures(page, pictures(native)) == page


def test_a_picture_that_differs_is_noticed() -> None:
    page = "<!-- a -->\n```text\nold\n```\n<!-- end -->\n"
    assert replace_pictures(page, {"a": "new"}) == page.replace("old", "new")
    assert replace_pictures(page, {"a": "old"}) == page


def test_rooms_import_only_from_floors_below() -> None:
    rooms = [line.split() for line in floors("cosim").splitlines()]
    floor_of = {name: int(floor) for floor, *names in rooms for name in names}
    assert all(floor_of[a] > floor_of[b] for a, used in imports("cosim").items() for b in used)
