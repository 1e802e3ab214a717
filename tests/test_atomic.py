"""Files and folders that appear whole or not at all, and what they must not take the place of."""

import json
from pathlib import Path

import pytest

from linkwise.errors import OutputError
from linkwise.output import atomic_file, atomic_folder, check_result_folder, to_json


def write_result(folder: Path, **files: str) -> None:
    """A result as linkwise writes it, of these text files."""
    with atomic_folder(folder) as partial:
        for name, text in files.items():
            (partial / name).write_text(text)
        (partial / "result.json").write_text(json.dumps({"method": "weak", "files": list(files)}))


def test_json_is_readable_by_everyone() -> None:
    assert to_json({"a": [1.5, float("nan")], "b": (float("inf"), "x", None, True, 2)}) == (
        '{"a": [1.5, null], "b": [null, "x", null, true, 2]}'
    )


def test_file_keeps_its_suffix_while_written_and_a_failed_one_leaves_the_earlier(tmp_path: Path) -> None:
    target = tmp_path / "new" / "run.csv"
    with atomic_file(target) as partial:
        assert partial.suffix == ".csv" and not target.exists()
        partial.write_text("text")
    assert target.read_text() == "text" and list(target.parent.iterdir()) == [target]
    with pytest.raises(RuntimeError, match="on the way"), atomic_file(target) as partial:
        partial.write_text("half")
        raise RuntimeError("on the way")
    assert target.read_text() == "text" and list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("earlier", [None, "empty", "result"])
def test_folder_is_replaced_where_it_may_be(tmp_path: Path, earlier: str | None) -> None:
    folder = tmp_path / "answer"
    if earlier == "empty":
        folder.mkdir()
    elif earlier == "result":
        write_result(folder, a="1", b="2")
    write_result(folder, a="3")
    assert {path.name for path in folder.iterdir()} == {"a", "result.json"}
    assert (folder / "a").read_text() == "3" and list(tmp_path.iterdir()) == [folder]


def test_what_the_user_put_beside_a_result_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "answer"
    write_result(folder, a="1", b="2")
    (folder / "notes.txt").write_text("mine")
    (folder / "photos").mkdir()
    (folder / "photos" / "rig.txt").write_text("mine too")
    write_result(folder, a="3")
    assert (folder / "notes.txt").read_text() == "mine"
    assert (folder / "photos" / "rig.txt").read_text() == "mine too"
    assert not (folder / "b").exists()


@pytest.mark.parametrize("text", [None, "no JSON", '{"files": []}', '["method"]', '{"method": "weak"}'])
def test_a_folder_that_is_no_result_is_refused(tmp_path: Path, text: str | None) -> None:
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.tex").write_text("years of work")
    if text is not None:
        (folder / "result.json").write_text(text)
    with pytest.raises(
        OutputError, match=r"thesis: already exists and is not a result of linkwise .* Choose another folder"
    ):
        check_result_folder(folder)
    with pytest.raises(OutputError), atomic_folder(folder):
        pytest.fail("the block must not run")
    assert (folder / "chapter1.tex").read_text() == "years of work"
    with pytest.raises(OutputError, match="is not a result of linkwise"):
        check_result_folder(folder / "chapter1.tex")
