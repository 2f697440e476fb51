"""`python -m cpid_drake` is `cpid`."""

from cpid_drake.cli import main

main()
