from xml.etree import ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from skysweep.text import printable


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
