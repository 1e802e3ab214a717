"""The API reference has a page for every public name."""

from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest
from public import public

EXTENSIONS = Path(__file__).resolve().parents[2] / "docs" / "extensions"
pytestmark = pytest.mark.skipif(find_spec("sphinx") is None, reason="needs the extra 'docs': make docs")


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The extension that writes the reference."""
    monkeypatch.syspath_prepend(EXTENSIONS)
    module: ModuleType = pytest.importorskip("api_reference")
    return module


def test_every_public_name_has_a_page_of_its_own(reference: ModuleType) -> None:
    pages = reference.pages()
    listed = {name.rpartition("/")[2] for name in pages if name != "index"}
    assert listed >= {name for name, _ in public()}
    assert len({name.lower() for name in pages}) == len(pages)  # also where files do not tell capitals apart


def test_a_public_constant_without_a_docstring_is_refused(reference: ModuleType) -> None:
    with pytest.raises(Exception, match='the public constant "NUMBER" has no docstring'):
        reference.comment("NUMBER", "linkwise.display")
