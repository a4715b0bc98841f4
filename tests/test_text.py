from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.text import percent, printable


@given(st.text(st.characters()))
def test_nothing_that_steers_a_terminal_is_printable(text):
    shown = printable(text)
    assert shown.isprintable()
    assert (shown == text) == text.isprintable()


@given(st.text(st.characters()))
def test_what_is_printable_is_text_of_xml(text):
    element = ET.Element("a")
    element.text = printable(text)
    assert ET.fromstring(ET.tostring(element)).text == (printable(text) or None)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0%"),
        (1e-9, "less than 0.0001%"),
        (0.0036, "0.4%"),
        (0.374, "37%"),
        (0.9964, "all but 0.4%"),
        (1.0, "100%"),
    ],
)
def test_a_share_in_percent_is_none_or_all_only_where_it_is(share, text):
    assert percent(share) == text
