"""`python -m linkwise` is the command `linkwise`."""

from __future__ import annotations

from linkwise.cli import main

if __name__ == "__main__":
    main()
