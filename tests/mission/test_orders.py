"""An order and its line in the journal."""

import json
import math

from hypothesis import given
from hypothesis import strategies as st

from skysweep.mission.journal import line_of
from skysweep.mission.orders import Order
from skysweep.results.journal_lines import can_be_gone_on_with

numbers = st.floats() | st.floats(-1000, 1000)


@given(
    st.text(),
    st.none() | st.integers(0, 2**31),
    st.none() | st.tuples(numbers, numbers),
    st.none() | st.text(),
)
def test_the_journal_gives_an_order_back_as_it_was_obeyed(word, candidate_id, xy_enu_m, holder):
    order = Order(word, candidate_id, xy_enu_m, holder).as_recorded()
    x, y = order.xy_enu_m or (math.nan, math.nan)
    place = {} if order.xy_enu_m is None else {"p": (x, y, 1.23456)}
    who = {} if order.candidate_id is None else {"candidate": order.candidate_id}
    whose = {} if holder is None else {"holder": holder}
    line = json.loads(json.dumps(line_of(7.0, "operator", {"word": word} | who | place | whose)))
    assert can_be_gone_on_with(line)
    assert Order.of_line(line) == order
    assert order.as_recorded() == order


def test_a_place_that_is_none_is_left_out():
    for xy in ((math.nan, 0.0), (0.0, math.inf), (1e5, 0.0), (0.0, -99999.99999)):
        assert Order("look", None, xy).as_recorded() == Order("look")
    assert Order("look", None, (1.23456, -7)).as_recorded().xy_enu_m == (1.2346, -7.0)
