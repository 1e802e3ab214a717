"""What all tests share: deterministic hypothesis, Ctrl-C, a cache of compiled equations, and data beside a checkout."""

import gc
import os
import shutil
import signal
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings
from paper_rows import paper_rows, paper_study, stored
from problems import chain_record
from within import masses

import linkwise as lw

settings.register_profile("linkwise", derandomize=True, deadline=None)
settings.load_profile("linkwise")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # so a shell starts what runs in its background, and the processes whose Ctrl-C is tested would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

COMPILED = "HEYOKA_CACHE_DIR"  # where heyoka keeps machine code between processes
PIXEL = b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)  # a PNG
OBJECTS = 50_000  # new ones before garbage is looked for: some tens of megabytes
LARGEST_CACHE = 2**28  # bytes: a few runs of all tests; each process that compiles reads all of it


def pytest_configure(config: pytest.Config) -> None:
    """Keep what tests compile out of the user's cache, which every process that compiles would read from end to end."""
    cache = getattr(config, "cache", None)  # pytest may run without its plugin
    if cache is None or COMPILED in os.environ:
        return  # a worker has the folder of the process that started it
    folder = cache.mkdir("heyoka")
    if sum(path.stat().st_size for path in folder.iterdir()) > LARGEST_CACHE:
        shutil.rmtree(folder)
        folder.mkdir()
    os.environ[COMPILED] = str(folder)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Keep the collector of cyclic garbage from walking through what stays: the modules and the thousands of tests.

    What a fit leaves holds few cycles, and to look for them after each 700 objects takes a twentieth of the time of all tests.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS)


def _unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    empty = {"png": PIXEL, "svg": b"<?xml?><svg></svg>"}
    monkeypatch.setattr(
        "linkwise.plot.style.encoded", lambda figure, *formats: [empty[name] for name in formats]
    )


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn and not rendered, for tests of what stands beside them: that takes most of the time of a folder."""
    _unrendered(monkeypatch)


@pytest.fixture
def memory_not_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    """Links that were not said to have memory are not tried with it, for tests of what goes before.

    Where terms leave much, that takes three quarters of a discovery's time.
    """
    monkeypatch.setattr("linkwise.discovery.discover.select_memory", lambda *given: None)


_SHARED = Path(__file__).resolve().parents[2] / "shared"


def _folder(name: str) -> Path:
    folder = _SHARED / name
    if not folder.is_dir():
        pytest.skip(f"no folder ../shared/{name} beside the checkout")
    return folder


@pytest.fixture(scope="session")
def shared_reference() -> Path:
    """Folder of the 400-bit reference orbits; the test is skipped where it is absent."""
    return _folder("reference")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the measured records; the test is skipped where it is absent."""
    return _folder("data")


@pytest.fixture(scope="session")
def chain() -> lw.Structure:
    """The paper's two-mass chain."""
    return lw.bnes_chain(2)


@pytest.fixture(scope="session")
def fitted(chain: lw.Structure) -> lw.Estimate:
    """The sink of that chain, identified from three simulated seconds at 30 dB."""
    record = chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    return lw.identify(record, chain.unknown("nes"), method="weak")


@pytest.fixture(scope="session")
def chain_files(chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with that chain, chain.toml, its sink unknown, unknown.toml, and two records of it, run.csv and run2.csv."""
    folder = tmp_path_factory.mktemp("chain")
    lw.write_structure(chain, folder / "chain.toml")
    lw.write_structure(chain.unknown("nes"), folder / "unknown.toml")
    for name, speed, seed in (("run", 1.0, 1), ("run2", 0.7, 2)):
        record = chain_record(2, duration=1.0, speed=speed).with_noise(30.0, seed=seed)
        lw.write_record(record, folder / f"{name}.csv")
    return folder


@pytest.fixture
def inside(chain_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the folder with files of the chain, into which nobody writes."""
    monkeypatch.chdir(chain_files)


@pytest.fixture(scope="session")
def unseen(fitted: lw.Estimate) -> lw.Estimate:
    """The same estimate as if its record had been measured: nobody knows the truth."""
    return replace(fitted, record=replace(fitted.record, simulated=None))


@pytest.fixture(scope="session")
def paper_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete study of the paper, its rows made up, with its report; not to be changed."""
    folder = stored(tmp_path_factory.mktemp("study") / "paper", paper_study(), paper_rows(paper_study()))
    assert lw.report.write_study_report(folder) == folder / "report.html"
    return folder


def _written(result: object, truth: lw.Structure, temporary: pytest.TempPathFactory) -> Path:
    """A result folder as `--truth` writes it, its figures not rendered; not to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        _unrendered(patch)
        return lw.report.write_result(result, temporary.mktemp("written") / "answer", truth=truth)


@pytest.fixture(scope="session")
def answer_folder(fitted: lw.Estimate, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the estimate."""
    return _written(fitted, chain, tmp_path_factory)


@pytest.fixture(scope="session")
def discovery_folder(
    discovered: lw.Discovery, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder of the discovery."""
    return _written(discovered, chain, tmp_path_factory)


@pytest.fixture(scope="session")
def discovered() -> lw.Discovery:
    """The paper's two-mass chain, discovered from three simulated seconds at 30 dB."""
    return lw.discover(chain_record(2, duration=3.0).with_noise(30.0, seed=1001), masses(lw.bnes_chain(2)))
