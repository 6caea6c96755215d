"""Delays a port's messages by a constant time, as a slow computation does."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import message
from tfg_drake.systems.ports import MessageInputs, MessageState, declare_message_output


@message
class _Queue:
    """Messages, each with the time, s, at which it is due; the first is the current output."""

    messages: tuple[tuple[float, Any], ...]


class MessageDelay(LeafSystem):
    """Outputs each message after a delay, in order.

    .. pydrake_system::

        name: MessageDelay
        input_ports:
        - (name)_at_once
        output_ports:
        - (name)

    (name)_at_once and (name): any message.
    The initial message is output without delay.
    """

    def __init__(self, name: str, delay: float):
        """name: of the output. delay: s."""
        super().__init__()
        self._delay, self._name = delay, f"{name}_at_once"
        self._inputs = MessageInputs(self, **{self._name: object})
        self._queue = MessageState(self, _Queue(()), self._Update)
        # Before the first update the output is the input's current message.
        tickets = self._queue.tickets | {self._inputs.ports[self._name].ticket()}
        declare_message_output(self, name, self._Shown, tickets)

    def _Shown(self, context: Context) -> object:
        messages = self._queue(context).messages
        return messages[0][1] if messages else self._inputs(context, self._name)

    def _Update(self, context: Context, queue: _Queue) -> _Queue:
        now, newest, messages = context.get_time(), self._inputs(context, self._name), queue.messages
        if not messages or messages[-1][1] is not newest:
            messages = (*messages, (now + self._delay, newest))
        while len(messages) > 1 and messages[1][0] <= now:
            messages = messages[1:]
        return queue if messages is queue.messages else _Queue(messages)
