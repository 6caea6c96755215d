"""Messages that come out later than they went in."""

from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.systems.message_delay import MessageDelay


def test_messages_are_shown_so_much_later_in_their_order():
    delay = MessageDelay("goal", 0.5)
    assert delay.get_output_port().get_name() == "goal"
    simulator = Simulator(delay)
    context = simulator.get_mutable_context()
    port, shown = delay.get_input_port(), []
    said = {0.0: "first", 1.0: "second", 1.25: "third"}
    for k in range(40):
        time = k / 16.0
        if time in said:
            port.FixValue(context, AbstractValue.Make((said[time],)))
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        (word,) = delay.get_output_port().Eval(context)
        if not shown or shown[-1][1] != word:
            shown.append((time, word))
    assert shown == [(0.0, "first"), (1.5, "second"), (1.75, "third")]
