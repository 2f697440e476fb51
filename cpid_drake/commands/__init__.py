"""The subcommands of `cpid`, one module each; Drake is imported only when a subcommand runs."""
