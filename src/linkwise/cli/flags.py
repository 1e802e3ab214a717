"""How the command line spells the arguments of the library: errors name arguments, commands add the flags."""

from __future__ import annotations

from linkwise.errors import LinkwiseError

FLAGS = {
    "channels": "--channel NAME=COLUMN",
    "rate": "--rate HZ",
    "resample": "--resample HZ",
    "earliest": "--from S",
    "latest": "--to S",
}
"""Flag by name of the argument of a public function (`LinkwiseError.arguments`)."""


def with_flags(error: LinkwiseError) -> str:
    """The message of an error, and the flags that set the arguments it names."""
    flags = [FLAGS[name] for name in error.arguments if name in FLAGS]
    return f"{str(error).rstrip('.')}. On the command line: {', '.join(flags)}." if flags else str(error)
