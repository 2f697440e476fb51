"""`python -m cpid_drake` is `cpid`."""

from cpid_drake.commands.main import main

main()
