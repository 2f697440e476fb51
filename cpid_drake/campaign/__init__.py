"""Campaigns: many trials of scenarios that vary along axes, in a folder that loses none."""
