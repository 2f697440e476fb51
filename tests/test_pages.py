"""The pages' commands run as they stand, one after the other, and print what the pages show."""

import pytest
from pages import PAGES, missing, renewed, runs, text_of


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_print_what_it_shows(page, tmp_path):
    for run in runs(text_of(page), tmp_path):
        assert run.code in (0, 3, 4), (run.text, run.printed)
        if run.shown is not None:
            assert missing(run.shown, run.printed) == "", (run.text, run.printed)


def test_a_changed_number_is_found_and_renewed():
    printed = "m 1.0 kg\nc 2.0 m\n\nrank 10"
    assert missing("m 1.0 kg\n...\nrank 10\n", printed) == ""
    assert missing("...\nc 2.1 m\n...\n", printed) == "c 2.1 m"
    assert missing("rank 10\n...\nm 1.0 kg\n", printed) == "m 1.0 kg"
    assert renewed("...\nrank 9\n", printed) == "...\nrank 10\n"
    assert renewed("m 9.0 kg\n...\nrank 9\n", printed) == "m 1.0 kg\n...\nrank 10\n"


def test_of_lines_with_the_same_words_the_most_similar_is_renewed():
    printed = " 2 s  m = 8.1 kg\n 3 s  m = 8.4 kg\n 9 s  m = 8.5 kg"
    shown = " 3 s  m = 8.3 kg\n...\n 9 s  m = 8.6 kg\n"
    assert renewed(shown, printed) == " 3 s  m = 8.4 kg\n...\n 9 s  m = 8.5 kg\n"
