"""`python -m phm.cli` is `phm`."""

from phm.cli import main

main()
