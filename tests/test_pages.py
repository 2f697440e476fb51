"""The pages' commands run as they stand, one after the other, and print what the pages show."""

import pytest
from pages import PAGES, missing, runs, text_of


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_print_what_it_shows(page, tmp_path):
    for run in runs(text_of(page), tmp_path):
        assert run.code in (0, 3, 4), (run.text, run.printed)
        if run.shown is not None:
            assert missing(run.shown, run.printed) == "", (run.text, run.printed)
