"""`python -m linkwise.cli`: the command line where no entry point is installed."""

from linkwise.cli import main

main()
