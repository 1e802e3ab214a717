"""Structure files as commands read them: what there is to know of a host is told."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import linkwise as lw
from linkwise.cli.console import tell


def read_told(path: Path) -> lw.Structure:
    """The structure of a file; notes on its hosts go to standard error."""
    subject = lw.read_structure(path)
    tell_of_hosts(subject.hosts)
    return subject


def tell_of_hosts(hosts: Iterable[lw.Host]) -> None:
    """Print what there is to know of hosts, such as the error of a reduction, on standard error."""
    for host in hosts:
        for note in host.notes:
            tell(f"note: {host.name}: {note}")
