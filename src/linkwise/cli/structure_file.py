"""Structure files as commands read them: what there is to know of a host is told."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import linkwise as lw
from linkwise.cli.console import tell
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.estimates import stated_trust
else:
    stated_trust = lazy_module("linkwise.estimates.stated_trust")


def read_told(path: Path) -> lw.Structure:
    """The structure of a file; notes on it and its hosts go to standard error."""
    subject = lw.read_structure(path)
    if remark := stated_trust.untrusted_remark(path):
        tell(f"note: {path}: {remark}")
    tell_of_hosts(subject.hosts)
    return subject


def tell_of_hosts(hosts: Iterable[lw.Host]) -> None:
    """Print what there is to know of hosts, such as the error of a reduction, on standard error."""
    for host in hosts:
        for note in host.notes:
            tell(f"note: {host.name}: {note}")
